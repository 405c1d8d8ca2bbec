"""Labelled frames of the experts' rollouts, seen from near the benchmark camera, rendered in several processes.

In a share of them the arm is moved while the objects stay, and the fingers are opened anew, as tasks alone show few
poses.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError, SetupError
from kinebench_drake.executors.base import WorkerCrash
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import LINK_OF, RobotPart
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import Rollout, run_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator, Snapshot
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker
from training.frame import FILES, RENDERED_DEPTH_BIAS_M, RenderedFrame, label_parts, save_shard, varied_camera
from training.viewpoint import place_camera

STILLS = 32
"""Frames of a rollout."""
_MOVED_SHARE = 0.4
"""Share of frames with a moved arm."""
_BENCHMARK_SHARE = 0.4
"""Share of frames from the benchmark camera itself."""
_SPREAD_RAD = np.array([0.2, 0.2, 0.2, 0.25, 0.3, 0.3, 0.6])
"""Standard deviation of the joints of a moved arm [rad]."""
_LEAST_Z_M = 0.012
"""Least height of a TCP above the table [m]."""
_TRIES = 200


class StillSimulator(Simulator):
    """Simulator that labels its images."""

    def labelled(self) -> RenderedFrame:
        """Render the current state with part labels and coordinates of each pixel."""
        rgb, depth_mm, labels, ids = self._capture()
        part_of = {name: part for part, name in LINK_OF.items()}
        parts = {i: part_of.get(name, RobotPart.BACKGROUND) for name, i in ids.items()}
        X_BL = {name: self.link_pose(name) for name in part_of}
        finger_m = float(self.snapshot().fingers_m.mean())
        depth_m = depth_mm / 1000.0 + RENDERED_DEPTH_BIAS_M
        return RenderedFrame.from_image(rgb, depth_m, label_parts(labels, parts), self.camera, X_BL, finger_m)


def render_rollouts(folder: Path, specs: Sequence[EpisodeSpec], jobs: int, report: Callable[[str], None]) -> None:
    """Render a shard of each episode in which the expert succeeds, of those that `folder` lacks, in `jobs` processes.

    Raises:
        SetupError: a rendering process died, most often because there is no Vulkan driver.
    """
    missing = [spec for spec in specs if not (folder / spec.id / FILES[-1]).is_file()]
    make_worker = partial(SimulatorWorker, partial(_render, folder=folder), SimulatorCache(StillSimulator))
    for finished, done in enumerate(LocalExecutor(jobs=jobs).run(make_worker, missing), 1):
        if isinstance(done, WorkerCrash):
            raise SetupError(f"rendering stopped at {done.item.id}: {done.reason}; `kinebench-drake doctor` shows why")
        report(f"[{finished}/{len(missing)}] {done.item.id}{'' if done.result else ': the expert failed'}")


def _render(simulator: StillSimulator, spec: EpisodeSpec, folder: Path) -> bool:
    """Write the shard of an episode; return whether the expert succeeded."""
    episode = spec.episode()
    try:
        rollout = run_expert(simulator, find_expert(spec.task), episode)
    except InputError:
        return False
    if rollout.outcome.success:
        save_shard(render_stills(simulator, rollout, generator("stills", episode.id)), folder / episode.id)
    return rollout.outcome.success


def render_stills(simulator: StillSimulator, rollout: Rollout, rng: np.random.Generator) -> list[RenderedFrame]:
    """Render `STILLS` frames of a rollout in its simulator, whose camera is restored."""
    camera_before = simulator.camera
    size = simulator.camera.width
    plant = ArmPlant()
    frames = []
    for snapshot in _choose_snapshots(rollout.snapshots, rng):
        benchmark = rng.random() < _BENCHMARK_SHARE
        place_camera(simulator, benchmark_camera().resized(size, size) if benchmark else varied_camera(rng, size))
        simulator.set_snapshot(_move_arm(plant, snapshot, rng) if rng.random() < _MOVED_SHARE else snapshot)
        frames.append(simulator.labelled())
    place_camera(simulator, camera_before)
    return frames


def _choose_snapshots(snapshots: Sequence[Snapshot], rng: np.random.Generator) -> list[Snapshot]:
    indices = rng.choice(len(snapshots), size=STILLS, replace=len(snapshots) < STILLS)
    return [snapshots[i] for i in np.sort(indices)]


def _move_arm(plant: ArmPlant, snapshot: Snapshot, rng: np.random.Generator) -> Snapshot:
    """Return the snapshot with a random posture of the arm above the table; unchanged if none is found."""
    for _ in range(_TRIES):
        q: Array = snapshot.q + rng.normal(0.0, _SPREAD_RAD)
        inside = (q > plant.lower).all() and (q < plant.upper).all()
        if inside and plant.forward(q)[2, 3] > _LEAST_Z_M:
            fingers = np.full(2, rng.uniform(0.0, 0.04)) if rng.random() < 0.5 else snapshot.fingers_m
            return replace(snapshot, q=q, fingers_m=fingers)
    return snapshot
