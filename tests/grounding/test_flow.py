"""Points of the robot's surface followed between two drawn frames."""

import numpy as np
import pytest
from numpy.typing import NDArray

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array, invert, pose_difference, transform_points
from kinebench_drake.grounding.registration.arm_fit import ArmFit, ArmFitter
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.image import GradientImage, follow_surface
from kinebench_drake.models.panda.cad import franka_hand
from kinebench_drake.models.panda.description import RobotPart

CAMERA = benchmark_camera().resized(320, 320)
START = np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, 0.8])
STEP = np.array([0.06, 0.05, -0.05, 0.06, 0.05, -0.05, 0.08])
"""Change of the joint angles between the frames [rad]: the hand moves by 90 mm and 8 degrees."""


@pytest.fixture(scope="module")
def matcher() -> EdgeMatcher:
    return EdgeMatcher()


@pytest.fixture(scope="module")
def model() -> ArmModel:
    return ArmModel()


def part_poses(model: ArmModel, q: Array) -> Array:
    return franka_hand().open(invert(CAMERA.X_BC) @ model.poses(q[None])[0], 0.02)


def draw(matcher: EdgeMatcher, X_CP: Array) -> NDArray[np.uint8]:
    """A robot with stains on its surface before a striped background."""
    rays = CAMERA.rays().reshape(-1, 3)
    hit = matcher.caster.cast(X_CP, rays)
    u = np.tile(np.arange(CAMERA.width), CAMERA.height)
    grey = np.where(u % 40 < 20, 60.0, 90.0)
    on = np.flatnonzero(hit.part)
    p_P = transform_points(invert(X_CP)[hit.part[on]], (rays[on] * hit.distance[on, None])[:, None])[:, 0]
    grey[on] = 170.0 + 60.0 * np.prod(np.sin(p_P * [150.0, 170.0, 130.0] + 1.0), axis=1)
    return np.repeat(grey.astype(np.uint8).reshape(CAMERA.height, CAMERA.width, 1), 3, axis=2)


def arm_at(q: Array) -> ArmFit:
    return ArmFit(
        q=q,
        X_CH=np.eye(4),
        finger_m=0.02,
        finger_sigma_m=0.001,
        agrees=True,
        consistency_px=1.0,
        scale=1.0,
        evidence=1.0,
        covariance=np.eye(6),
    )


def test_a_posture_follows_the_surface_to_the_next_frame(matcher: EdgeMatcher, model: ArmModel) -> None:
    images = [GradientImage(draw(matcher, part_poses(model, q)), CAMERA) for q in (START, START + STEP)]
    X_CH = [part_poses(model, q)[RobotPart.HAND] for q in (START, START + STEP)]
    near = arm_at(START)
    fitter = ArmFitter(CAMERA, model, matcher)
    followed = fitter.follow(near, fitter.poses(near), *images)
    assert followed is not None
    before, after = (np.array(pose_difference(X, X_CH[1])) for X in (X_CH[0], followed.X_CH))
    assert (after < 0.2 * before).all()


def test_flow_points_lie_on_the_surface_of_the_first_frame(matcher: EdgeMatcher, model: ArmModel) -> None:
    X_CP = part_poses(model, START)
    image = GradientImage(draw(matcher, X_CP), CAMERA)
    points = follow_surface(matcher.caster, X_CP, image, image)
    assert points is not None
    assert not set(points.part.tolist()) & {RobotPart.BACKGROUND, RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER}
    p_C = transform_points(X_CP[points.part], points.p_P[:, None])[:, 0]
    across = np.einsum("nij,nj->ni", points.R_LC, p_C)[:, :2]
    assert np.abs(across / points.sigma_m).max() < 0.5


def test_a_robot_absent_from_the_next_frame_gives_few_or_no_flow_points(matcher: EdgeMatcher, model: ArmModel) -> None:
    X_CP = part_poses(model, START)
    shown = GradientImage(draw(matcher, X_CP), CAMERA)
    gone = GradientImage(np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8), CAMERA)
    assert follow_surface(matcher.caster, X_CP, gone, gone) is None
    points = follow_surface(matcher.caster, X_CP, shown, gone)
    assert points is None or len(points) < 20
