"""Clips judged one by one and combined: the jump between two of them is no motion."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.geometry import make_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.suites.runs.clips import combine, join_tracks
from kinebench_drake.track import GripperTrack

Q = np.array([0.0, 0.3, 0.0, -2.0, 0.0, 2.2, 0.8])
N = 25


@pytest.fixture(scope="module")
def analyzer():
    return Resources(RobotOptions())


def clip(shift=(0.0, 0.0, 0.0), reach=0.1, seen=N):
    """A smooth move sideways by `reach` [m], from a start that is displaced by `shift` (3,) [m]."""
    s = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, N))
    X = ArmPlant().forward(Q)
    X_BG = make_pose(np.broadcast_to(X[:3, :3], (N, 3, 3)), X[:3, 3] + shift + np.outer(s, [0.0, reach, 0.0]))
    tracked = np.arange(N) < seen
    X_BG[~tracked] = np.nan
    return GripperTrack(
        t_s=0.2 * np.arange(N), X_CH=X_BG, X_BG=X_BG, tracked=tracked, confidence=tracked.astype(float),
        finger_width_m=np.full(N, 0.04),
    )  # fmt: skip


def judged(analyzer, *clips):
    return combine(clips, [analyzer.judge(c) for c in clips])


def test_combining_a_single_clip_leaves_its_judgement_unchanged(analyzer):
    alone = analyzer.judge(clip())
    combined = judged(analyzer, clip())
    assert combined.metrics == alone.metrics
    assert combined.violations == alone.violations


def test_a_jump_of_the_pose_between_clips_is_no_violation(analyzer):
    clips = clip(), clip(shift=(0.0, -0.1, 0.15))  # the second begins 25 cm from where the first ends
    assert judged(analyzer, *clips).feasible is True
    assert analyzer.judge(join_tracks(clips)).feasible is False


def test_extremes_are_taken_integrals_summed_and_smoothness_averaged_over_clips(analyzer):
    slow = clip(reach=0.05)
    fast = clip(reach=0.25)
    a = analyzer.judge(slow).metrics
    b = analyzer.judge(fast).metrics
    both = judged(analyzer, slow, fast).metrics
    assert both.keys() == a.keys()
    assert both["velocity_ratio_max"] == max(a["velocity_ratio_max"], b["velocity_ratio_max"]) > a["velocity_ratio_max"]
    assert both["slowdown_min"] == max(a["slowdown_min"], b["slowdown_min"])
    assert both["manipulability_min"] == min(a["manipulability_min"], b["manipulability_min"])
    assert both["manipulability_integral"] == pytest.approx(a["manipulability_integral"] + b["manipulability_integral"])
    assert both["sparc"] == pytest.approx((a["sparc"] + b["sparc"]) / 2)


def test_frame_numbers_of_violations_continue_across_clips(analyzer):
    down = clip(shift=(0.0, 0.0, -0.5))  # through the table
    alone = analyzer.judge(down)
    both = judged(analyzer, clip(), down)
    assert both.feasible is False
    assert [v.kind for v in both.violations] == [v.kind for v in alone.violations]
    starts = [v.frame_start for v in alone.violations]
    assert starts
    assert [v.frame_start for v in both.violations] == [N - 1 + s for s in starts]
    assert len(both.joints.q) == len(both.track.t_s) == 2 * N - 1
    assert (np.diff(both.track.t_s) > 0).all()
    assert all(len(curve) == 2 * N - 1 for curve in both.curves.values())


def test_a_clip_without_a_track_leaves_the_verdict_undecided(analyzer):
    both = judged(analyzer, clip(), clip(seen=1))
    assert both.feasible is None
    assert both.metrics["slowdown_min"] is None
    assert both.reasons["slowdown_min"].startswith("clip 2: ")
    assert both.metrics["sparc"] is None
    assert both.metrics["manipulability_mean"] < analyzer.judge(clip()).metrics["manipulability_mean"]


def test_join_tracks_drops_the_frame_shared_by_consecutive_clips():
    one = clip()
    other = replace(clip(), finger_width_m=np.full(N, 0.01))
    joined = join_tracks([one, other])
    assert joined.finger_width_m.tolist() == [0.04] * N + [0.01] * (N - 1)
    np.testing.assert_allclose(np.diff(joined.t_s), 0.2)
