"""Turn of the base about the axis of joint 1.

Links 1 to 7 look the same if the base turns one way and joint 1 the other: they give the axis and the shoulder on it.
Only the base link says how the base stands.
"""

from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.geometry import Array, make_pose, rotation_z
from kinebench_drake.grounding.camera.bundle import ArmScene
from kinebench_drake.grounding.camera.contours import ContourImages
from kinebench_drake.grounding.camera.lens import Lens
from kinebench_drake.models.robot import N_JOINTS

DIFFERENT_TURN_RAD = np.deg2rad(20.0)
"""Least angle between turns that count as different."""
_SHOULDER_M = 0.333  # height of the shoulder above the base
_RIGHT_RAD = np.deg2rad(15.0)  # from a right angle, of turns that are one
_STEP_RAD, _TOPS = np.deg2rad(5.0), 6
_FINE_STEPS_RAD = np.deg2rad([-3.75, -2.5, -1.25, 1.25, 2.5, 3.75])
_FRAMES = 6
_SAME_RAD, _SAME_SHARE, _SAME_ZOOM = np.deg2rad(3.0), 0.03, 0.05


def turned(scene: ArmScene, angle_rad: float) -> ArmScene:
    """Return a scene with the base turned by minus an angle [rad] about joint 1, and joint 1 by it: same links."""
    X_CB = scene.lens.X_CB @ make_pose(rotation_z(-angle_rad), np.zeros(3))
    return replace(scene, lens=replace(scene.lens, X_CB=X_CB), q=scene.q + angle_rad * (np.arange(N_JOINTS) == 0))


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseTurn:
    """Turn of the base that its contours show."""

    angle_rad: float
    """Angle by which joint 1 has to turn for it [rad]."""
    share: float
    """Share of the contours of the base link on image edges; 0 if the base is not seen."""

    def is_right_angle_from(self, other: "BaseTurn") -> bool:
        """Return whether the two differ by a right angle or two, so that a base stands square to the same lines."""
        angle = abs(self.angle_rad - other.angle_rad)
        return bool(angle > _RIGHT_RAD and abs((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4) <= _RIGHT_RAD)


def find_turns(scene: ArmScene, images: ContourImages, lower_rad: float, upper_rad: float) -> list[BaseTurn]:
    """Find the turns, each different from all better ones, at which contours of the base link lie on image edges.

    Args:
        scene: camera and postures, right but for the turn.
        images: images of these frames.
        lower_rad: least angle of joint 1 [rad].
        upper_rad: greatest one.

    Returns:
        At least one, the best first; only that of the scene itself where no other is within the limits.
    """
    rows = np.unique(np.linspace(0, len(scene.q) - 1, _FRAMES).round().astype(int))
    few, images = scene.take(rows), images.take(rows)
    q1 = scene.q[:, 0]

    def shares(angles: Array) -> Array:
        return np.array([images.base_share(turned(few, angle)) for angle in angles])

    angles = np.arange(lower_rad - q1.min(), upper_rad - q1.max(), _STEP_RAD)
    if not len(angles):
        return [BaseTurn(angle_rad=0.0, share=images.base_share(few))]
    share = shares(angles)
    # Contours are narrower than a step: the best steps are searched closely.
    tops = angles[np.argsort(-share, kind="stable")[:_TOPS]]
    fine = np.unique(np.clip((tops[:, None] + _FINE_STEPS_RAD).ravel(), angles[0], angles[-1]))
    angles, share = np.concatenate([angles, fine]), np.concatenate([share, shares(fine)])
    turns: list[BaseTurn] = []
    for k in np.argsort(-share, kind="stable"):
        if all(abs(angles[k] - turn.angle_rad) > DIFFERENT_TURN_RAD for turn in turns):
            turns.append(BaseTurn(angle_rad=float(angles[k]), share=float(share[k])))
    if turns[0].share == 0.0:
        return [BaseTurn(angle_rad=0.0, share=0.0)]
    return turns


def is_same_arm(one: Lens, other: Lens, factor: float = 1.0) -> bool:
    """Return whether two cameras see the same axis of joint 1, whatever the turn about it.

    Args:
        one: a camera.
        other: another one.
        factor: of the tolerances of 3 degrees, 3 % of the distance and 5 % of the focal length.
    """
    zoom = abs(float(np.log(one.camera.fx / other.camera.fx)))
    (axis, shoulder), (other_axis, other_shoulder) = _axis(one), _axis(other)
    far = float(np.linalg.norm(shoulder - other_shoulder) / np.linalg.norm(shoulder))
    along = float(axis @ other_axis) >= np.cos(factor * _SAME_RAD)
    return along and zoom <= factor * _SAME_ZOOM and far <= factor * _SAME_SHARE


def _axis(lens: Lens) -> tuple[Array, Array]:
    """Return direction (3,) of joint 1 and shoulder (3,) on it [m] in the camera frame."""
    axis = lens.X_CB[:3, 2]
    return axis, lens.X_CB[:3, 3] + _SHOULDER_M * axis
