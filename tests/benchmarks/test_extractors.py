"""Outcomes by extractor: counts with known answers, and the execution of true and estimated tracks."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import extractors
from benchmarks.__main__ import main
from benchmarks.extractors import Extraction, ExtractionItem, Extractor, changed, section
from benchmarks.validity import ExecutionWorker, TrackExecution
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.geometry import Array
from kinebench_drake.suites.catalog import EpisodeSpec, load_suite
from kinebench_drake.track import GripperTrack


def extraction(
    episode: int, truth: bool, grounding: bool, baseline: bool, kind: AnomalyKind | None = None
) -> Extraction:
    success = {Extractor.TRUTH: truth, Extractor.GROUNDING: grounding, Extractor.BASELINE: baseline}
    return Extraction(
        id=f"{episode}_{kind}", episode=str(episode), kind=kind, trained=episode % 2 == 0, success=success
    )


@pytest.fixture(scope="module")
def extractions() -> list[Extraction]:
    """The grounding loses one video of 20, the baseline loses 10 and gains 5."""
    clean = [extraction(i, truth=True, grounding=i > 0, baseline=False) for i in range(10)]
    return clean + [
        extraction(i, truth=False, grounding=False, baseline=i < 5, kind=AnomalyKind.VANISH) for i in range(10)
    ]


def test_changed_verdicts_are_those_that_differ_from_the_true_track(extractions: list[Extraction]) -> None:
    assert changed(extractions, Extractor.TRUTH).value == 0.0
    assert changed(extractions, Extractor.GROUNDING).value == pytest.approx(0.05)
    assert changed(extractions, Extractor.BASELINE).value == pytest.approx(0.75)
    estimate = changed(extractions, Extractor.BASELINE)
    assert estimate.low <= estimate.value <= estimate.high


def test_intervals_are_over_episodes_and_not_videos() -> None:
    twice = [extraction(i, True, i % 2 == 0, True, kind) for i in range(8) for kind in (None, AnomalyKind.FREEZE)]
    once = [e for e in twice if e.kind is None]
    two = changed(twice, Extractor.GROUNDING)
    one = changed(once, Extractor.GROUNDING)
    assert (two.value, two.low, two.high) == (one.value, one.low, one.high)


def test_a_share_of_zero_has_an_interval_above_zero(extractions: list[Extraction]) -> None:
    estimate = changed(extractions, Extractor.TRUTH)
    assert estimate.low == 0.0
    assert 0.1 < estimate.high < 0.4


def test_a_single_episode_has_no_bootstrap_interval() -> None:
    mixed = [extraction(0, True, True, True), extraction(0, True, False, True, AnomalyKind.FREEZE)]
    estimate = changed(mixed, Extractor.GROUNDING)
    assert estimate.value == 0.5
    assert np.isnan([estimate.low, estimate.high]).all()


def test_the_section_has_a_row_for_each_group(extractions: list[Extraction], tmp_path: Path) -> None:
    text = section(extractions, "1,000 demonstrations")
    assert "| all videos | 20 | 50% | 45% | 25% | 5% [" in text
    assert "`vanish`" not in text  # the grounding changes none of its outcomes
    changing = [extraction(k, True, False, True, AnomalyKind.FREEZE) for k in range(10)]
    assert "| `freeze` | 10 | 100% | 0% | 100% |" in section([*extractions, *changing], "1,000 demonstrations")
    extractors.draw(extractions).savefig(tmp_path / "figure.png")


class _Recorder(ExecutionWorker):
    """Accepts tracks that start at x = 0."""

    def __init__(self) -> None:
        pass

    def execute(self, spec: EpisodeSpec, track: GripperTrack) -> TrackExecution:
        return TrackExecution(success=bool(track.X_BG[0, 0, 3] == 0.0), reason=str(int(track.tracked.sum())))


class _FixedBaseline:
    def predict(self, frames: Array) -> tuple[Array, Array]:
        return np.tile(np.eye(4), (len(frames), 1, 1)) + 1.0, np.zeros(len(frames))


def test_the_worker_takes_the_track_of_its_extractor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    X_BG = np.tile(np.eye(4), (5, 1, 1))
    X_BG[3] = np.nan
    np.savez(tmp_path / "a.npz", t_s=np.arange(5.0), base_from_tcp=X_BG, finger_width_m=np.zeros(5))
    monkeypatch.setattr(extractors, "ExecutionWorker", _Recorder)
    monkeypatch.setattr(extractors.Baseline, "load", lambda _: _FixedBaseline())
    monkeypatch.setattr(extractors, "read_video", lambda _: type("V", (), {"frames": np.zeros((5, 8, 8, 3), np.uint8)}))
    worker = extractors._Worker(tmp_path / "weights")
    spec = load_suite(2).specs("unseen", 1, tasks=["PullCube-v1"])[0]

    def run(extractor: Extractor, truth: str) -> TrackExecution:
        return worker(
            ExtractionItem(id="a", spec=spec, video=tmp_path / "a.mp4", truth=tmp_path / truth, extractor=extractor)
        )

    assert run(Extractor.TRUTH, "a.npz") == TrackExecution(success=True, reason="4")
    assert run(Extractor.BASELINE, "a.npz") == TrackExecution(success=False, reason="5")
    assert not run(Extractor.TRUTH, "absent.npz").success


def test_a_folder_without_a_study_is_refused(tmp_path: Path) -> None:
    weights = tmp_path / "w.safetensors"
    weights.write_bytes(b"")
    result = CliRunner().invoke(main, ["extractors", str(tmp_path), "--baseline", str(weights)])
    assert result.exit_code == 2
    assert "validity measure" in result.output
