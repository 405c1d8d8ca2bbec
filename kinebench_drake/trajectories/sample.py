"""One trajectory to work on, before it is read."""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path


class Format(Enum):
    """What a trajectory is stored as."""

    NPZ = "npz"
    CSV = "csv"
    MANISKILL = "maniskill"
    LEROBOT = "lerobot"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectorySample:
    """One trajectory and what its file says about it."""

    id: str
    """Unique, safe as a file name, contains the file's stem or the dataset's name."""
    path: Path
    """The file that holds it; other trajectories may be in it too."""
    video: str
    """The trajectory as results name it: its file relative to what was named, and its part behind a #."""
    format: Format
    part: str | None = None
    """Which one of the file's trajectories: the group of a ManiSkill file, the episode's number of a dataset."""
    about: tuple[Path, ...] = ()
    """Further files that its reading depends on."""
    rate_hz: float | None = None
    """Frames per second that the file's description tells [Hz]; None where the file has times."""
    task: str | None = None
    model: str | None = None
    seed: int | None = None
    prompt: str | None = None
    success: bool | None = None
    """Whether the task's goal was reached, by the file's own account."""
    warnings: tuple[str, ...] = ()
    """What the user should know about it."""
    problem: str | None = None
    """Why it cannot be read at all; None when it can be tried."""
