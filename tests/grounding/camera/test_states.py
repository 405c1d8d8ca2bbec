import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.grounding.camera.states import POSTURES, make_posture_states, parse_posture, read_states
from kinebench_drake.models.panda.description import RobotPart, hand_from_tcp
from tests.grounding.camera.robot import postures


def test_joint_angles_with_one_row_for_each_frame_are_used_whatever_their_times(tmp_path, model):
    q = postures(5)
    np.savez(tmp_path / "a.npz", t_s=np.arange(5) * 7.0, q=q, finger_width_m=np.full(5, 0.04))
    states = read_states(tmp_path / "a.npz", None, None, np.arange(5) * 0.1, model)
    assert np.array_equal(states.q, q)
    assert np.allclose(states.X_BH, model.poses(q)[:, RobotPart.HAND])
    assert np.allclose(states.finger_m, 0.02)


def test_frames_without_joint_angles_have_no_state(tmp_path, model):
    q = postures(5)
    states = []
    for lost in ([], [2], [0, 1, 2]):
        some = q.copy()
        some[lost] = np.nan
        tracked = np.isfinite(some).all(axis=1)
        np.savez(tmp_path / "a.npz", t_s=np.arange(5.0), q=q, tracked=tracked)
        states.append(read_states(tmp_path / "a.npz", None, None, np.arange(5.0), model))
    assert [int(s.has_hand.sum()) for s in states] == [5, 4, 2]
    assert [int(s.has_posture.sum()) for s in states] == [5, 4, 2]


def test_joint_angles_at_a_higher_rate_are_interpolated_at_the_frames(tmp_path, model):
    t_s = np.linspace(0.0, 2.0, 201)
    q = np.outer(t_s, np.linspace(0.1, 0.4, 7)) + postures(1)
    np.savez(tmp_path / "a.npz", t_s=t_s + 5.0, q=q)
    states = read_states(tmp_path / "a.npz", None, None, np.array([0.0, 0.503, 1.999]), model)
    assert np.allclose(states.q, postures(1) + np.outer([0.0, 0.503, 1.999], np.linspace(0.1, 0.4, 7)))


def test_tcp_poses_become_hand_poses_without_joint_angles(tmp_path, model):
    X_BH = model.poses(postures(4))[:, RobotPart.HAND]
    np.savez(tmp_path / "a.npz", t_s=np.arange(4.0), base_from_tcp=X_BH @ hand_from_tcp())
    states = read_states(tmp_path / "a.npz", None, None, np.arange(4.0), model)
    assert np.allclose(states.X_BH, X_BH)
    assert np.isnan(states.q).all()
    X_BP = states.part_poses(model)
    assert np.isfinite(X_BP[:, [RobotPart.HAND, RobotPart.LINK0]]).all()
    assert np.isnan(X_BP[:, RobotPart.LINK3]).all()


def test_joint_angles_shorter_than_the_video_are_refused(tmp_path, model):
    np.savez(tmp_path / "a.npz", t_s=np.arange(5) * 0.1, q=postures(5))
    with pytest.raises(InputError, match=r"5 rows over 0.40 s.*20 frames over 1.90 s.*frame_period_s"):
        read_states(tmp_path / "a.npz", None, None, np.arange(20) * 0.1, model)


def test_a_video_without_a_clock_needs_one_row_for_each_frame_or_a_frame_period(tmp_path, model):
    """Else every frame would have the posture of the first row."""
    np.savez(tmp_path / "a.npz", t_s=np.arange(8) * 0.1, q=postures(8))
    assert np.array_equal(read_states(tmp_path / "a.npz", None, None, np.full(8, np.nan), model).q, postures(8))
    with pytest.raises(UsageError, match=r"8 rows, but 5 frames of a video without a clock.*frame_period_s"):
        read_states(tmp_path / "a.npz", None, None, np.full(5, np.nan), model)


def test_joint_files_of_several_episodes_need_an_episode_name(tmp_path, model):
    (tmp_path / "many").mkdir()
    for name in ("a", "b"):
        np.savez(tmp_path / "many" / f"{name}.npz", t_s=np.arange(3.0), q=postures(3))
    with pytest.raises(UsageError, match=r"contains 2 episodes.*episode, one of a, b"):
        read_states(tmp_path / "many", None, None, np.arange(3.0), model)
    assert len(read_states(tmp_path / "many", "b", None, np.arange(3.0), model).q) == 3


def test_a_single_posture_applies_to_its_frame_alone(model):
    states = make_posture_states("0,-0.5,0,-2,0,1.6,0.8", 2, 4, model)
    assert states.has_hand.tolist() == [False, False, True, False]
    assert np.allclose(states.q[2], [0, -0.5, 0, -2, 0, 1.6, 0.8])
    with pytest.raises(UsageError, match=r"joints_frame is 4, expected 0 to 3"):
        make_posture_states("home", 4, 4, model)


@pytest.mark.parametrize("text", ["0,1,2", "0,0,0,-90,0,90,45", "0,0,0,nan,0,0,0"])
def test_a_posture_that_is_not_seven_angles_in_radians_is_refused(text):
    with pytest.raises(UsageError, match="expected 7 joint angles in radians"):
        parse_posture(text)


def test_named_postures_are_within_the_joints_limits(model):
    for name in ("home", "rest"):
        q = parse_posture(name)
        assert ((q >= model.lower) & (q <= model.upper)).all()


def test_states_of_some_frames_leave_the_others_unknown(tmp_path, model):
    np.savez(tmp_path / "joints.npz", q=np.tile(POSTURES["home"], (6, 1)))
    states = read_states(tmp_path / "joints.npz", None, None, np.arange(6.0), model).only(np.array([1, 4]))
    assert np.flatnonzero(states.has_hand).tolist() == np.flatnonzero(states.has_posture).tolist() == [1, 4]
    assert states.q[4] == pytest.approx(POSTURES["home"])
