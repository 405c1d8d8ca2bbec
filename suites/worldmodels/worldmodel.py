"""What a world model is asked and what it answers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError


class WorldModelError(InputError):
    """A world model gave no video for one request; what it said is the message. Another request may well succeed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """One clip asked of a world model."""

    episode: str
    """Id of the episode, safe as a file name, such as "StackCube-v1_s0003"."""
    task: str
    """Plain task id."""
    round: int
    """0 for the clip that begins the episode, 1 for the one that goes on from its last executed frame, ..."""
    prompt: str
    """What shall happen, in words."""
    negative_prompt: str
    """What shall not be seen; empty if nothing is said."""
    seed: int
    """Seed of the model's own randomness; the same for the same episode, round and run."""
    first_frame: NDArray[np.uint8]
    """(H, W, 3) RGB: what the camera sees now."""
    num_frames: int
    """Frames wanted, the first one included."""
    fps: float
    """Frames per second at which the video shall play."""


@runtime_checkable
class Offline(Protocol):
    """A world model whose videos were made beforehand: it answers the first round of an episode only."""

    def files(self, episode: str, task: str) -> Sequence[Path]:
        """The files that the answer for an episode consists of; none where there is no answer."""
        ...


class WorldModel(Protocol):
    """Turns a first frame and a prompt into a video. One process makes one of it; it is used by one thread.

    The process that begins a run makes one for its name alone where others do the work.
    """

    @property
    def name(self) -> str:
        """How results call it, without secrets, host names or absolute paths."""
        ...

    def generate(self, request: Request, out: Path) -> Path:
        """Make the video of a request.

        Args:
            request: what is asked.
            out: where to put the video, without a suffix; its folder exists. Adapters add ".mp4" or whatever they got.

        Returns:
            The video file, or folder of frames, beside `out`; written whole or not at all.

        Raises:
            WorldModelError: there is no video for this request.
            SetupError: there will be none for any (no key, no such checkpoint, a package is missing).
        """
        ...

    def close(self) -> None:
        """Free what it holds."""
        ...
