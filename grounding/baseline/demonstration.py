"""Demonstrations with their truth, as `kinebench-drake suite demos --format mp4` writes them."""

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.geometry import Array

_HOW = "make one with `kinebench-drake suite demos --suite 1 --split train --out FOLDER`"


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstration:
    """One clip of a demonstration."""

    id: str
    task: str
    path: Path
    """The video."""
    t_s: Array
    """(T,) task time [s]."""
    X_BG: Array
    """(T, 4, 4) true pose of panda_hand_tcp in the base frame [m]."""
    finger_width_m: Array
    """(T,) true gap between the finger pads [m]."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames.

        Raises:
            InputError: they differ, or a number is not finite.
        """
        n = len(self.t_s)
        for name, shape in (("X_BG", (n, 4, 4)), ("finger_width_m", (n,))):
            value = getattr(self, name)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"{self.id}: {name} has shape {value.shape}, expected finite numbers {shape}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstrations:
    """The clips of a folder, all taken by one camera."""

    folder: Path
    camera: Camera
    clips: tuple[Demonstration, ...]

    @property
    def tasks(self) -> tuple[str, ...]:
        """Their tasks, sorted."""
        return tuple(sorted({clip.task for clip in self.clips}))


def load_demonstrations(folder: Path, tasks: Collection[str] | None = None) -> Demonstrations:
    """The clips that a folder's manifest lists, of `tasks` only if given.

    Raises:
        UsageError: manifest, camera or truth is missing, or no clip is left.
    """
    manifest = folder / "manifest.jsonl"
    if not manifest.is_file():
        raise UsageError(f"{folder.name}: has no manifest.jsonl; {_HOW}")
    clips = []
    for number, line in enumerate(manifest.read_text().splitlines(), 1):
        try:
            entry = json.loads(line)
            video, task = str(entry["video"]), str(entry["task"])
        except (ValueError, KeyError, TypeError):
            raise UsageError(f"{manifest.name} line {number}: expected an object with the keys video, task") from None
        if tasks is None or task in tasks:
            clips.append(_load(folder, video, task))
    if not clips:
        raise UsageError(f"{folder.name}: its manifest lists no video of {', '.join(tasks or ['any task'])}")
    return Demonstrations(folder=folder, camera=Camera.load(folder / "camera.json"), clips=tuple(clips))


def _load(folder: Path, video: str, task: str) -> Demonstration:
    path = folder / "truth" / f"{Path(video).stem}.npz"
    if not path.is_file():
        raise UsageError(f"{folder.name}: truth/{path.name} is missing, so nothing can be learned or measured; {_HOW}")
    try:
        with np.load(path, allow_pickle=False) as truth:
            return Demonstration(
                id=path.stem,
                task=task,
                path=folder / video,
                t_s=truth["t_s"],
                X_BG=truth["base_from_tcp"],
                finger_width_m=truth["finger_width_m"],
            )
    except (OSError, ValueError, KeyError, InputError) as error:
        raise UsageError(f"{folder.name}: truth/{path.name} cannot be used ({cause(error)}); {_HOW}") from None
