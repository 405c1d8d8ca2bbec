from dataclasses import replace

import numpy as np
import pytest

from benchmarks.audit import AuditTiming, time_audits, time_parts, track_of
from benchmarks.audit import measure as measure_audit
from benchmarks.audit import section as audit_section
from benchmarks.feasible import TrackSet, smooth_motions
from benchmarks.ik import IK_SETS, IkComparison, SolverTiming, compare_ik, compare_solvers, section
from benchmarks.peers import (
    FIXED_Q7,
    FRANKIK_FIXED_Q7,
    NEWTON,
    OURS,
    PEERS,
    PLAIN_DRAKE,
    Peer,
    problem_of,
    reached_share,
    within_speed_share,
)

EPISODES, LONG = IK_SETS
ALWAYS = [peer for peer in PEERS if peer.name in (OURS, FIXED_Q7, NEWTON, PLAIN_DRAKE)]


@pytest.fixture(scope="module")
def motion(arm):
    return next(smooth_motions(np.random.default_rng(0), arm, EPISODES))


def missing(plant):
    raise ImportError("no such package")


def test_our_and_drakes_solvers_reach_every_pose_and_absent_peers_have_no_time(arm, motion):
    absent = Peer(name="absent", how="not at all", package="absent-package", make=missing)
    timings = {t.name: t for t in compare_solvers([problem_of(arm.plant, *motion)], [*ALWAYS, absent], repeats=2)}
    assert timings["absent"].us_per_pose is None
    for name in (OURS, NEWTON, PLAIN_DRAKE):
        assert timings[name].reached == 1.0
        assert timings[name].us_per_pose.shape == (2,)
        assert (timings[name].us_per_pose > 0.0).all()


@pytest.mark.parametrize("peer", [p for p in PEERS if p not in ALWAYS], ids=lambda p: p.name)
def test_peer_packages_reach_most_poses(arm, motion, peer):
    if peer.package is not None:
        pytest.importorskip(peer.package.removeprefix("pin-").replace("-", "_"))
    (timing,) = compare_solvers([problem_of(arm.plant, *motion)], [peer], repeats=1)
    assert timing.reached > 0.8  # used rightly: a wrong frame or unit would reach none


def test_verification_rejects_wrong_postures_limit_violations_and_jumps(arm, motion):
    p = problem_of(arm.plant, *motion)
    assert reached_share(arm.plant, [p], [p.q]) == 1.0
    off = p.q.copy()
    off[:10, 0] += 1e-3
    assert reached_share(arm.plant, [p], [off]) == pytest.approx(1.0 - 10 / len(off))
    assert reached_share(arm.plant, [p], [p.q + 2.0 * np.pi]) == 0.0
    off[:20] = np.nan
    assert reached_share(arm.plant, [p], [off]) == pytest.approx(1.0 - 20 / len(off))
    assert within_speed_share(arm.plant, [p], [off]) == 0.0
    assert within_speed_share(arm.plant, [p], [p.q]) == 1.0
    jump = p.q.copy()
    jump[20:, 3] += 0.5
    assert within_speed_share(arm.plant, [p, p], [jump, p.q]) == 0.5


def test_tracks_are_feasible_episodes_of_49_frames(arm, motion):
    track = track_of(arm, *motion)
    assert len(track.t_s) == 49
    np.testing.assert_allclose(np.diff(track.t_s), 0.2)
    assert set(time_parts([track])) == {"inverse kinematics", "manipulability", "limits", "smoothness"}
    seconds, feasible = time_audits([track])
    assert seconds.shape == (1,)
    assert feasible == 1


def test_fixed_q7_is_the_closed_form_at_the_first_joint_7_and_nan_out_of_reach(arm, motion):
    p = problem_of(arm.plant, *motion)
    far = p.X_BG.copy()
    far[-3:, 0, 3] += 2.0
    (held,) = [peer for peer in PEERS if peer.name == FIXED_Q7]
    (path,) = held.make(arm.plant)([replace(p, X_BG=far)])
    assert (path[:-3, 6] == p.q[0, 6]).all()
    np.testing.assert_allclose(path[0], p.q[0], atol=1e-9)
    np.testing.assert_allclose([arm.plant.forward(q) for q in path[:-3]], far[:-3], atol=1e-9)
    assert np.isnan(path[-3:]).any(axis=-1).all()


def test_long_tracks_keep_the_duration_and_one_run_compares_all_track_sets(arm):
    ((_, t_s),) = smooth_motions(np.random.default_rng(0), arm, replace(LONG, tracks=1))
    assert len(t_s) == 490
    np.testing.assert_allclose(np.diff(t_s), 0.02)
    sets = (TrackSet(tracks=2, frames=5, period_s=0.2), TrackSet(tracks=1, frames=40, period_s=0.02))
    ours = [peer for peer in ALWAYS if peer.name == OURS]
    comparisons = compare_ik(sets=sets, repeats=1, peers=ours)
    assert [c.tracks for c in comparisons] == list(sets)
    assert [t.reached for c in comparisons for t in c.timings] == [1.0, 1.0]
    assert measure_audit(tracks=1, audits=1).audit_s.shape == (1,)


def timing(name, us, kept=1.0):
    us_per_pose = None if us is None else np.array(us)
    return SolverTiming(name=name, label=name, us_per_pose=us_per_pose, reached=1.0, within_speed=kept)


def test_ratios_of_solvers_are_medians_over_turns():
    timings = (
        timing(OURS, [10.0, 20.0, 10.0]),
        timing(FIXED_Q7, [5.0, 5.0, 5.0], kept=0.9),
        timing(PLAIN_DRAKE, [300.0, 600.0, 200.0]),
        timing("slow", [100.0, 200.0, 100.0]),
        timing("quick", [40.0, 60.0, 30.0]),
        timing("quick, jumpy", [4.0, 6.0, 3.0], kept=0.3),
        timing("quick, late", [80.0, 90.0, 70.0]),
        timing("jumpy", [20.0, 40.0, 20.0], kept=0.3),
        timing(FRANKIK_FIXED_Q7, [22.0, 44.0, 22.0], kept=0.3),
        timing("gone", None),
    )
    text = section([IkComparison(tracks=tracks, timings=timings) for tracks in (EPISODES, LONG)])
    cells = "40.0 | 3.0 | 100.0%, 100%"
    assert f"| quick | {cells} |" in text
    assert f"{EPISODES.tracks} tracks of 49 frames at 0.2 s." in text
    assert "those for tracks of 490 frames at 0.02 s stand in" in text
    assert "quick, " not in text
    assert "| gone | not installed |  |  |" in text


def test_the_audit_section_gives_median_and_maximum():
    seconds = np.array([0.1, 0.2, 0.3])
    text = audit_section(AuditTiming(tracks=1000, parts_s={"inverse kinematics": 12.34}, audit_s=seconds, feasible=3))
    assert "12.3 s" in text
    assert "median 0.200 s" in text
    assert "maximum 0.300 s; 3 feasible" in text
