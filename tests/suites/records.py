"""Records of rollouts, and rollouts of two clips."""

from dataclasses import replace

import numpy as np

from kinebench_drake.suites.demo_config import CLIP_STEPS
from kinebench_drake.suites.demo_formats import Record
from kinebench_drake.suites.export import episode_facts
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.rollout import Rollout


def record_of(rollout: Rollout) -> Record:
    episode = rollout.episode
    return Record(
        id=episode.id, task=episode.task, seed=episode.seed, prompt=episode.prompt, success=True, reason="",
        progress=1.0, clips=len(rollout.controls) // CLIP_STEPS, facts=episode_facts(episode),
    )  # fmt: skip


def doubled(rollout: Rollout) -> Rollout:
    """The rollout twice in a row, as one of a task that may take so long."""
    return replace(
        rollout,
        episode=replace(rollout.episode, task=next(task for task in TASKS if TASKS[task].card.clips > 1)),
        snapshots=(*rollout.snapshots, *rollout.snapshots[1:]),
        controls=np.tile(rollout.controls, (2, 1)),
    )
