"""World model interface: request, answer, and the protocols that an adapter may implement."""

import os
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, KinebenchError, cause
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import Json

if TYPE_CHECKING:  # naming a world model should not load the assets
    from kinebench_drake.suites.composition import Episode
    from kinebench_drake.suites.simulator import SimulatorState

DECIMALS = 9
"""Decimals of actions in requests."""


class Condition(Enum):
    """What a request states of the motion that the clip should show."""

    NONE = "none"
    """The prompt alone."""
    ACTIONS = "actions"
    """The expert's track, too."""


class WorldModelError(InputError):
    """No video for one request; another request may succeed. The message is what the model or service reported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionTrack:
    """Commanded motion of the robot in a clip: the states that it should show, one per frame."""

    t_s: Array
    """(T,) task time since the first frame [s]."""
    X_BG: Array
    """(T, 4, 4) panda_hand_tcp in the robot base frame [m]."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""
    q: Array
    """(T, 7) joint angles of the arm [rad]."""

    def to_json(self) -> dict[str, Json]:
        """Serialize with the names of track files."""
        arrays = {"t_s": self.t_s, "base_from_tcp": self.X_BG, "finger_width_m": self.finger_width_m, "q": self.q}
        return {name: (array.round(DECIMALS) + 0.0).tolist() for name, array in arrays.items()}  # no -0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Request for one clip."""

    episode: str
    """Id of the episode, safe as a file name, such as "StackCube-v1_s0003"; of further samples "..._k1", "..._k2"."""
    task: str
    round: int
    """0 for the first clip of the episode, 1 for the one that continues from its last executed frame, ..."""
    prompt: str
    negative_prompt: str
    """Content to avoid; may be empty."""
    seed: int
    """Seed of the model's randomness; the same for the same episode, sample, round and run."""
    first_frame: NDArray[np.uint8]
    """(H, W, 3) RGB: current camera image."""
    num_frames: int
    """Requested number of frames, including the first one."""
    fps: float
    """Playback rate of the video [frames/s]."""
    actions: ActionTrack | None = None
    """Motion that the clip should show, for action-conditioned models; None without `--condition actions`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueTrack:
    """Ground-truth gripper track of a clip."""

    X_CH: Array
    """(T, 4, 4) panda_hand in the camera frame [m]."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""


class WorldModel(Protocol):
    """Generates a video from a first frame and a prompt. One instance per process, used by one thread.

    Where workers generate the videos, the process that starts the run creates an instance for its name only.
    """

    name: str
    """Name in the results, without secrets or absolute paths."""

    def generate(self, request: Request, out: Path) -> Path:
        """Generate the video of a request.

        Args:
            out: path of the video without a suffix; its folder exists. Adapters append ".mp4" or the actual suffix.

        Returns:
            The video file, or folder of frames, beside `out`; written whole or not at all.

        Raises:
            WorldModelError: there is no video for this request.
            SetupError: no request can succeed (no key, no such checkpoint, a package is missing).
        """

    def close(self) -> None:
        """Release all resources; by default there are none."""
        return


@runtime_checkable
class OfflineModel(Protocol):
    """World model whose videos are generated outside of the run: an episode goes on as far as they exist."""

    def files(self, episode: str, task: str, round: int) -> Sequence[Path]:
        """Return the files of the answer for a round of an episode; none where there is no answer yet."""


@runtime_checkable
class SupportsCheck(Protocol):
    """World model whose service can be found missing before the first request."""

    def check(self) -> None:
        """Check that requests can be sent.

        Raises:
            SetupError: they cannot.
        """


@runtime_checkable
class ChoosesLength(Protocol):
    """World model whose clips may have another number of frames than requested, by its own choice."""

    @property
    def chooses_length(self) -> bool:
        """True if the number of frames of the clip generated last was the model's own choice."""


@runtime_checkable
class PrivilegedModel(Protocol):
    """World model that receives the simulator state before each request."""

    def set_state(self, episode: "Episode", state: "SimulatorState") -> None:
        """Set the state from which the next clip begins."""


@runtime_checkable
class SupportsTrueTrack(Protocol):
    """World model that can report the ground-truth track of its clips, which replaces grounding."""

    def true_track(self) -> TrueTrack | None:
        """Return the track of the clip generated last; None where the model does not disclose it."""


def request_video(model: WorldModel, request: Request, out: Path) -> Path:
    """Return the answer of a world model, which exists; the traceback of any other error is written beside `out`.

    Raises:
        InputError: `generate` raised an error that it should not raise, or returned something else than a path.
        KinebenchError: it raised this error.
    """
    try:
        answer: object = model.generate(request, out)
    except KinebenchError:
        raise
    except Exception as error:  # code of the user, which may raise anything
        file = out.with_name(f"{out.name}_error.txt")
        write_atomically(file, _format_traceback(error).encode())
        raise InputError(
            f"the world model raised {type(error).__name__}: {cause(error)}; its traceback is in "
            f"{file.parent.name}/{file.name}"
        ) from error
    if isinstance(answer, str | os.PathLike) and Path(answer).exists():
        return Path(answer)
    raise InputError(
        f"generate returned a {type(answer).__name__} that is no file, expected the path of the video that it wrote, "
        'such as out.with_name(out.name + ".mp4"), or of a folder of frames; `kinebench_drake.write_video(path, '
        "frames, request.fps)` writes an array of frames (T, H, W, 3) uint8"
    )


def _format_traceback(error: Exception) -> str:
    """Format an error with those that led to it; files by their names, as output folders hold no absolute paths."""
    trace = traceback.TracebackException.from_exception(error)
    link: traceback.TracebackException | None = trace
    while link is not None:
        for frame in link.stack:
            frame.filename = Path(frame.filename).name
        link = link.__cause__ or link.__context__
    return "".join(trace.format())
