"""Demonstrations, and the formats that write them: one part per demonstration, joined or indexed at the end."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, Flag, auto
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array, from_quaternion, invert
from kinebench_drake.models.perception.frame import RenderedFrame
from kinebench_drake.suites.clock import CLIP_FRAMES, CONTROL_PERIOD_S, STEPS_PER_FRAME
from kinebench_drake.suites.rollout import Rollout, RolloutVideo
from kinebench_drake.suites.simulator import Snapshot

PARTS = ".parts"
"""Folder of the parts of formats that join them at the end."""
CLIP_STEPS = STEPS_PER_FRAME * CLIP_FRAMES
"""Control steps of a clip."""
FRAME_CHOICES = tuple(n + 1 for n in range(1, CLIP_STEPS + 1) if CLIP_STEPS % n == 0)
"""Possible numbers of frames of a clip: constant numbers of control steps apart, first and last included."""


class FormatKind(Enum):
    """Formats that `--format` can name."""

    MP4 = "mp4"
    LEROBOT = "lerobot-v3"
    MANISKILL = "maniskill-h5"
    FRAMES = "frames"


class Content(Flag):
    """Content of a format beside numbers."""

    VIDEO = auto()
    """Video of all frames."""
    STILLS = auto()
    """Labelled frames of some states."""
    STATES = auto()
    """ManiSkill states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderOptions:
    """Options of rendering demonstrations."""

    size: int = 384
    """Width and height [px]."""
    frames: int = CLIP_FRAMES + 1
    """Frames of a clip, of `FRAME_CHOICES`."""
    fps: float = 17.0
    """Playback rate of a video [frames/s]."""
    crf: int = 16
    """x264's quality."""
    with_depth: bool = False
    """Store depth and masks with the ground truth."""

    def __post_init__(self) -> None:
        """Check the numbers of frames.

        Raises:
            UsageError: the number of frames does not divide a clip's control steps, or the rate is invalid.
        """
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise UsageError(f"$fps is {self.fps}, expected a positive number")
        if self.frames not in FRAME_CHOICES:
            raise UsageError(
                f"$frames is {self.frames}: a clip's {CLIP_STEPS} control steps can be rendered as "
                f"{', '.join(map(str, FRAME_CHOICES))} frames (49: every fourth step)"
            )

    @property
    def every(self) -> int:
        """Control steps between two frames."""
        return CLIP_STEPS // (self.frames - 1)

    @property
    def frame_period_s(self) -> float:
        """Task time between two frames."""
        return round(self.every * CONTROL_PERIOD_S, 6)

    @property
    def camera(self) -> Camera:
        """Benchmark camera at this size."""
        return benchmark_camera().resized(self.size, self.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """Attempt at a demonstration: a line of `demos.jsonl`."""

    id: str
    """Id of the episode."""
    task: str
    seed: int
    prompt: str
    success: bool
    """True if the expert succeeded, which makes the attempt a demonstration."""
    reason: str
    """Reason of a failure; empty on success."""
    progress: float
    """0..1."""
    clips: int
    """Number of clips of 192 control steps."""
    facts: dict[str, Any]
    """Variant, assets, looks and camera."""

    @classmethod
    def from_json(cls, data: object) -> "Record":
        """Parse a line of `demos.jsonl`.

        Raises:
            InputError: it is not a record.
        """
        try:
            return cls(**cast(dict[str, Any], data))
        except TypeError as error:
            raise InputError(f"not a record of a demonstration ({error})") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """Successful rollout, rendered as its format requires."""

    rollout: Rollout
    options: RenderOptions
    video: RolloutVideo | None
    """All frames; those between two clips once."""
    X_WB: Array
    """(4, 4) robot base in the ManiSkill world, the frame of snapshots."""
    stills: Sequence[RenderedFrame] = ()
    """Labelled frames, for formats with `Content.STILLS`."""
    states: Sequence[dict[str, dict[str, NDArray[np.float32]]]] = ()
    """ManiSkill's state at the start and after each control step, for formats with `Content.STATES`."""
    successes: tuple[bool, ...] = ()
    """Success after each control step, with the states."""

    @property
    def id(self) -> str:
        """Id of the episode."""
        return self.rollout.episode.id

    @property
    def clips(self) -> int:
        """Number of clips."""
        return len(self.rollout.controls) // CLIP_STEPS

    def clip(self, k: int) -> "Demo":
        """Return a clip as a demonstration of its own; its last frame is the first of the next clip."""
        n, steps = self.options.frames - 1, CLIP_STEPS
        frames, controls = slice(k * n, (k + 1) * n + 1), slice(k * steps, (k + 1) * steps)
        rollout, video = self.rollout, self.video
        if video is not None:
            video = video.select(frames)
        rollout = replace(rollout, snapshots=rollout.snapshots[frames], controls=rollout.controls[controls])
        return replace(self, rollout=rollout, video=video)

    def truth(self) -> dict[str, Any]:
        """Return the ground truth arrays of its frames, by name (docs/suites.md)."""
        snapshots, controls, video = self.rollout.snapshots, self.rollout.controls, self.video
        arrays: dict[str, Any] = {
            "t_s": self.options.frame_period_s * np.arange(len(snapshots)),
            "q": np.stack([s.q for s in snapshots]),
            "finger_width_m": np.array([s.fingers_m.sum() for s in snapshots]),
            "control_t_s": CONTROL_PERIOD_S * np.arange(len(controls)),
            "control_q": controls[:, :7],
            "control_finger_width_m": controls[:, 7],
        }
        if video is not None:
            arrays |= {"base_from_tcp": video.X_BG, "camera_from_hand": video.X_CH}
            if self.options.with_depth:
                arrays |= {"depth_mm": video.depth_mm, "mask": np.packbits(video.mask, axis=-1)}
        names = list(snapshots[0].objects)
        arrays["objects"] = np.array(names)
        arrays["base_from_object"] = np.stack([[self._in_base(s, name) for name in names] for s in snapshots])
        joints = list(snapshots[0].joints)
        arrays["joints"] = np.array(joints, dtype=np.str_)
        arrays["joint_position"] = np.array([[s.joints[name] for name in joints] for s in snapshots]).reshape(
            len(snapshots), len(joints)
        )
        return arrays

    def _in_base(self, snapshot: Snapshot, name: str) -> Array:
        raw = snapshot.objects[name]
        return np.asarray(invert(self.X_WB) @ from_quaternion(raw[3:], raw[:3]))


class DemoFormat(Protocol):
    """Writer of demonstrations in one format."""

    content: Content
    """Required content of demonstrations."""

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Return the files of a demonstration's part."""

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write a demonstration's part, each file whole or not at all."""

    def finish(
        self, folder: Path, records: Sequence[Record], options: RenderOptions, about: dict[str, Any]
    ) -> list[Path]:
        """Write the files that concern all demonstrations; the parts are kept.

        Args:
            folder: output folder.
            records: the demonstrations, in order.
            options: options of rendering.
            about: suite, split, pool and variant.

        Returns:
            The files into which parts were joined; none for formats that keep their parts.
        """

    def index_files(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Return the files that `finish` writes beside those it returns."""


def find_format(kind: FormatKind) -> DemoFormat:
    """Return the writer of a format."""
    match kind:
        case FormatKind.MP4:
            from kinebench_drake.suites.formats.videofolder import VideoFolder

            return VideoFolder()
        case FormatKind.LEROBOT:
            from kinebench_drake.suites.formats.lerobot import LeRobot

            return LeRobot()
        case FormatKind.MANISKILL:
            from kinebench_drake.suites.formats.maniskill import ManiSkill

            return ManiSkill()
        case FormatKind.FRAMES:
            from kinebench_drake.suites.formats.stills import StillFrames

            return StillFrames()
