import numpy as np
import pytest

from benchmarks.audit import AuditTiming, time_audits, time_parts, track_of
from benchmarks.audit import measure as measure_audit
from benchmarks.audit import section as audit_section
from benchmarks.feasible import TrackSet, smooth_motions
from benchmarks.ik import TRACKS, SolverTiming, compare_ik, compare_solvers, figures, section
from benchmarks.peers import (
    DRAKE,
    NEWTON,
    OURS,
    PEERS,
    Peer,
    problem_of,
    reached_share,
    within_speed_share,
)

ALWAYS = [peer for peer in PEERS if peer.name in (OURS, NEWTON, DRAKE)]


@pytest.fixture(scope="module")
def motion(arm):
    return next(smooth_motions(np.random.default_rng(0), arm, TRACKS))


def missing(plant):
    raise ImportError("no such package")


def test_our_and_drakes_solvers_reach_every_pose_and_absent_peers_have_no_time(arm, motion):
    absent = Peer(name="absent", how="not at all", package="absent-package", make=missing)
    timings = {t.name: t for t in compare_solvers([problem_of(arm.plant, *motion)], [*ALWAYS, absent], repeats=2)}
    assert timings["absent"].us_per_pose is None
    for name in (OURS, NEWTON, DRAKE):
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


def test_all_solvers_are_timed_on_the_drawn_tracks():
    ours = [peer for peer in ALWAYS if peer.name == OURS]
    (timing,) = compare_ik(tracks=TrackSet(tracks=2, frames=5, period_s=0.2), repeats=1, peers=ours)
    assert timing.reached == 1.0
    assert measure_audit(tracks=1, audits=1).audit_s.shape == (1,)


def timing(name, us, kept=1.0):
    us_per_pose = None if us is None else np.array(us)
    return SolverTiming(name=name, label=name, us_per_pose=us_per_pose, reached=1.0, within_speed=kept)


def test_ratios_of_solvers_are_medians_over_turns():
    timings = (
        timing(OURS, [10.0, 20.0, 10.0]),
        timing("quick", [40.0, 60.0, 30.0]),
        timing("jumpy", [20.0, 40.0, 20.0], kept=0.3),
        timing("gone", None),
    )
    text = section(timings)
    assert "| quick | 40.0 | 3.0 | 100.0%, 100% |" in text
    assert "| jumpy | 20.0 | 2.0 | 100.0%, 30% |" in text
    assert "| gone | not installed |  |  |" in text
    assert figures(timings) == pytest.approx({"us a pose": 10.0, "ours / quick": 1 / 3, "ours / jumpy": 0.5})


def test_the_audit_section_gives_median_and_maximum():
    seconds = np.array([0.1, 0.2, 0.3])
    text = audit_section(AuditTiming(tracks=1000, parts_s={"inverse kinematics": 12.34}, audit_s=seconds, feasible=3))
    assert "12.3 s" in text
    assert "median 0.200 s" in text
    assert "maximum 0.300 s; 3 feasible" in text
