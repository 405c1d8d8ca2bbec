"""From an episode's rounds to the cause of its failure."""

from collections.abc import Sequence
from typing import cast

import numpy as np

from kinebench_drake.closed_loop import EpisodeRun
from kinebench_drake.stages import Judgement
from kinebench_drake.suites.closedloop.attribution import Cause, ClipEvidence, attribute


def find_cause(run: EpisodeRun, judgements: Sequence[Judgement]) -> Cause | None:
    """Why an episode failed; None of one that succeeded.

    Args:
        run: the episode.
        judgements: what kinematics says of each clip.
    """
    return None if run.outcome.success else attribute(_evidence(run, judgements), run.outcome.reason)


def _evidence(run: EpisodeRun, judgements: Sequence[Judgement]) -> list[ClipEvidence]:
    """What the rounds left behind, each up to the last executed frame."""
    found = []
    for done, judgement in zip(run.rounds, judgements, strict=True):
        track, execution = done.grounded.track, done.execution
        frames = len(track.t_s) if execution is None else len(execution.snapshots)
        found.append(
            ClipEvidence(
                tracked=track.tracked[:frames],
                anomalies=done.grounded.anomalies,
                X_BG_imagined=track.X_BG[:frames],
                X_BG_executed=np.full((frames, 4, 4), np.nan) if execution is None else execution.X_BG,
                finger_width_imagined_m=track.finger_width_m[:frames],
                finger_width_executed_m=np.full(frames, np.nan) if execution is None else execution.finger_width_m,
                violations=tuple(
                    (str(v["kind"]), cast(int, v["frame_start"]), cast(int, v["frame_end"]))
                    for v in judgement.violations
                ),
            )
        )
    return found
