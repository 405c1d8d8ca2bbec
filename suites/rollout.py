"""The expert's performance of an episode: physics alone, to be filmed later, more than once if need be."""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import CLIP_FRAMES, STEPS_PER_FRAME
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.motion import plan
from kinebench_drake.suites.experts.registry import Expert
from kinebench_drake.suites.stage import Outcome, Snapshot, Stage


@dataclass(frozen=True, slots=True, kw_only=True)
class Performance:
    """One episode as it happened in the simulation."""

    episode: Episode
    """What was to be done."""
    snapshots: tuple[Snapshot, ...]
    """The T moments to film, evenly spaced: `FRAME_PERIOD_S` apart unless asked for otherwise."""
    controls: Array
    """(N, 8) commands at 20 Hz: seven joint angles [rad] and the gap between the finger pads [m]."""
    outcome: Outcome
    """How it ended."""


def perform(stage: Stage, expert: Expert, episode: Episode, *, every: int = STEPS_PER_FRAME) -> Performance:
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
    plant, steps = ArmPlant(), STEPS_PER_FRAME * CLIP_FRAMES
    snapshots, controls = [stage.snapshot()], []
    for _ in range(stage.task.card.clips):
        scene = stage.scene()
        waypoints = expert(scene)
        if not waypoints:
            break
        now = snapshots[-1]
        motion = plan(plant, now.q, float(now.fingers_m.sum()), waypoints, steps, scene)
        for i in range(steps):
            stage.step(motion.q[i], motion.finger_width_m[i])
            if (i + 1) % every == 0:
                snapshots.append(stage.snapshot())
        controls.append(np.column_stack([motion.q, motion.finger_width_m]))
        if stage.outcome().success:
            break
    return Performance(
        episode=episode,
        snapshots=tuple(snapshots),
        controls=np.concatenate(controls) if controls else np.zeros((0, 8)),
        outcome=stage.outcome(),
    )
