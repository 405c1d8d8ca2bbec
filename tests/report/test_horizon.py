"""Deviation over the frames by model: medians with clips that do not drift, and the figure."""

import numpy as np
import pytest

from kinebench_drake.report.horizon import draw_horizon, horizon_lines
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack
from tests.report.pages import row

FRAMES = 10


@pytest.fixture
def rows(tmp_path):
    """Four clips of each of two models, of which one drifts in three, the other in one."""
    made = []
    for model, onsets in (("a", (4, 5, 6, None)), ("b", (None, None, None, 8))):
        for k, onset in enumerate(onsets):
            clip = row(f"{model}{k}", model=model, metrics={})
            made.append(clip.extended(follows=onset is None, deviation_m=0.01 * (k + 1), drift_from_frame=onset))
            track = GripperTrack.untracked(0.2 * np.arange(FRAMES))
            write_track(artifact_path(tmp_path, "tracks", clip.id), track, None, {"deviation_m": np.full(FRAMES, 0.01)})
    return made


def test_medians_count_clips_that_do_not_drift_as_later_than_any(rows):
    first, second = horizon_lines(rows, seed=0)
    assert first.startswith(
        "a: 3 of 4 clips drift; half drift by frame 6 (4 to none); median deviation [mm] 30.0 (10.0"
    )
    assert second.startswith("b: 1 of 4 clips drift; half drift by frame none (8 to none)")


def test_the_figure_names_the_models_and_none_is_drawn_without_curves(rows, tmp_path):
    drawing = draw_horizon(tmp_path, rows)
    assert "not drifted" in drawing
    assert all(f">{model}<" in drawing for model in "ab")
    assert draw_horizon(tmp_path / "elsewhere", rows) is None
    assert draw_horizon(tmp_path, [row("scored", metrics={})]) is None
