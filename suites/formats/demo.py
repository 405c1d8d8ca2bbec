"""One demonstration, and what every format takes from it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, Flag, auto
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array, from_quaternion, invert
from kinebench_drake.models.perception.frame import RenderedFrame
from kinebench_drake.suites.clip import RolloutVideo
from kinebench_drake.suites.clock import CLIP_FRAMES, CONTROL_PERIOD_S, STEPS_PER_FRAME
from kinebench_drake.suites.rollout import Rollout
from kinebench_drake.suites.simulator import Snapshot

PARTS = ".parts"
"""Folder of what formats that join their parts keep until they do."""
CLIP_STEPS = STEPS_PER_FRAME * CLIP_FRAMES
"""Control steps of a clip."""
FRAME_CHOICES = tuple(n + 1 for n in range(1, CLIP_STEPS + 1) if CLIP_STEPS % n == 0)
"""Frames that a clip can have: every so many control steps one, the first and the last included."""


class FormatKind(Enum):
    """The formats a command line can name."""

    MP4 = "mp4"
    LEROBOT = "lerobot-v3"
    MANISKILL = "maniskill-h5"
    FRAMES = "frames"


class Content(Flag):
    """What a format holds of a demonstration beside numbers."""

    FILM = auto()
    """All its frames."""
    STILLS = auto()
    """Some moments, each pixel labelled."""
    STATES = auto()
    """ManiSkill's states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shots:
    """How demonstrations are filmed."""

    size: int = 384
    """Width and height [px]."""
    frames: int = CLIP_FRAMES + 1
    """Frames of a clip, of `FRAME_CHOICES`."""
    fps: float = 17.0
    """Frames per second that a video plays at."""
    crf: int = 16
    """x264's quality."""
    with_depth: bool = False
    """Whether the truth of a film holds depth and masks."""

    def __post_init__(self) -> None:
        """Check the numbers of frames.

        Raises:
            UsageError: a clip's control steps cannot be divided so, or a video cannot play so.
        """
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise UsageError(f"--fps is {self.fps}, expected a positive number")
        if self.frames not in FRAME_CHOICES:
            raise UsageError(
                f"--frames is {self.frames}: a clip's {CLIP_STEPS} control steps can be filmed in "
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
        """The benchmark's camera in this size."""
        return benchmark_camera().resized(self.size, self.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """One attempt at a demonstration, as `demos.jsonl` tells it."""

    id: str
    """The episode's id."""
    task: str
    seed: int
    prompt: str
    success: bool
    """Whether the expert did the task: only then it is a demonstration."""
    reason: str
    """Why it is none; empty if it is one."""
    progress: float
    """0..1."""
    clips: int
    """Clips of 192 control steps that it took."""
    facts: dict[str, Any]
    """Variant, assets, looks and camera."""

    @classmethod
    def from_json(cls, data: object) -> "Record":
        """Parse a line of `demos.jsonl`.

        Raises:
            InputError: it is no record.
        """
        try:
            return cls(**cast(dict[str, Any], data))
        except TypeError as error:
            raise InputError(f"not a record of a demonstration ({error})") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """A successful performance, filmed where the format has pictures."""

    performance: Rollout
    shots: Shots
    film: RolloutVideo | None
    """All its frames, those between two clips once."""
    X_WB: Array
    """(4, 4) the robot's base in the ManiSkill world, in which snapshots are."""
    stills: Sequence[RenderedFrame] = ()
    """Labelled stills, for formats that hold them."""
    states: Sequence[dict[str, dict[str, NDArray[np.float32]]]] = ()
    """ManiSkill's state at the start and after each control step, for formats that keep it."""
    successes: tuple[bool, ...] = ()
    """The task's verdict after each control step, with the states."""

    @property
    def id(self) -> str:
        """The episode's id."""
        return self.performance.episode.id

    @property
    def clips(self) -> int:
        """Clips it took."""
        return len(self.performance.controls) // CLIP_STEPS

    def clip(self, k: int) -> "Demo":
        """One of its clips as a demonstration of its own, its last frame being the next one's first."""
        n, steps = self.shots.frames - 1, CLIP_STEPS
        frames, controls = slice(k * n, (k + 1) * n + 1), slice(k * steps, (k + 1) * steps)
        p, film = self.performance, self.film
        return replace(
            self,
            performance=replace(p, snapshots=p.snapshots[frames], controls=p.controls[controls]),
            film=None
            if film is None
            else replace(
                film,
                **{name: getattr(film, name)[frames] for name in RolloutVideo.__dataclass_fields__ if name != "camera"},
            ),
        )

    def truth(self) -> dict[str, Any]:
        """All that is known of its frames, by name: see docs/suites.md."""
        snapshots, controls, film = self.performance.snapshots, self.performance.controls, self.film
        arrays: dict[str, Any] = {
            "t_s": self.shots.frame_period_s * np.arange(len(snapshots)),
            "q": np.stack([s.q for s in snapshots]),
            "finger_width_m": np.array([s.fingers_m.sum() for s in snapshots]),
            "control_t_s": CONTROL_PERIOD_S * np.arange(len(controls)),
            "control_q": controls[:, :7],
            "control_finger_width_m": controls[:, 7],
        }
        if film is not None:
            arrays |= {"base_from_tcp": film.X_BG, "camera_from_hand": film.X_CH}
            if self.shots.with_depth:
                arrays |= {"depth_mm": film.depth_mm, "mask": np.packbits(film.mask, axis=-1)}
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
