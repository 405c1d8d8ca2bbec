"""Study of a learned world model: cells, correlations, and what a person sees beside the results."""

import json

import numpy as np
import pytest

from benchmarks.footage_labels import read_labels
from benchmarks.generated import (
    LEAST_CELLS,
    PREDICTORS,
    Likeness,
    best_lines,
    correlate,
    correlation_lines,
    gain_text,
    make_cells,
    success_lines,
)
from benchmarks.generated_labels import read_generated_labels
from benchmarks.generated_truth import GripperPath
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.results.row import SampleRow, Status

SPARC = next(k for k, predictor in enumerate(PREDICTORS) if predictor.name == "SPARC")
DISTANCE = next(k for k, predictor in enumerate(PREDICTORS) if predictor.name == "feature distance")


def make_row(task, seed, success, sparc=-3.0, executable=True, sample=0):
    return SampleRow(
        id=f"{task}_s{seed:04d}" + (f"_k{sample}" if sample else ""),
        video="a.mp4",
        task=task,
        model="learned",
        status=Status.OK,
        reason=None,
        content_hash="",
        executable=executable,
        metrics={"sparc": sparc, "manipulability_mean": 0.1, "tracked_fraction": 1.0},
        extra={"success": success, "sample_index": sample},
    )


@pytest.fixture
def trainings():
    """Trainings of growing success, of which SPARC tells the order within a task, and tasks of opposite levels."""
    return {
        f"learned-100-{n}": [
            make_row(task, seed, success=seed < n, sparc=n - 10 * base) for task, base in tasks for seed in range(10)
        ]
        for n in range(1, 9)
        for tasks in [(("A-v1", 0), ("B-v1", 1))]
    }


def test_cells_hold_numbers_with_the_greater_the_better(trainings):
    likeness = {("learned-100-1", "A-v1_s0000"): Likeness(psnr_db=20.0, ssim=0.9, feature_distance=0.25)}
    cells = make_cells(trainings, likeness)
    assert len(cells) == 16
    first = cells[0]
    assert (first.training, first.task, first.success.sum()) == ("learned-100-1", "A-v1", 1)
    assert (first.numbers[:, DISTANCE] == -0.25).all()  # the worst of the study where there is no expert's clip
    assert all(cell.is_mixed for cell in cells)


def test_correlation_within_tasks_removes_their_difficulty(trainings):
    cells = make_cells(trainings, {("learned-100-1", "A-v1_s0000"): Likeness(psnr_db=1, ssim=1, feature_distance=1)})
    over, within = (correlate(cells, within=flag)[SPARC] for flag in (False, True))
    assert within.value == pytest.approx(1.0)
    assert over.value < 0.9
    assert 0.3 < over.low < over.high < 0.9


def test_no_correlation_of_few_cells(trainings):
    cells = make_cells(trainings, {("learned-100-1", "A-v1_s0000"): Likeness(psnr_db=1, ssim=1, feature_distance=1)})
    (line,) = correlation_lines(cells[: LEAST_CELLS - 1])
    assert line.startswith(f"No correlation: {LEAST_CELLS - 1} cells")


def test_success_is_paired_with_that_of_the_still_video(trainings):
    runs = {
        "best": trainings["learned-100-8"],
        "still": [make_row("A-v1", k, success=False) for k in range(10)],
    }
    head, _, best, _ = success_lines(runs)
    assert head.count("|") == best.count("|")
    assert "8 of 10 | 8 of 10 | 80 %" in best
    assert "`still` 80 points" in gain_text(runs)
    assert "(10 episodes)" in gain_text(runs)


def test_choice_takes_the_sample_with_the_best_verdict(tmp_path):
    rows = [
        make_row("A-v1", seed, success=sample == 1, executable=sample == 1, sample=sample)
        for seed in range(6)
        for sample in range(2)
    ]
    (tmp_path / "samples.jsonl").write_text("".join(json.dumps(row.to_json()) + "\n" for row in rows))
    (tmp_path / "results.json").write_text("{}")
    line = best_lines(tmp_path)[2]
    assert line.startswith("| 6 | 2 | 50 % | 100 % | 100 % |")


def test_labels_name_known_points_kinds_and_frames():
    labels = read_generated_labels()
    assert read_labels().videos.keys().isdisjoint(labels.videos)
    seen = {kind for clips in labels.anomalies.values() for kinds in clips.values() for kind in kinds}
    assert seen <= {kind.value for kind in AnomalyKind}
    first = {(id, frame.frame) for id, frames in labels.videos.items() for frame in frames}
    assert {(id, frame.frame) for id, frames in labels.again.items() for frame in frames} <= first
    assert all(
        np.isfinite(list(frame.points_px.values())).all() for frames in labels.videos.values() for frame in frames
    )


def test_numbers_of_a_clip_show_jumps():
    p_C = np.linspace([0, 0, 0.6], [0.1, 0, 0.6], 48)
    assert not GripperPath(p_C=p_C).jumps
    assert GripperPath(p_C=p_C + np.where(np.arange(48)[:, None] < 20, 0.0, [0.0, 0.08, 0.0])).jumps
