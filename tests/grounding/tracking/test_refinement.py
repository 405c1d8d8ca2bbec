"""Which poses of a video are fitted to the edges of its images, from which postures, and which fits are kept."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.grounding.registration.arm_fit import ArmFit, FollowedArm
from kinebench_drake.grounding.tracking.markov import likeliest_postures
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.refinement import EdgeRefinement
from kinebench_drake.grounding.tracking.view import Crop
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.track import Domain
from tests.grounding.conftest import fitted_pose, hand_pose, perfect_view

CAMERA = benchmark_camera().resized(64, 64)
FRAMES = 12
SHARPENED = 1e-3
WRONG = 1.0
RIGHT = 0.0
"""First joint angle of a wrong posture, which the edges contradict, and of the right one."""
NO_POINTS = object()


def arm_fit(angle: float, agreement: float = float("nan"), *, agrees: bool = True) -> ArmFit:
    return ArmFit(
        q=np.full(7, angle),
        X_CH=np.eye(4),
        finger_m=0.02,
        finger_sigma_m=0.001,
        agrees=agrees,
        consistency_px=1.0,
        scale=1.0,
        evidence=1.0,
        covariance=np.eye(6),
        edge_agreement=agreement,
    )


class Fitter:
    """Stands for `ArmFitter`: a fit goes to the right posture from within `reach` of it, else stays where it is."""

    def __init__(
        self, reach: float = 0.5, network_agreement: float = 0.2, *, moved_m: float = 0.03, follows: bool = False
    ) -> None:
        self.reach = reach
        self.network_agreement = network_agreement
        self.moved_m = moved_m
        self.follows = follows
        self.refined = 0
        self.sharpened: list[float] = []

    def at(self, numbers: object) -> "Fitter":
        return self

    def edge_agreement(self, q: Array, image: object) -> float:
        return self.network_agreement

    def sharpen_all(self, arms: list[ArmFit], *views: object) -> list[ArmFit]:
        self.sharpened += [float(arm.q[0]) for arm in arms]
        return [replace(arm, q=arm.q + SHARPENED) for arm in arms]

    def refine(self, q: Array, followed: object) -> ArmFit | None:
        self.refined += 1
        right = followed is not None or abs(q[0] - RIGHT) < self.reach
        arm = arm_fit(RIGHT, 0.7) if right else arm_fit(q[0], 0.2, agrees=False)
        return replace(arm, X_CH=make_pose(np.eye(3), [self.moved_m, 0.0, 0.0]))

    def refine_all(
        self, q: Array, views: object, images: object, followed: object = None, *, may_turn: bool = True
    ) -> list[ArmFit | None]:
        return [self.refine(own, followed) for own in q]

    def hand(self, q: Array) -> Array:
        return hand_pose(1)

    def poses(self, arm: ArmFit) -> Array:
        return np.full((1, 4, 4), arm.q[0])

    def follow(self, near: ArmFit, X_CP: Array, *images: object) -> FollowedArm | None:
        assert X_CP[0, 0, 0] == near.q[0]
        return FollowedArm(q=near.q, X_CH=hand_pose(1), points=NO_POINTS) if self.follows else None


class Silhouette:
    """Stands for `SilhouetteMatcher`."""

    def __init__(self, coverage: float = 1.0) -> None:
        self.covered = coverage

    def coverage(self, *hand: object) -> float:
        return self.covered

    def overlap(self, *hand: object) -> float:
        return 0.9


def refinement(
    poses: dict[int, FramePose],
    fitter: Fitter,
    coverage: float = 1.0,
    measure: Callable[[dict[int, Crop]], dict[int, FramePose]] = lambda crops: {},
    *,
    may_be_familiar: bool = True,
) -> EdgeRefinement:
    frames = np.zeros((FRAMES, 64, 64, 3), np.uint8)
    wide = {i: pose.view for i, pose in poses.items()}
    views = poses, wide, frames, CAMERA, fitter, Silhouette(coverage), measure
    return EdgeRefinement(*views, may_be_familiar=may_be_familiar)  # type: ignore[arg-type]


@pytest.fixture
def poses(cad: GripperCad) -> dict[int, FramePose]:
    """Wrong poses, but for frame 5, whose posture is nearly right."""
    sure = replace(fitted_pose(perfect_view(cad, hand_pose(1))), overlap=0.9)
    return {i: replace(sure, arm=arm_fit(0.1 if i == 5 else WRONG)) for i in range(FRAMES)}


def test_a_correct_posture_spreads_to_all_frames_of_an_unfamiliar_video(poses: dict[int, FramePose]) -> None:
    unfamiliar = refinement(poses, Fitter())
    unfamiliar.run()
    assert not unfamiliar.is_familiar
    assert set(unfamiliar.confirmed) == set(range(FRAMES))
    assert all(pose.arm is not None and pose.arm.q[0] == RIGHT for pose in unfamiliar.poses.values())


@pytest.mark.parametrize("hidden", [[8], [7, 8, 9, 10]])
def test_the_arm_is_followed_from_a_confirmed_frame_past_a_short_gap_only(
    poses: dict[int, FramePose], hidden: list[int]
) -> None:
    def measure(crops: dict[int, Crop]) -> dict[int, FramePose]:
        return {i: replace(poses[5], arm=arm_fit(WRONG)) for i in crops if i not in hidden}

    poses[5] = replace(poses[5], arm=arm_fit(RIGHT, 0.7))
    unfamiliar = refinement(poses, Fitter(reach=0.0, follows=True), measure=measure)
    del unfamiliar.poses[3]
    unfamiliar.run()
    reached = set(range(FRAMES)) - ({8} if hidden == [8] else {7, 8, 9, 10, 11})
    assert set(unfamiliar.confirmed) == reached
    assert all(unfamiliar.poses[i].X_CH is poses[i].X_CH for i in range(FRAMES) if i not in reached)


@pytest.mark.parametrize(("missed", "domain"), [(1, Domain.FAMILIAR), (3, Domain.UNFAMILIAR)])
def test_the_domain_is_unfamiliar_if_the_network_misses_the_gripper_in_many_frames(
    poses: dict[int, FramePose], missed: int, domain: Domain
) -> None:
    def measure(crops: dict[int, Crop]) -> dict[int, FramePose]:
        return {i: replace(poses[5], arm=arm_fit(WRONG)) for i in crops}

    for i in range(missed):
        poses[i] = replace(poses[i], arm=arm_fit(WRONG, agrees=False))
    familiar = refinement(poses, Fitter(reach=0.0, network_agreement=0.6, follows=True), measure=measure)
    familiar.run()
    assert familiar.is_familiar
    assert all(pose.arm_agrees for pose in familiar.poses.values())
    assert familiar.domain is domain


def test_only_doubtful_frames_of_a_familiar_video_are_fitted_to_edges_alone(poses: dict[int, FramePose]) -> None:
    poses[3] = replace(poses[3], overlap=0.5)
    poses[7] = replace(poses[7], arm=arm_fit(WRONG, agrees=False), overlap=0.9)
    fitter = Fitter(reach=2.0, network_agreement=0.6)
    familiar = refinement(poses, fitter)
    familiar.run()
    assert familiar.is_familiar
    for i, pose in familiar.poses.items():
        assert pose.arm is not None
        expected = RIGHT if i in (3, 7) else poses[i].arm.q[0] + SHARPENED  # type: ignore[union-attr]
        assert pose.arm.q[0] == expected


def test_each_frame_is_sharpened_exactly_once(poses: dict[int, FramePose]) -> None:
    fitter = Fitter(network_agreement=0.6)
    refinement(poses, fitter).run()
    assert len(fitter.sharpened) == FRAMES


def test_poses_from_priors_are_not_refined(poses: dict[int, FramePose]) -> None:
    priors = {i: replace(pose, from_prior=True) for i, pose in poses.items()}
    unfamiliar = refinement(priors, Fitter(reach=2.0))
    unfamiliar.run()
    assert all(unfamiliar.poses[i] is priors[i] for i in priors)


def test_an_edge_fit_outside_the_segmented_robot_is_dropped(poses: dict[int, FramePose]) -> None:
    unfamiliar = refinement(poses, Fitter(reach=2.0), coverage=0.3)
    unfamiliar.run()
    assert all(unfamiliar.poses[i].X_CH is poses[i].X_CH and not unfamiliar.poses[i].arm_agrees for i in poses)


@pytest.mark.parametrize(
    ("agreement", "moved_m", "familiar"),
    [(0.45, 0.002, True), (0.55, 0.01, True), (0.45, 0.01, False), (0.55, 0.03, False), (0.6, 0.03, True)],
)
def test_a_video_whose_edges_agree_better_at_displaced_poses_is_unfamiliar(
    poses: dict[int, FramePose], agreement: float, moved_m: float, *, familiar: bool
) -> None:
    near = {i: replace(pose, arm=arm_fit(0.1)) for i, pose in poses.items()}
    assert refinement(near, Fitter(network_agreement=agreement, moved_m=moved_m)).is_familiar is familiar


def test_a_video_in_which_hand_and_arm_mostly_disagree_is_unfamiliar(poses: dict[int, FramePose]) -> None:
    for i in range(7):
        poses[i] = replace(poses[i], arm=arm_fit(WRONG, agrees=False))
    assert not refinement(poses, Fitter(network_agreement=0.7)).is_familiar
    poses[6] = replace(poses[6], arm=arm_fit(WRONG))
    assert refinement(poses, Fitter(network_agreement=0.7)).is_familiar
    assert not refinement({}, Fitter()).is_familiar
    assert not refinement(poses, Fitter(network_agreement=0.7), may_be_familiar=False).is_familiar


def test_unfamiliar_poses_that_no_edges_confirm_are_rejected(poses: dict[int, FramePose]) -> None:
    unfamiliar = refinement(poses, Fitter(reach=0.0))
    unfamiliar.run()
    assert not any(pose.arm_agrees for pose in unfamiliar.poses.values())


def test_a_run_of_wrong_postures_between_right_ones_is_fitted_again_from_the_path(poses: dict[int, FramePose]) -> None:
    def measure(crops: dict[int, Crop]) -> dict[int, FramePose]:
        return {i: poses[5] for i in crops}

    wrong = range(4, 9)
    for i in range(FRAMES):
        poses[i] = replace(poses[5], arm=arm_fit(WRONG if i in wrong else RIGHT))

    class Agreeing(Fitter):
        """Its edges confirm the wrong posture, too."""

        def refine(self, q: Array, followed: object) -> ArmFit | None:
            return arm_fit(WRONG, 0.65) if abs(q[0] - WRONG) < self.reach else arm_fit(RIGHT, 0.7)

    unfamiliar = refinement(poses, Agreeing(), measure=measure, may_be_familiar=False)
    unfamiliar.run()
    assert [pose.arm.q[0] for _, pose in sorted(unfamiliar.poses.items()) if pose.arm is not None] == [RIGHT] * FRAMES


def test_the_likeliest_postures_make_one_path_unless_all_that_follow_have_jumped() -> None:
    near = np.full(7, 0.1)
    far = near + 1.0
    agreements = [np.array([0.7]), np.array([0.6, 0.7]), np.array([0.7])]
    postures = [near[None], np.stack([near, far]), near[None]]
    assert likeliest_postures([0, 1, 2], postures, agreements) == [0, 0, 0]
    jumped = [near[None], np.stack([near, far]), far[None]]
    assert likeliest_postures([0, 1, 2], jumped, agreements) == [0, 1, 0]
    assert likeliest_postures([0], [np.stack([near, far])], [np.array([0.6, 0.7])]) == [1]
