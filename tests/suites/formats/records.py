"""Demonstrations and their records, made from one that was filmed."""

from dataclasses import replace

import numpy as np

from kinebench_drake.suites.export import episode_facts
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.formats.demo import Demo, Record
from kinebench_drake.suites.rollout import RolloutVideo


def record_of(demo: Demo) -> Record:
    episode = demo.rollout.episode
    return Record(
        id=episode.id, task=episode.task, seed=episode.seed, prompt=episode.prompt, success=True, reason="",
        progress=1.0, clips=demo.clips, facts=episode_facts(episode),
    )  # fmt: skip


def doubled(demo: Demo) -> Demo:
    """The demonstration twice in a row, as one of a task that may take so long."""
    p, film = demo.rollout, demo.video
    assert film is not None
    episode = replace(p.episode, task=next(task for task in TASKS if TASKS[task].card.clips > 1))
    return replace(
        demo,
        rollout=replace(
            p, episode=episode, snapshots=(*p.snapshots, *p.snapshots[1:]), controls=np.tile(p.controls, (2, 1))
        ),
        video=replace(film, **{n: np.concatenate([getattr(film, n), getattr(film, n)[1:]])
                              for n in RolloutVideo.__dataclass_fields__ if n != "camera"}),
    )  # fmt: skip
