from pathlib import Path

import numpy as np
import pytest

from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.perturbation.catalogue import PerturbationKind
from benchmarks.perception.study import TRUE_DEPTH, StudyOutcome, robustness
from benchmarks.perception.tables import compared
from benchmarks.perception.trial import TrialCondition
from benchmarks.robustness import draw, figures, section

FRAMES = 10
REQUIRED = "noise 20/255"
Conditions = tuple[TrialCondition, ...]


def clip_errors(task: str, position_m: float, tracked: int) -> ClipErrors:
    n = np.full(FRAMES, np.nan)
    followed = np.arange(FRAMES) < tracked
    return ClipErrors(
        id=f"{task}_s0",
        task=task,
        position_m=np.where(followed, position_m, np.nan),
        rotation_rad=np.where(followed, 0.02, np.nan),
        width_m=n,
        true_width_m=n,
        tracked=followed,
        confidence=followed.astype(np.float64),
        visible=np.ones(FRAMES, dtype=bool),
        share=np.ones(FRAMES),
        detected=(),
        planted=(),
        cpu_s=1.0,
    )


@pytest.fixture
def conditions(tmp_path: Path) -> Conditions:
    weights = tmp_path / "baseline.safetensors"
    weights.write_bytes(b"")
    return robustness([PerturbationKind.NOISE], weights)


def outcome(conditions: Conditions, tracked: int = FRAMES) -> StudyOutcome:
    """Grounding: 1 mm with true depth, else 2 mm; baseline: 10 mm on `Known-v1`, 50 mm on `Other-v1`."""

    def of(condition: TrialCondition) -> list[ClipErrors]:
        if condition.baseline is not None:
            return [clip_errors("Known-v1", 0.010, FRAMES), clip_errors("Other-v1", 0.050, FRAMES)]
        position_m = {TRUE_DEPTH.name: 0.001, "as it is": 0.002}.get(condition.name, 0.003)
        return [clip_errors(task, position_m, tracked) for task in ("Known-v1", "Other-v1")]

    results = {condition.name: of(condition) for condition in conditions}
    return StudyOutcome(conditions=conditions, results=results, figures=compared(results, 0))


def test_rows_hold_both_extractors(conditions: Conditions) -> None:
    text = section(outcome(conditions), "few demonstrations")
    rows = {line.split(" | ")[0].removeprefix("| "): line.split(" | ") for line in text.splitlines() if "| " in line}
    assert "few demonstrations" in " ".join(text.split())
    assert rows["true depth"][2].startswith("1.0 ")
    assert not rows["true depth"][5].strip(" |")
    assert rows["as it is"][5].startswith("30.0 ")
    assert {name for name in rows if name.startswith("noise")} == {REQUIRED}


def test_lost_frames_worsen_the_share_of_tracked_frames(conditions: Conditions) -> None:
    whole = figures(outcome(conditions))
    half = figures(outcome(conditions, tracked=FRAMES // 2))
    assert whole.keys() == half.keys()
    assert {name for name in whole if whole[name] != half[name]} == {
        name for name in whole if name.startswith("grounding") and name.endswith("not tracked")
    }
    assert half["grounding, as it is, not tracked"] == pytest.approx(0.5)


def test_the_drawing_has_a_row_for_each_condition_of_the_grounding(conditions: Conditions) -> None:
    ax = draw(outcome(conditions)).axes[0]
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert labels[:2] == ["true depth", "as it is"]
    assert len(labels) == 1 + 1 + 3
    assert sum(label.endswith(" *") for label in labels) == 1
