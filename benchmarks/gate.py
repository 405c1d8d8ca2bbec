"""The gate: short clips of several programs, presented rightly and wrongly, of which none may be silently wrong."""

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.perception.clip import find_clips
from benchmarks.presentations import Outcome, Presentation, Trial, Verdict, measure
from kinebench_drake.executors.base import Executor, Observer

CLIPS = Path("tests/gate")
"""Folder of the clips, each with its truth, and of their bounds."""
CLIPS_VARIABLE = "KINEBENCH_GATE_CLIPS"
"""Environment variable with a further folder, whose clips must not be wrong however they are presented."""
_EXTRA = (Presentation.NAMED, Presentation.PLAIN, Presentation.MIRRORED)


def find_trials(folder: Path, extra: Path | None) -> tuple[list[Trial], dict[tuple[str, str], str]]:
    """Return the trials of the gate, and the verdict that each must have; "" for any but wrong.

    Args:
        folder: clips, and `bounds.json`: by clip and presentation the verdict, or the reading that must be named.
        extra: a further folder of clips; None: none.

    Raises:
        UsageError: a folder has no clips with truth.
    """
    bounds = json.loads((folder / "bounds.json").read_text())
    trials, expected = [], {}
    for clip in find_clips(folder):
        for name, verdict in bounds[clip.id].items():
            trials.append(Trial(clip=clip, presentation=Presentation(name)))
            expected[clip.id, name] = verdict
    for clip in find_clips(extra) if extra is not None else ():
        trials += [Trial(clip=clip, presentation=presentation) for presentation in _EXTRA]
    return trials, expected


def check_outcomes(outcomes: Sequence[Outcome], expected: dict[tuple[str, str], str]) -> list[str]:
    """Return a line for each outcome that does not hold: wrong, or not the expected verdict or reading."""
    faults = []
    for outcome in outcomes:
        wanted = expected.get((outcome.id, outcome.presentation), "")
        name = f"{outcome.id}, {outcome.presentation.replace('_', ' ')}"
        if outcome.verdict is Verdict.WRONG and outcome.position_m is not None:
            faults.append(f"{name}: silently wrong by {1e3 * outcome.position_m:.0f} mm (camera {outcome.state})")
        elif wanted and wanted not in (outcome.verdict.value, outcome.reading):
            faults.append(f"{name}: {outcome.verdict.value}, expected {wanted}: {outcome.reason or 'no reason'}")
    return faults


def run_gate(folder: Path, extra: Path | None, executor: Executor, observer: Observer) -> list[str]:
    """Ground the clips of the gate and return what does not hold; see `find_trials` and `check_outcomes`."""
    trials, expected = find_trials(folder, extra)
    return check_outcomes(measure(trials, executor, observer), expected)
