"""Studies with fake workers."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.perception import study
from benchmarks.perception.clip import TruthClip, choose, find_clips
from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.perturbation.catalogue import PerturbationKind
from benchmarks.perception.store import MeasurementStore
from benchmarks.perception.study import StudyOutcome
from benchmarks.perception.tables import pooled_lines, task_table
from benchmarks.perception.trial import GroundingTrial, evaluate_baseline
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import ExecutorKind, Observer, create_executor
from kinebench_drake.geometry import Array, invert
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import hand_from_tcp
from kinebench_drake.track import GripperTrack
from training.baseline.network import Baseline

EXECUTOR = create_executor(ExecutorKind.LOCAL, 1)


class SilentObserver(Observer):
    completed = 0

    def start(self, total: int, completed: int) -> None:
        self.completed = completed


class FakeWorkers:
    """Errors that grow with the strength of the perturbation; stops like a killed program after so many trials."""

    def __init__(self, errors: Callable[..., ClipErrors], patience: int = 10_000) -> None:
        self.errors = errors
        self.patience = patience
        self.made = 0

    def __call__(self) -> Callable[[GroundingTrial], ClipErrors]:
        def measure(trial: GroundingTrial) -> ClipErrors:
            if self.made == self.patience:
                raise KeyboardInterrupt
            self.made += 1
            p = trial.condition.perturbation
            return replace(self.errors(0.001 * (1 + (p.strength if p else 0))), id=trial.clip.id, task=trial.clip.task)

        return measure


class Recall:
    """A baseline that knows the poses, and is off by a distance [m] along the base's z axis."""

    def __init__(self, clip: TruthClip, offset_m: float) -> None:
        self.clip = clip
        self.X_BG = clip.camera.X_BC @ clip.X_CH @ hand_from_tcp()
        self.X_BG[:, 2, 3] += offset_m

    def track(self, frames: Frames, t_s: Array, camera: Camera) -> GripperTrack:
        return GripperTrack(
            t_s=t_s,
            X_CH=invert(camera.X_BC) @ self.X_BG @ invert(hand_from_tcp()),
            X_BG=self.X_BG,
            tracked=np.ones(len(frames), dtype=bool),
            confidence=np.ones(len(frames)),
            finger_width_m=self.clip.finger_width_m,
        )


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "baseline.safetensors"
    path.write_bytes(b"one")
    return path


@pytest.mark.parametrize("offset_m", [0.0, 0.08])
def test_errors_of_the_baseline_equal_its_offset_from_the_truth(clip: TruthClip, offset_m: float) -> None:
    n = len(clip.t_s)
    share = np.full(n, 0.5)
    e = evaluate_baseline(clip, cast(Baseline, Recall(clip, offset_m)), np.zeros((n, 8, 8, 3), np.uint8), share)
    np.testing.assert_allclose(e.position_m, offset_m, atol=1e-9)
    np.testing.assert_allclose(e.rotation_rad, 0.0, atol=1e-6)
    np.testing.assert_allclose(e.finger_m, 0.0)
    assert e.tracked.all()
    np.testing.assert_array_equal(e.share, share)


def test_every_perturbation_is_measured_on_both_extractors(weights: Path) -> None:
    true_depth, *both = study.robustness([PerturbationKind.NOISE], weights)
    own = both[::2]
    learned = both[1::2]
    assert true_depth is study.TRUE_DEPTH
    assert [c.perturbation for c in learned] == [c.perturbation for c in own]
    assert all(c.name.endswith(study.LEARNED) for c in learned)
    before = {c.identity() for c in both}
    assert len(before) == len(both)
    assert not any(str(weights.parent) in identity for identity in before)
    weights.write_bytes(b"other")
    assert before & {c.identity() for c in both} == {c.identity() for c in own}


def run(
    plan: study.StudyPlan, workers: FakeWorkers, weights: Path, observer: SilentObserver | None = None
) -> StudyOutcome:
    conditions = study.robustness([PerturbationKind.NOISE], weights)[1:]
    return study.run_study(conditions, plan, EXECUTOR, observer or SilentObserver(), workers)


def test_an_interrupted_study_resumes_and_equals_an_uninterrupted_one(
    folder: Path, tmp_path: Path, weights: Path, errors: Callable[..., ClipErrors]
) -> None:
    plan = study.StudyPlan(folder=folder, keep=tmp_path / "kept.clips.jsonl")
    with pytest.raises(KeyboardInterrupt):
        run(plan, FakeWorkers(errors, patience=5), weights)
    with (tmp_path / "kept.clips.jsonl").open("a") as file:
        file.write('{"key": "torn')
    second = FakeWorkers(errors)
    observer = SilentObserver()
    whole = run(plan, second, weights, observer)
    assert observer.completed == 5
    assert second.made == 3 * 8 - 5
    fresh = run(replace(plan, keep=None), FakeWorkers(errors), weights)
    assert list(whole.lines()) == list(fresh.lines())
    third = FakeWorkers(errors)
    run(replace(plan, seed=1), third, weights)
    assert third.made == 3 * 8  # another seed's measurements are no measurements of this one


def test_the_table_has_a_row_per_condition_with_its_interval(
    folder: Path, weights: Path, errors: Callable[..., ClipErrors]
) -> None:
    outcome = run(study.StudyPlan(folder=folder), FakeWorkers(errors), weights)
    lines = list(outcome.lines())
    assert lines[0].startswith("3 videos, 36 frames")
    (row,) = [line for line in lines if line.startswith("| noise 20/255 |")]
    assert "21.00 [21.00, 21.00]" in row
    assert outcome.figures["as it is"]["position_median_mm"].value == pytest.approx(1.0)


def test_the_error_budget_replaces_one_estimate_at_a_time_by_the_truth(
    folder: Path, errors: Callable[..., ClipErrors]
) -> None:
    plan = study.StudyPlan(folder=folder)
    outcome = study.run_study(study.BUDGET, plan, EXECUTOR, SilentObserver(), FakeWorkers(errors))
    text = "\n".join(outcome.lines())
    assert all(
        name in text for name in ("pixels only", "true mask", "true depth", "true start pose", "true finger opening")
    )


def test_clips_are_chosen_from_tasks_in_turn(folder: Path) -> None:
    clips = find_clips(folder)
    assert [c.id for c in choose(clips, 2)] == ["A-v1_s0", "B-v1_s0"]
    assert [c.id for c in choose(clips, None)] == ["A-v1_s0", "A-v1_s1", "B-v1_s0"]


def test_mask_and_depth_of_a_clip_are_read_as_written(folder: Path) -> None:
    clip = find_clips(folder)[0].load(with_depth=True)
    assert clip.task == "A-v1"
    assert clip.mask is not None
    assert clip.depth_m is not None
    assert clip.depth_m[clip.mask].min() == pytest.approx(0.7005)
    assert clip.mask.sum(axis=(1, 2)).tolist() == [900] * 12


def test_folders_without_manifest_or_ground_truth_are_refused(folder: Path, tmp_path: Path) -> None:
    (folder / "truth" / "B-v1_s0.npz").unlink()
    with pytest.raises(UsageError, match=r"B-v1_s0\.npz is missing"):
        find_clips(folder)
    (folder / "manifest.jsonl").unlink()
    with pytest.raises(UsageError, match=r"no manifest\.jsonl"):
        find_clips(folder)


def test_a_jsonl_file_without_measurements_is_refused_as_store(tmp_path: Path) -> None:
    path = tmp_path / "other.jsonl"
    path.write_text('{"key": "a", "size": 3}\n')
    with pytest.raises(UsageError, match="no measurements"):
        MeasurementStore(path, ClipErrors)


def test_tables_have_a_line_per_figure_and_per_task(errors: Callable[..., ClipErrors]) -> None:
    results = [errors(0.004), replace(errors(0.006), id="other", task="Z-v1")]
    (line,) = [line for line in pooled_lines(results, 0) if line.startswith("position_median_mm")]
    assert line.split()[1] == "5"
    assert [row.split()[1] for row in task_table(results)] == ["task", "---", "Some-v1", "Z-v1"]


@pytest.mark.parametrize("name", ["evaluate", "budget"])
def test_commands_have_help_with_an_example(name: str) -> None:
    result = CliRunner().invoke(main, [name, "--help"])
    assert result.exit_code == 0
    assert f"python -m benchmarks {name} heldout" in result.output
