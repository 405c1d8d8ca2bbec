"""What a task is like, as data."""

from dataclasses import dataclass
from enum import Enum


class Difficulty(Enum):
    """How much a task asks of a robot."""

    EASY = "easy"
    """One push or one grasp."""
    MEDIUM = "medium"
    """A grasp with a precise release, or contact that must be kept."""
    HARD = "hard"
    """Prying, or several steps one after the other."""


class TaskVariant(Enum):
    """Versions of a task's scene."""

    PLAIN = "plain"
    OBSTACLES = "obstacles"
    """Something stands in the way that must not be knocked over."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskCard:
    """A task in figures."""

    id: str
    """Plain id such as "StackCube-v1"."""
    family: str
    """Things it is about, such as "boxes"."""
    difficulty: Difficulty
    articulated_dof: int
    """Joints of the things in the scene."""
    axes: str
    """World axes of these joints, such as "z"; empty without."""
    contacts: int
    """Times the gripper touches something anew: grasps, pushes, pries."""
    clips: int = 1
    """Clips of 49 frames that the expert takes; each begins and ends at rest."""
    variants: tuple[TaskVariant, ...] = (TaskVariant.PLAIN,)

    @property
    def horizon(self) -> int:
        """Frames that the expert takes, the first included."""
        return 48 * self.clips + 1
