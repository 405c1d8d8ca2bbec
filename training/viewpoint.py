"""Random cameras for training: all around and above the robot, near and far, with wide and narrow lenses."""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.grounding.tracking.view import GRIPPER_RADIUS_M, Crop
from kinebench_drake.suites.simulator import Simulator

_DISTANCE_M = (0.4, 2.5)
_FOV_RAD = np.deg2rad((20.0, 100.0))
_GRIPPER_PX = (26.0, 300.0)
"""Diameter of the gripper's bounding sphere in the image [px], where distance and field of view permit it."""
_LARGEST_GRIPPER = 0.8
"""Greatest diameter of the gripper's bounding sphere over the smaller side of the image."""
_ELEVATION_RAD = np.deg2rad((-12.0, 85.0))
_BEHIND = 0.35
"""Share of directions drawn from all around; the others lie in front of and beside the robot."""
_FRONT_RAD = np.deg2rad(120.0)
_ROLLED = 0.15
_ROLL_RAD = np.deg2rad(35.0)
_USUAL_ROLL_RAD = np.deg2rad(4.0)
_CUT_OFF = 0.15
"""Share of images with the gripper near or across the border."""
_OFF_CENTRE = 0.2
"""Share of cameras with a principal point away from the centre."""
_OFF_CENTRE_SHARE = 0.15
"""Greatest distance of such a principal point from the centre over the image size."""


@dataclass(frozen=True, slots=True)
class ViewBounds:
    """Region where cameras may stand, in the robot base frame [m]."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def contains(self, p_B: Array) -> bool:
        """Return whether a point (3,) lies inside."""
        return bool((p_B > self.lower).all() and (p_B < self.upper).all())


def random_camera(
    rng: np.random.Generator, centre_B: Array, obstacles_B: Array, bounds: ViewBounds, size: tuple[int, int]
) -> Camera:
    """Return a camera that sees the gripper's centre `centre_B` (3,) in the base frame, in images of `size` [px].

    Distance, direction, roll, field of view, place of the gripper in the image and principal point are drawn
    independently; directions with the camera outside of `bounds` or within 0.2 m of `obstacles_B` (N, 3) are redrawn.
    """
    position = _draw_position(rng, centre_B, obstacles_B, bounds)
    distance = float(np.linalg.norm(position - centre_B))
    sides = np.array(size, dtype=np.float64)
    focal_range = sides.max() / 2 / np.tan(_FOV_RAD[::-1] / 2)
    wanted = np.minimum(_GRIPPER_PX, _LARGEST_GRIPPER * sides.min()) * distance / (2 * GRIPPER_RADIUS_M)
    low, high = np.clip(wanted, *focal_range)
    focal = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    centre_px = sides / 2
    if rng.random() < _OFF_CENTRE:
        centre_px = centre_px + rng.uniform(-_OFF_CENTRE_SHARE, _OFF_CENTRE_SHARE, 2) * sides
    reach = 0.55 if rng.random() < _CUT_OFF else 0.4
    pixel = sides / 2 + rng.uniform(-reach, reach, 2) * sides
    return Camera(
        width=size[0],
        height=size[1],
        fx=focal,
        fy=focal,
        cx=float(centre_px[0]),
        cy=float(centre_px[1]),
        X_BC=_look_at(rng, position, centre_B, np.array([*((pixel - centre_px) / focal), 1.0])),
    )


def _draw_position(rng: np.random.Generator, centre_B: Array, obstacles_B: Array, bounds: ViewBounds) -> Array:
    for _ in range(10_000):
        azimuth = rng.uniform(-np.pi, np.pi) if rng.random() < _BEHIND else rng.uniform(-_FRONT_RAD, _FRONT_RAD)
        # More cameras at middle heights than at either end.
        elevation = _ELEVATION_RAD[0] + np.ptp(_ELEVATION_RAD) * rng.beta(1.6, 2.2)
        direction = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        distance = np.exp(rng.uniform(*np.log(_DISTANCE_M)))
        position = centre_B + distance * np.array(direction)
        clearance = np.linalg.norm(obstacles_B - position, axis=1).min()
        if bounds.contains(position) and clearance > 0.2:
            return np.asarray(position)
    raise RuntimeError("no free camera position after 10,000 draws; the bounds exclude the surroundings of the gripper")


def _look_at(rng: np.random.Generator, position: Array, target_B: Array, ray_C: Array) -> Array:
    """Return X_BC (4, 4) at `position` with `target_B` in the direction `ray_C` (3,), upright but for a random roll."""
    z = (target_B - position) / np.linalg.norm(target_B - position)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = np.array([0.0, -1.0, 0.0]) if np.linalg.norm(x) < 1e-3 else x / np.linalg.norm(x)
    R_BL = np.stack([x, np.cross(z, x), z], axis=1)
    roll = rng.uniform(-_ROLL_RAD, _ROLL_RAD) if rng.random() < _ROLLED else rng.normal(0, _USUAL_ROLL_RAD)
    R_CL = Crop.towards(ray_C, 1.0, 1, roll=float(roll)).R_CV
    return make_pose(R_BL @ R_CL.T, position)


def place_camera(simulator: Simulator, camera: Camera) -> None:
    """Change pose and intrinsics of a simulator's camera, for images of the same size, without rebuilding the scene."""
    from kinebench_drake.suites.scene.builder import CAMERA, FAR_M, NEAR_M, X_WB, sapien_from_opencv, to_pose

    for component in simulator.env._sensors[CAMERA].camera._render_cameras:
        component.set_perspective_parameters(NEAR_M, FAR_M, camera.fx, camera.fy, camera.cx, camera.cy, 0.0)
        component.set_local_pose(to_pose(sapien_from_opencv(X_WB @ camera.X_BC)))
    simulator.camera = camera
