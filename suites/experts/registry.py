"""The experts by task id."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.suites.experts.cubes import pick_cube, pull_cube, stack_cube
from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.experts.peg import lift_peg_upright


@dataclass(frozen=True, slots=True, kw_only=True)
class Expert:
    """How one task is done."""

    task: str
    """ManiSkill environment id."""
    prompt: str
    """The task in words, as a world model is asked."""
    waypoints: Callable[[Array, Mapping[str, Array]], Sequence[Waypoint]]
    """From the gripper's start pose (4, 4) in B and the poses of the objects by name, the moves to make."""
    frames: int = 49
    """Video frames the task takes, the first included."""


EXPERTS = {
    expert.task: expert
    for expert in (
        Expert(
            task="StackCube-v1",
            prompt="The robot arm picks up the red cube, puts it on the green cube and lets go.",
            waypoints=stack_cube,
        ),
        Expert(
            task="PullCube-v1",
            prompt="The robot arm drags the blue cube back onto the red and white target with its closed gripper.",
            waypoints=pull_cube,
        ),
        Expert(
            task="LiftPegUpright-v1",
            prompt="The robot arm grasps the red end of the peg, stands the peg upright and lets go.",
            waypoints=lift_peg_upright,
        ),
        Expert(
            task="PickCube-v1",
            prompt="The robot arm picks up the red cube and holds it in the air.",
            waypoints=pick_cube,
        ),
    )
}


def find_expert(task: str) -> Expert:
    """The expert of a task.

    Raises:
        UsageError: there is none.
    """
    if task not in EXPERTS:
        raise UsageError(f"no expert for task {task!r}; there are {', '.join(EXPERTS)}")
    return EXPERTS[task]
