"""Laws of the planned motions: no simulation, no rendering."""

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import make_pose, pose_difference
from kinebench_drake.kinematics.continuation import minimum_jerk
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.suites.clock import CONTROL_PERIOD_S
from kinebench_drake.suites.expert.grasp import DOWN, grasp_rotation, level_axes, lift
from kinebench_drake.suites.expert.motion import Waypoint, cartesian_path, plan

R = grasp_rotation(DOWN, (0.0, -1.0, 0.0))
START = make_pose(R, [0.6, 0.0, 0.2])


def path_with(through: bool, steps: int = 96) -> tuple[np.ndarray, np.ndarray]:
    corner = make_pose(grasp_rotation(DOWN, (1.0, -1.0, 0.0)), [0.6, 0.2, 0.2])
    end = lift(corner, -0.15)
    waypoints = [
        Waypoint(X_BG=corner, finger_width_m=0.08, through=through),
        Waypoint(X_BG=end, finger_width_m=0.0),
    ]
    return cartesian_path(START, 0.08, waypoints, steps)


def test_minimum_jerk_is_at_rest_at_both_ends() -> None:
    s = np.linspace(-0.5, 1.5, 2001)
    x = minimum_jerk(s)
    assert x[0] == 0.0
    assert x[-1] == 1.0
    assert minimum_jerk(0.5) == pytest.approx(0.5)
    assert np.abs(np.gradient(x, s)[[500, 1500]]).max() < 1e-4
    assert np.gradient(x, s).max() == pytest.approx(1.875, rel=1e-3)  # Flash and Hogan: peak speed 15/8 of the mean


@pytest.mark.parametrize("through", [True, False])
def test_a_path_ends_at_the_last_waypoint_at_rest(through: bool) -> None:
    X, widths = path_with(through)
    distance, angle = pose_difference(X[-1], lift(make_pose(grasp_rotation(DOWN, (1, -1, 0)), [0.6, 0.2, 0.2]), -0.15))
    assert distance < 1e-9
    assert angle < 1e-9
    assert widths[-1] == pytest.approx(0.0)
    speed = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1) / CONTROL_PERIOD_S
    assert speed[-1] < 1e-6
    assert speed[0] < 0.02


def test_a_path_stops_at_stops_and_passes_through_other_waypoints() -> None:
    def slowest_inside(through: bool) -> float:
        X, _ = path_with(through)
        speed = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1) / CONTROL_PERIOD_S
        return float(speed[20:60].min())

    assert slowest_inside(through=False) < 0.005
    assert slowest_inside(through=True) > 0.03


def test_a_plan_follows_its_path_within_speed_limits() -> None:
    plant = ArmPlant()
    X_goal = lift(plant.forward(rest_q()), 0.1)
    waypoints = [Waypoint(X_BG=X_goal, finger_width_m=0.04)]
    motion = plan(plant, rest_q(), 0.08, waypoints, 40)
    reached = plant.forward_path(motion.q)
    distance, angle = pose_difference(reached, cartesian_path(plant.forward(rest_q()), 0.08, waypoints, 40)[0])
    assert distance.max() < 1e-5
    assert angle.max() < 1e-5
    speed = np.abs(np.diff(motion.q, axis=0, prepend=rest_q()[None])) / CONTROL_PERIOD_S
    assert (speed <= plant.velocity_limits).all()


def test_a_plan_outside_workspace_or_speed_limits_is_refused() -> None:
    plant = ArmPlant()
    start = plant.forward(rest_q())
    with pytest.raises(InputError, match="leaves the workspace"):
        plan(plant, rest_q(), 0.08, [Waypoint(X_BG=lift(start, 2.0), finger_width_m=0.08)], 40)
    with pytest.raises(InputError, match=r"rad/s of joint \d at control step"):
        plan(plant, rest_q(), 0.08, [Waypoint(X_BG=lift(start, 0.3), finger_width_m=0.08)], 10)


def test_grasp_rotations_are_right_handed_and_level_axes_horizontal() -> None:
    assert np.allclose(R.T @ R, np.eye(3))
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert np.allclose(R[:, 2], DOWN)
    rng = np.random.default_rng(0)
    for yaw in rng.uniform(-np.pi, np.pi, 10):
        c = np.cos(yaw)
        s = np.sin(yaw)
        upright = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        for faces in (np.eye(3), np.eye(3)[:, [1, 2, 0]]):  # whichever face the box lies on
            axes = level_axes(upright @ faces)
            assert np.allclose(axes[:, 2], 0.0)
            assert np.allclose(np.abs(axes @ upright[:, :2]).max(axis=1), 1.0)
