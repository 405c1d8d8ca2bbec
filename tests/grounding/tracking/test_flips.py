import numpy as np

from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.tracking.markov import flip_evidence, resolve_flips
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.models.gripper import X_HALF_TURN
from kinebench_drake.models.panda.cad import GripperCad
from tests.grounding.conftest import fitted_pose, hand_pose, perfect_view


def frame_pose(cad: GripperCad, X_CH: Array, *, turned: bool, noise_m: float = 0.002) -> FramePose:
    """The measurement of a frame whose CAD coordinates are right, or flipped with a large sigma."""
    view = perfect_view(cad, X_CH, noise_m=noise_m)
    if turned:
        view.coordinates_P[..., :2] *= -1.0
        view.coordinates_sigma_m[:] = 0.05
    return fitted_pose(view)


def test_unflipped_coordinates_have_positive_flip_evidence(cad: GripperCad) -> None:
    assert flip_evidence(frame_pose(cad, hand_pose(0), turned=False)) > 3.0


def test_flipped_frames_are_turned_back(cad: GripperCad) -> None:
    truth = hand_pose(0)
    wrong = {3, 4, 5, 9}
    poses = [frame_pose(cad, truth, turned=i in wrong) for i in range(12)]
    assert all(pose_difference(poses[i].X_CH, truth)[1] > 2.5 for i in wrong)
    for pose in resolve_flips(poses):
        assert pose is not None
        assert pose_difference(pose.X_CH, truth)[1] < 0.1


def test_resolving_flips_keeps_gaps_and_leaves_a_consistent_video_unchanged(cad: GripperCad) -> None:
    pose = frame_pose(cad, hand_pose(1), turned=False)
    assert resolve_flips([None, pose, None, pose]) == [None, pose, None, pose]
    assert resolve_flips([None, None]) == [None, None]
    np.testing.assert_allclose(X_HALF_TURN @ X_HALF_TURN, np.eye(4), atol=1e-12)
