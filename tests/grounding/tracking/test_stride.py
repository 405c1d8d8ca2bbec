"""Which frames are measured in full with a stride, and what is made of the hand alone in the others."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array, make_pose, pose_difference
from kinebench_drake.grounding.priors import NO_PRIORS, Priors
from kinebench_drake.grounding.registration.arm_fit import ArmFit
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.stride import StridedTracker
from kinebench_drake.grounding.tracking.tracker import HandView, Tracking
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.track import Domain
from tests.grounding.conftest import fitted_pose, hand_pose, perfect_view

CAMERA = benchmark_camera().resized(64, 64)
COUNT = 8
FRAMES = np.zeros((COUNT, 64, 64, 3), np.uint8) + np.arange(COUNT, dtype=np.uint8)[:, None, None, None]
BIAS_M = np.array([0.004, 0.0, -0.006])
"""Error of hands that are fitted alone."""


@dataclass
class FullTracker:
    """Stands for `CadTracker`: exact poses, and hands that are off by the same; the first pixel numbers the frames."""

    cad: GripperCad
    overlaps: Mapping[int, float] = field(default_factory=dict)
    absent: tuple[int, ...] = ()
    domain: Domain = Domain.FAMILIAR
    calls: list[list[int]] = field(default_factory=list)

    def pose(self, number: int) -> FramePose:
        X_CH = make_pose(hand_pose(1)[:3, :3], hand_pose(1)[:3, 3] + [0.002 * number**2, 0.0, 0.0])
        pose = fitted_pose(perfect_view(self.cad, X_CH))
        X_hand = make_pose(X_CH[:3, :3], X_CH[:3, 3] + BIAS_M)
        hand = replace(pose.hand, X_CH=X_hand)
        arm = ArmFit(q=np.zeros(7), X_CH=X_CH, agrees=number not in self.absent, covariance=np.eye(6))
        return replace(pose, X_CH=X_CH, hand=hand, hand_without_silhouette=hand, arm=arm)

    def track(
        self, frames: Frames, camera: Camera, priors: Priors = NO_PRIORS, places: Array | None = None
    ) -> Tracking:
        numbers = frames[:, 0, 0, 0].tolist()
        self.calls.append(numbers)
        poses = tuple(map(self.pose, numbers))
        wide = tuple(pose.view for pose in poses)
        return Tracking(poses=poses, wide=wide, robot=np.zeros((64, 64), dtype=bool), domain=self.domain)

    def fit_hands(self, frames: Frames, camera: Camera, X_CH: Mapping[int, Array]) -> dict[int, HandView]:
        poses = {i: self.pose(i) for i in X_CH if i not in self.absent}
        return {i: HandView(fit=pose.hand, view=pose.view) for i, pose in poses.items()}

    def overlap(self, hand: HandView, X_CH: Array) -> float:
        number = round(float(np.sqrt(max(0.0, (hand.fit.X_CH - self.pose(0).hand.X_CH)[0, 3]) / 0.002)))
        return self.overlaps.get(number, 0.95)


@pytest.fixture
def full() -> FullTracker:
    return FullTracker(GripperCad())


def track(full: FullTracker, stride: int) -> Tracking:
    return StridedTracker(full=full, stride=stride).track(FRAMES, CAMERA)  # type: ignore[arg-type]


def between(tracking: Tracking) -> list[int]:
    return [i for i, pose in enumerate(tracking.poses) if pose is not None and pose.is_between]


@pytest.mark.parametrize(("stride", "keys"), [(2, [0, 2, 4, 6, 7]), (3, [0, 3, 6, 7]), (20, [0, 7])])
def test_the_hand_alone_is_corrected_by_the_frames_measured_in_full(
    full: FullTracker, stride: int, keys: list[int]
) -> None:
    tracking = track(full, stride)
    assert full.calls == [keys]
    assert between(tracking) == [i for i in range(COUNT) if i not in keys]
    for i, pose in enumerate(tracking.poses):
        assert pose is not None
        assert pose_difference(pose.X_CH, full.pose(i).X_CH)[0] < 1e-9
        assert np.isnan(pose.own_q).all() == pose.is_between


def test_a_pose_of_the_hand_alone_is_less_certain(full: FullTracker) -> None:
    key, pose = track(full, 2).poses[:2]
    assert key is not None
    assert pose is not None
    assert (np.diag(pose.covariance) > np.diag(key.covariance)).all()


@pytest.mark.parametrize("fault", [{"overlaps": {3: 0.7}}, {"absent": (3,)}])
def test_a_hand_that_looks_worse_than_beside_it_is_measured_in_full(full: FullTracker, fault: dict) -> None:  # type: ignore[type-arg]
    tracking = track(replace(full, **fault), 2)
    assert full.calls == [[0, 2, 4, 6, 7], [2, 3, 4]]
    assert between(tracking) == [1, 5]


def test_frames_beside_one_without_a_sure_pose_are_measured_in_full(full: FullTracker) -> None:
    tracking = track(replace(full, absent=(4,)), 2)
    assert full.calls == [[0, 2, 4, 6, 7], [2, 3, 4, 5, 6]]
    assert between(tracking) == [1]


def test_an_unfamiliar_video_is_measured_in_full(full: FullTracker) -> None:
    assert between(track(replace(full, domain=Domain.UNFAMILIAR), 2)) == []
    assert full.calls[-1] == list(range(COUNT))
