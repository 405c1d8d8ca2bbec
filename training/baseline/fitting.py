"""Fit of the baseline to demonstrations: their decoded frames, random windows of these, and the training."""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Subset

from benchmarks.perception.clip import TruthClipFile, find_clips
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.reader import read_video
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.suites.catalog import load_suite
from kinebench_drake.suites.demo_config import DemoConfig, FormatKind, RenderOptions
from kinebench_drake.suites.demos import make_demos
from kinebench_drake.suites.families.task import TaskVariant
from training.augment import degrade, occlude
from training.baseline.network import (
    CONTEXT,
    FINGER_SCALE_M,
    POSITION_SCALE_M,
    PoseNetwork,
    PoseOutput,
    resize_frames,
)
from training.loop import LossTerms, Schedule, load_imagenet, optimise, pick_device, save_weights

TRAINING_SUITE = 1
"""Suite whose training tasks are demonstrated."""
RENDERED_PX = 256
"""Width and height of the demonstrations [px]."""
LABELLED = 3
"""Frames of a window with labels; CONTEXT more frames lie on each side."""
_DEGRADED = 0.75
"""Share of windows that are degraded."""
_OCCLUDED = 0.15
"""Share of windows that are occluded."""
_REPORT_EVERY = 100
"""Number of decoded videos between two reports."""
WEIGHTS = "baseline.safetensors"
"""Name of the weights file in the output folder."""
SCHEDULE = Schedule(steps=2400, learning_rate=1e-3, batch_size=8, checkpoint_every=200)
"""Schedule of the comparison in the README, on 400 clips of ten tasks."""
_ROTATION_WEIGHT = 2.0
"""Weight of the rotation: 1 cm counts as much as 3 degrees."""
_FINGER_WEIGHT = 0.5
"""Weight of the gap: 1 cm counts as much as 8 mm of it."""
_ROUND_M = 1e-3
_ROUND_RAD = 5e-3
"""Errors at which the losses change from quadratic to linear."""
_HOW = "make one with `kinebench-drake suite demos --suite 1 --split train --out FOLDER`"


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstration:
    """Video of a demonstration with its ground truth."""

    id: str
    task: str
    path: Path
    """Video file."""
    t_s: Array
    """(T,) task time [s]."""
    X_BG: Array
    """(T, 4, 4) true pose of panda_hand_tcp in the base frame [m]."""
    finger_width_m: Array
    """(T,) true gap between the finger pads [m]."""

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            InputError: a shape does not fit the number of frames, or a number is not finite.
        """
        n = len(self.t_s)
        for name, shape in (("X_BG", (n, 4, 4)), ("finger_width_m", (n,))):
            value = getattr(self, name)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"{self.id}: {name} has shape {value.shape}, expected finite numbers {shape}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstrations:
    """Demonstrations of a folder, all recorded by one camera."""

    camera: Camera
    clips: tuple[Demonstration, ...]

    @property
    def tasks(self) -> tuple[str, ...]:
        """Plain task ids, sorted."""
        return tuple(sorted({clip.task for clip in self.clips}))


def load_demonstrations(folder: Path) -> Demonstrations:
    """Return the clips listed in the manifest of a folder.

    Raises:
        UsageError: manifest, camera or ground truth is missing or unusable, or no video is listed.
    """
    files = find_clips(folder)
    return Demonstrations(camera=files[0].camera, clips=tuple(map(_load, files)))


def _load(file: TruthClipFile) -> Demonstration:
    if not file.task:
        raise UsageError(f"{file.video.name}: the manifest names no task; {_HOW}")
    try:
        with np.load(file.truth, allow_pickle=False) as truth:
            return Demonstration(
                id=file.id,
                task=file.task,
                path=file.video,
                t_s=truth["t_s"],
                X_BG=truth["base_from_tcp"],
                finger_width_m=truth["finger_width_m"],
            )
    except (OSError, ValueError, KeyError, InputError) as error:
        raise UsageError(f"truth/{file.truth.name}: cannot be used ({cause(error)}); {_HOW}") from None


def decode(
    clips: Sequence[Demonstration], folder: Path, size: int, report: Callable[[str], None]
) -> list[NDArray[np.uint8]]:
    """Return the frames (T, size, size, 3) of each clip, memory-mapped from `folder`, decoding missing ones first.

    A video newer than its decoded frames is decoded again.

    Raises:
        UsageError: a video and its ground truth differ in the number of frames.
        InputError: a video cannot be read.
        SetupError: writing failed.
    """
    arrays = []
    for number, clip in enumerate(clips, 1):
        path = folder / f"{clip.id}_{size}.npy"
        if not path.is_file() or path.stat().st_mtime < clip.path.stat().st_mtime:
            frames = read_video(clip.path).frames
            if len(frames) != len(clip.t_s):
                raise UsageError(f"{clip.path.name}: has {len(frames)} frames, its truth has {len(clip.t_s)}")
            with atomic_path(path) as part:
                np.save(part, resize_frames(frames, size))
            if number % _REPORT_EVERY == 0:
                report(f"decoded {number} of {len(clips)} videos")
        arrays.append(np.load(path, mmap_mode="r"))
    return arrays


class Windows(Dataset[dict[str, Tensor]]):
    """Random windows by index: the same seed and index give the same window, in any order of access.

    All tasks are equally frequent, and so are all clips of a task. Beyond the ends of a video its first or last frame
    is repeated. All frames of a window are degraded alike.
    """

    def __init__(
        self, clips: Sequence[Demonstration], frames: Sequence[NDArray[np.uint8]], seed: int, length: int
    ) -> None:
        """Prepare `length` windows from `clips` with `frames` (T, S, S, 3) each."""
        self._clips = clips
        self._frames = frames
        self._seed = seed
        self._length = length
        tasks = sorted({clip.task for clip in clips})
        self._of_task = [[i for i, clip in enumerate(clips) if clip.task == task] for task in tasks]

    def __len__(self) -> int:
        """Return the number of windows of an epoch."""
        return self._length

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """Return a window: image (LABELLED + 2 CONTEXT, 3, S, S) uint8; position [m], rotation, finger_width [m]."""
        rng = np.random.default_rng([self._seed, index])
        members = self._of_task[rng.integers(len(self._of_task))]
        number = members[rng.integers(len(members))]
        clip = self._clips[number]
        frames = self._frames[number]
        start = int(rng.integers(max(1, len(frames) - LABELLED + 1)))
        numbers = np.clip(np.arange(start - CONTEXT, start + LABELLED + CONTEXT), 0, len(frames) - 1)
        images = np.array(frames[numbers])
        degrading = rng.random() < _DEGRADED
        occluding = rng.random() < _OCCLUDED
        draw = int(rng.integers(2**32))
        scenery = np.array(frames[0])
        for k, image in enumerate(images):
            if occluding:
                occlude(image, np.zeros((1, 1), np.uint8), scenery, np.random.default_rng([draw, 0]))
            if degrading:
                images[k] = degrade(image, np.random.default_rng([draw, 1]))
        labelled = numbers[CONTEXT : CONTEXT + LABELLED]
        X_BG = torch.from_numpy(clip.X_BG[labelled]).float()
        return {
            "image": torch.from_numpy(images).permute(0, 3, 1, 2),
            "position": X_BG[:, :3, 3],
            "rotation": X_BG[:, :3, :3],
            "finger_width": torch.from_numpy(clip.finger_width_m[labelled]).float(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class BaselineConfig:
    """Inputs and settings of a training."""

    data: Path
    """Folder of demonstrations."""
    out: Path
    """Folder for decoded frames, checkpoints and the weights."""
    schedule: Schedule = SCHEDULE
    """Schedule; its examples are windows of frames."""
    size: int = 224
    """Width and height of the frames [px]."""
    workers: int = 1
    """Processes that prepare batches."""


def make_demonstrations(folder: Path, episodes: int, jobs: int, observer: RunObserver) -> Path:
    """Make `episodes` demonstrations of each training task of suite 1 in a folder, and return it; resumes.

    Raises:
        UsageError: the folder holds something else, or the expert fails with too many seeds.
        SetupError: something is missing on this machine, or a worker died.
    """
    suite = load_suite(TRAINING_SUITE)
    config = DemoConfig(
        suite=suite,
        split="train",
        tasks=tuple(suite.tasks_of("train")),
        episodes=episodes,
        seed=0,
        variant=TaskVariant.PLAIN,
        out=folder,
        options=RenderOptions(size=RENDERED_PX),
        kind=FormatKind.MP4,
    )
    short = make_demos(config, LocalExecutor(jobs=jobs), observer).short
    if short:
        raise UsageError(f"demonstrations are missing: {short}; {folder.name}/demos.jsonl has the reasons")
    return folder


def _rounded(square: Tensor, radius: float) -> Tensor:
    """Return the root of `square`, smoothed near zero so that its gradient is finite (Charbonnier loss)."""
    return torch.sqrt(square + radius**2) - radius


def losses(output: PoseOutput, batch: dict[str, Tensor]) -> LossTerms:
    """Return distances of position, rotation and gap: linear, so that single bad frames do not dominate.

    The distance of rotations is the chordal distance / sqrt(2), for small angles the angle [rad] (Hartley et al., IJCV
    2013, section 4.2).
    """
    position = _rounded((output.position - batch["position"]).square().sum(dim=-1), _ROUND_M)
    chord = (output.rotation - batch["rotation"]).square().sum(dim=(-1, -2)) / 2.0
    rotation = _rounded(chord, _ROUND_RAD)
    finger = _rounded((output.finger_width - batch["finger_width"]).square(), _ROUND_M)
    total = position.mean() / POSITION_SCALE_M + _ROTATION_WEIGHT * rotation.mean()
    return LossTerms(
        total=total + _FINGER_WEIGHT * finger.mean() / FINGER_SCALE_M,
        reported={
            "position_mm": 1e3 * position.mean(),
            "rotation_deg": torch.rad2deg(rotation.mean()),
            "finger_mm": 1e3 * finger.mean(),
        },
    )


def train(config: BaselineConfig, report: Callable[[str], None]) -> Path:
    """Train, or resume from the last checkpoint in `config.out`; return the path of the weights.

    Raises:
        UsageError: the data cannot be used, or `config.out` holds a training with other settings.
    """
    schedule = config.schedule
    demonstrations = load_demonstrations(config.data)
    clips = demonstrations.clips
    report(f"{len(clips)} clips of {len(demonstrations.tasks)} tasks")
    frames = decode(clips, config.out / "frames", config.size, report)
    windows = Windows(clips, frames, schedule.seed, schedule.steps * schedule.batch_size)

    def batches(start: int) -> Iterable[dict[str, Tensor]]:
        rest = Subset(windows, range(start * schedule.batch_size, len(windows)))
        return DataLoader(rest, batch_size=schedule.batch_size, num_workers=config.workers, drop_last=True)

    torch.manual_seed(schedule.seed)
    network = PoseNetwork()
    load_imagenet(network.encoder)
    network.to(pick_device()).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = optimise(
        network,
        batches=batches,
        forward=lambda model, batch: model(batch["image"].float() / 255.0),
        losses=losses,
        schedule=schedule,
        identity={**schedule.identity(), "size": config.size, "clips": len(clips), "tasks": list(demonstrations.tasks)},
        folder=config.out,
        report=report,
    )
    about = {
        "tasks": json.dumps(demonstrations.tasks),
        "size": str(config.size),
        "camera": json.dumps(demonstrations.camera.to_json()),
        "training": f"{len(clips)} demonstrations of {len(demonstrations.tasks)} tasks, {schedule.steps} steps",
    }
    save_weights(average, config.out / WEIGHTS, about)
    return config.out / WEIGHTS
