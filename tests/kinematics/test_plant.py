import subprocess
import sys

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import rotation_log
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import hand_from_tcp, rest_q


def _dh_forward(q: np.ndarray) -> np.ndarray:
    """The maker's table of (modified) Denavit-Hartenberg parameters, multiplied out: independent of URDF and Drake."""
    table = zip(
        [0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088],
        [0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0],
        np.pi / 2 * np.array([0, -1, 1, 1, -1, 1, 1]),
        q,
        strict=True,
    )
    X = np.eye(4)
    for a, d, alpha, theta in table:
        ct = np.cos(theta)
        st = np.sin(theta)
        ca = np.cos(alpha)
        sa = np.sin(alpha)
        X = X @ [[ct, -st, 0, a], [st * ca, ct * ca, -sa, -d * sa], [st * sa, ct * sa, ca, d * ca], [0, 0, 0, 1]]
    c = np.sqrt(0.5)
    return X @ [[c, c, 0, 0], [-c, c, 0, 0], [0, 0, 1, 0.107 + 0.1034], [0, 0, 0, 1]]


def test_forward_kinematics_is_the_makers_denavit_hartenberg_chain(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    for q in rng.uniform(plant.lower, plant.upper, size=(20, 7)):
        np.testing.assert_allclose(plant.forward(q), _dh_forward(q), atol=1e-12)


def test_forward_path_is_forward_of_each_posture(plant: ArmPlant) -> None:
    q = np.random.default_rng(1).uniform(plant.lower, plant.upper, size=(5, 7))
    np.testing.assert_array_equal(plant.forward_path(q), [plant.forward(row) for row in q])
    assert plant.forward_path(q[:0]).shape == (0, 4, 4)


def test_rest_posture_points_the_gripper_down_in_front_of_the_base(plant: ArmPlant) -> None:
    X_BG = plant.forward(rest_q())
    np.testing.assert_allclose(X_BG[:3, 3], [0.615, 0.0, 0.17], atol=1e-3)
    np.testing.assert_allclose(X_BG[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_the_hand_pose_and_the_tcp_offset_give_the_tcp_pose(plant: ArmPlant) -> None:
    q = np.array([0.3, -0.4, 0.5, -1.9, 0.2, 1.8, -0.6])
    poses = plant.link_poses(q)
    assert set(poses) == set(plant.robot.links)
    np.testing.assert_allclose(poses["panda_link0"], np.eye(4), atol=0)
    np.testing.assert_allclose(poses["panda_hand"] @ hand_from_tcp(), plant.forward(q), atol=1e-12)


def test_jacobian_is_the_finite_difference_of_forward(plant: ArmPlant) -> None:
    rng = np.random.default_rng(1)
    h = 1e-6
    for q in rng.uniform(plant.lower, plant.upper, size=(10, 7)):
        J = plant.jacobian(q)
        for j, dq in enumerate(h * np.eye(7)):
            X_minus = plant.forward(q - dq)
            X_plus = plant.forward(q + dq)
            angular = rotation_log(X_plus[:3, :3] @ X_minus[:3, :3].T) / (2 * h)
            linear = (X_plus[:3, 3] - X_minus[:3, 3]) / (2 * h)
            np.testing.assert_allclose(J[:, j], [*angular, *linear], atol=1e-8)


def test_forward_and_jacobian_together_equal_both_alone(plant: ArmPlant) -> None:
    X_BG, J = plant.forward_and_jacobian(rest_q() + 0.1)
    plant.forward(np.zeros(7))
    np.testing.assert_array_equal(X_BG, plant.forward(rest_q() + 0.1))
    np.testing.assert_array_equal(J, plant.jacobian(rest_q() + 0.1))


def test_position_and_velocity_limits_are_those_of_the_urdf(plant: ArmPlant) -> None:
    np.testing.assert_array_equal(plant.upper, [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
    np.testing.assert_array_equal(plant.lower, [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
    np.testing.assert_array_equal(plant.velocity_limits, [2.175] * 4 + [2.61] * 3)


def test_fingers_open_without_moving_the_tcp(plant: ArmPlant) -> None:
    shut = ArmPlant(finger_width_m=0.0).link_poses(rest_q())
    wide = plant.link_poses(rest_q())
    gap = [np.linalg.norm(p["panda_leftfinger"][:3, 3] - p["panda_rightfinger"][:3, 3]) for p in (shut, wide)]
    np.testing.assert_allclose(gap, [0.0, 0.08], atol=1e-12)
    np.testing.assert_array_equal(shut["panda_hand_tcp"], wide["panda_hand_tcp"])


def test_joint_angles_of_wrong_shape_are_refused(plant: ArmPlant) -> None:
    with pytest.raises(UsageError, match=r"\(9,\)"):
        plant.forward(np.zeros(9))


def test_the_package_is_imported_without_drake() -> None:
    code = "import sys, kinebench_drake; sys.exit('pydrake' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
