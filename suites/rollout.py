"""The expert's performance of an episode: physics alone, to be filmed later, more than once if need be."""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import CLIP_FRAMES, STEPS_PER_FRAME
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.motion import plan
from kinebench_drake.suites.experts.registry import Expert
from kinebench_drake.suites.simulator import Simulator, Snapshot, TaskOutcome


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """One episode as it happened in the simulation."""

    episode: Episode
    """What was to be done."""
    snapshots: tuple[Snapshot, ...]
    """The T moments to film, evenly spaced: `FRAME_PERIOD_S` apart unless asked for otherwise."""
    controls: Array
    """(N, 8) commands at 20 Hz: seven joint angles [rad] and the gap between the finger pads [m]."""
    outcome: TaskOutcome
    """How it ended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutSegment:
    """One clip's worth of a performance."""

    snapshots: tuple[Snapshot, ...]
    """The moments to film, without the one it began with."""
    controls: Array
    """(N, 8) commands, as in `Performance`."""


def rollout_clip(stage: Simulator, expert: Expert, *, every: int = STEPS_PER_FRAME) -> RolloutSegment | None:
    """Let the expert go on with its task from the present state, for one clip; None if there is nothing left to do.

    Raises:
        InputError: the expert finds no path in this scene.
    """
    scene, now = stage.scene(), stage.snapshot()
    waypoints = expert(scene)
    if not waypoints:
        return None
    motion = plan(ArmPlant(), now.q, float(now.fingers_m.sum()), waypoints, STEPS_PER_FRAME * CLIP_FRAMES, scene)
    snapshots = []
    for i, (q, finger_width_m) in enumerate(zip(motion.q, motion.finger_width_m, strict=True), 1):
        stage.step(q, finger_width_m)
        if i % every == 0:
            snapshots.append(stage.snapshot())
    return RolloutSegment(snapshots=tuple(snapshots), controls=np.column_stack([motion.q, motion.finger_width_m]))


def rollout(stage: Simulator, expert: Expert, episode: Episode, *, every: int = STEPS_PER_FRAME) -> Rollout:
    """Let the expert do its task, clip by clip; nothing is rendered. It ends at success or after the task's clips.

    Args:
        stage: where to do it; it is reset.
        expert: who does it.
        episode: what is to be done.
        every: control steps between two snapshots.

    Raises:
        InputError: the expert finds no path in this scene.
    """
    stage.reset(episode)
    snapshots, controls = [stage.snapshot()], [np.zeros((0, 8))]
    for _ in range(stage.task.card.clips):
        clip = rollout_clip(stage, expert, every=every)
        if clip is None:
            break
        snapshots += clip.snapshots
        controls.append(clip.controls)
        if stage.outcome().success:
            break
    return Rollout(
        episode=episode,
        snapshots=tuple(snapshots),
        controls=np.concatenate(controls),
        outcome=stage.outcome(),
    )
