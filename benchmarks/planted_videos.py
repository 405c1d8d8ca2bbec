"""Rendered videos with planted faults and ground truth.

Videos without a fault come from `kinebench-drake suite demos`, in a folder of the same layout, or of the same order.
Output folder, the same bytes for the same arguments:

    ID.mp4              17 fps; ID = the episode's _ kind of fault [_ form] _ size
    camera.json         the camera of all of them
    manifest.jsonl      one object a video
    truth/ID.npz        t_s, base_from_tcp, camera_from_hand, q, finger_width_m as rendered: NaN where the gripper
                        vanishes, the frozen pose in frozen frames
    truth/faults.json   for each video kind, frame_start, frame_end, size, form
    truth/outcome.json  success of each episode
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.faults.fault import FaultGrade, PlantedFault
from benchmarks.faults.fault_simulator import FaultSimulator
from benchmarks.faults.plant import plant
from benchmarks.faults.recording import Recording
from kinebench_drake.errors import InputError
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, render_video, run_expert

CRF = 16
"""Quality of x264."""
FPS = 17
"""Frame rate of the mp4; the task time between frames is `FRAME_PERIOD_S`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantingOrder:
    """Videos to make of one episode."""

    spec: EpisodeSpec
    """The episode."""
    grades: tuple[FaultGrade, ...]
    """Faults to plant, each in its own video."""
    with_clean: bool = False
    """True if the video without a fault is written, too."""
    out: Path
    """Folder to write to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedVideo:
    """One written video."""

    id: str
    """Name of its files without suffix."""
    episode: str
    """Id of the episode."""
    task: str
    """Plain task id."""
    seed: int
    """Seed of the scene."""
    prompt: str
    """The task in words."""
    success: bool
    """True if the episode without the fault succeeds."""
    fault: PlantedFault | None
    """The fault; None for a clean video."""

    def manifest_line(self) -> str:
        """Return its line of `manifest.jsonl`."""
        entry = {
            "video": f"{self.id}.mp4",
            "id": self.id,
            "task": self.task,
            "seed": self.seed,
            "prompt": self.prompt,
            "fps": FPS,
            "frame_period_s": FRAME_PERIOD_S,
        }
        return json.dumps(entry) + "\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantingResult:
    """Result of an order."""

    videos: tuple[PlantedVideo, ...]
    problems: tuple[str, ...]
    """Why other videos were not made."""


def plant_episode(order: PlantingOrder) -> PlantingResult:
    """Execute an episode, render its first clip and plant each fault.

    Each episode has its own scene, so that results do not depend on what was made before. A fault for which the clip
    has no place, or an episode that the expert cannot solve, is reported as a problem.
    """
    spec = order.spec
    videos = []
    problems = []
    with FaultSimulator(spec.task, variant=spec.variant) as simulator:
        try:
            rollout = run_expert(simulator, find_expert(spec.task), spec.episode())
        except InputError as error:
            return PlantingResult(videos=(), problems=(f"{spec.task} seed {spec.seed}: {error}",))
        rollout = replace(rollout, snapshots=rollout.snapshots[: CLIP_FRAMES + 1])
        video = render_video(simulator, rollout.snapshots)
        recording = Recording(simulator=simulator, rollout=rollout, video=video)
        if order.with_clean:
            videos.append(_write(order, rollout, video))
        for grade in order.grades:
            try:
                faulty, fault = plant(recording, grade)
            except InputError as error:
                problems.append(f"{spec.task} seed {spec.seed} {grade.label}: {error}")
                continue
            videos.append(_write(order, rollout, faulty, grade, fault))
        save_camera(simulator.camera, order.out / "camera.json")
    return PlantingResult(videos=tuple(videos), problems=tuple(problems))


def _save_truth(video: RolloutVideo, path: Path) -> None:
    """Write the ground truth as npz, reproducible to the byte."""
    np.savez_compressed(
        path,
        t_s=video.t_s,
        base_from_tcp=video.X_BG,
        camera_from_hand=video.X_CH,
        q=video.q,
        finger_width_m=video.finger_width_m,
    )


def _write(
    order: PlantingOrder,
    rollout: Rollout,
    video: RolloutVideo,
    grade: FaultGrade | None = None,
    fault: PlantedFault | None = None,
) -> PlantedVideo:
    """Write a video and its ground truth; no grade: the clean one."""
    episode = rollout.episode
    planted = PlantedVideo(
        id=episode.id if grade is None else f"{episode.id}_{grade.label}",
        episode=episode.id,
        task=episode.task,
        seed=episode.seed,
        prompt=episode.prompt,
        success=rollout.outcome.success,
        fault=fault,
    )
    write_video(order.out / f"{planted.id}.mp4", video.rgb, FPS, crf=CRF)
    _save_truth(video, order.out / "truth" / f"{planted.id}.npz")
    return planted


def make_planter() -> Callable[[PlantingOrder], PlantingResult]:
    """Return the worker that plants the faults of an order."""
    return plant_episode


def write_index(out: Path, videos: Sequence[PlantedVideo]) -> None:
    """Write `manifest.jsonl`, `truth/faults.json` and `truth/outcome.json`, sorted by id."""
    videos = sorted(videos, key=lambda video: video.id)
    (out / "manifest.jsonl").write_text("".join(video.manifest_line() for video in videos))
    faults = {v.id: v.fault.to_json() for v in videos if v.fault is not None}
    (out / "truth" / "faults.json").write_text(json.dumps(faults, indent=1) + "\n")
    outcome = {v.id: {"episode_success": v.success} for v in videos}
    (out / "truth" / "outcome.json").write_text(json.dumps(outcome, indent=1) + "\n")
