"""Labelled frames of rollouts for training perception, seen from near the benchmark camera.

In a share of them the arm is moved while the objects stay, and the fingers are opened anew, as tasks alone show few
poses.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.perception.frame import RenderedFrame, varied_camera
from kinebench_drake.suites.rollout import Rollout
from kinebench_drake.suites.simulator import Simulator, Snapshot

STILLS = 32
"""Frames of a rollout."""
_MOVED_SHARE = 0.4  # share of frames with a moved arm
_BENCHMARK_SHARE = 0.4  # share of frames from the benchmark camera itself
_SPREAD_RAD = np.array([0.2, 0.2, 0.2, 0.25, 0.3, 0.3, 0.6])  # standard deviation of the joints of a moved arm
_LEAST_Z_M = 0.012  # of a tool centre point above the table
_TRIES = 200


def render_stills(simulator: Simulator, rollout: Rollout, rng: np.random.Generator) -> list[RenderedFrame]:
    """Render `STILLS` frames of a rollout in its simulator, whose camera is restored."""
    camera_before, size = simulator.camera, simulator.camera.width
    plant = ArmPlant()
    frames = []
    for snapshot in _choose_snapshots(rollout.snapshots, rng):
        benchmark = rng.random() < _BENCHMARK_SHARE
        simulator.set_camera(benchmark_camera().resized(size, size) if benchmark else varied_camera(rng, size))
        simulator.set_snapshot(_move_arm(plant, snapshot, rng) if rng.random() < _MOVED_SHARE else snapshot)
        frames.append(simulator.training_frame())
    simulator.set_camera(camera_before)
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
