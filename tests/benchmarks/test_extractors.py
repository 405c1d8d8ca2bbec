"""Outcomes by extractor: counts with known answers, and the execution of true and estimated tracks."""

from pathlib import Path
from typing import cast

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import extractors
from benchmarks.__main__ import main
from benchmarks.executions import ClipTrack, Extractor
from benchmarks.extractors import Extraction, changed, section
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.catalog import load_suite
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.track import GripperTrack
from training.baseline.network import Baseline


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


class Recall:
    """A baseline that sees the gripper at x = 1 in every frame."""

    def track(self, frames: Array, t_s: Array, camera: Camera) -> GripperTrack:
        X_BG = np.tile(make_pose(np.eye(3), [1.0, 0.0, 0.0]), (len(frames), 1, 1))
        every = np.ones(len(frames), dtype=bool)
        return GripperTrack(
            t_s=t_s, X_CH=X_BG, X_BG=X_BG, tracked=every, confidence=every * 1.0, finger_width_m=np.zeros(len(frames))
        )


def test_a_clip_is_read_by_its_extractor(tmp_path: Path) -> None:
    X_BG = np.tile(np.eye(4), (5, 1, 1))
    X_BG[3] = np.nan
    np.savez(tmp_path / "truth.npz", t_s=np.arange(5.0), base_from_tcp=X_BG, finger_width_m=np.zeros(5))
    np.save(tmp_path / "video.npy", np.zeros((5, 8, 8, 3), np.uint8))
    spec = load_suite(2).specs("unseen", 1, tasks=["PullCube-v1"])[0]

    def read(extractor: Extractor, source: str) -> GripperTrack:
        clip = ClipTrack(id="a", spec=spec, extractor=extractor, source=tmp_path / source)
        return clip.read(cast(Baseline, Recall()))

    truth = read(Extractor.TRUTH, "truth.npz")
    assert truth.tracked.tolist() == [True, True, True, False, True]
    baseline = read(Extractor.BASELINE, "video.npy")
    assert (baseline.X_BG[:, 0, 3] == 1.0).all()
    np.testing.assert_allclose(np.diff(baseline.t_s), FRAME_PERIOD_S)
    with pytest.raises(InputError):
        read(Extractor.TRUTH, "absent.npz")


def test_a_folder_without_a_study_is_refused(tmp_path: Path) -> None:
    weights = tmp_path / "w.safetensors"
    weights.write_bytes(b"")
    result = CliRunner().invoke(main, ["extractors", str(tmp_path), "--baseline", str(weights)])
    assert result.exit_code == 2
    assert "validity measure" in result.output
