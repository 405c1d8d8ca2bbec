"""How a gripper is mounted on the flange, from frames in which links and gripper are seen.

Links alone give the pose of panda_hand, the gripper its own: their difference is the mount. Adapters turn grippers by
eighths of a turn, and half a turn more looks alike.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import invert, make_pose, rotation_z
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.registration.solver import Correspondences
from kinebench_drake.grounding.tracking.flange_fit import ChainFitter
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, Crop, DenseEstimator, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.gripper import GripperModel

SHOWN_FRAMES = 24
"""Greatest number of frames that tell the mount."""
_EIGHTH_RAD = np.pi / 4
_TURNS = 4
_LEAST_COSINE = float(np.cos(np.deg2rad(30.0)))
"""Least cosine between the axes of gripper and flange by the two poses."""
_MAX_HEIGHT_M = 0.03
"""Greatest height of an adapter [m]."""


def find_mount(
    estimator: DenseEstimator,
    frames: Frames,
    camera: Camera,
    crops: Mapping[int, Crop],
    wide: Mapping[int, GripperView],
    gripper: GripperModel,
    chain: ChainFitter,
) -> GripperModel:
    """Return the gripper as it is mounted; unchanged if no frame shows it with the last links.

    Args:
        estimator: source of views.
        frames: (T, H, W, 3) RGB.
        camera: camera of the frames.
        crops: crops around the gripper by frame number.
        wide: views of whole images by frame number.
        gripper: gripper, mounted anyhow.
        chain: fitter of the last links.
    """
    numbers = sorted(crops)
    chosen = [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, SHOWN_FRAMES).astype(int))]
    close = dict(estimator.estimate(frames, camera, {i: crops[i] for i in chosen}))
    hands = {i: hand for i in chosen if (hand := fit(close[i], gripper.max_finger_m)) is not None}
    wrists = {i: Crop.of_wrist(hand.X_CH, CLOSE_SIZE) for i, hand in hands.items()}
    turns = list[complex]()
    heights = list[float]()
    weights = list[float]()
    for i, view in estimator.estimate(frames, camera, wrists):
        cells = Correspondences.join([Correspondences.of_view(v, v.arm) for v in (view, close[i], wide[i])])
        links = chain.fit(cells)
        if links is not None:
            X_MH = invert(links.model.X_CH[0]) @ hands[i].X_CH
            if X_MH[2, 2] < _LEAST_COSINE:  # one of the two poses is wrong: a mount turns about the axis alone
                continue
            # twice the angle is the same after half a turn
            turns.append(complex(X_MH[0, 0] + 1j * X_MH[1, 0]) ** 2)
            heights.append(float(X_MH[2, 3]))
            weights.append(1.0 / float(np.trace(hands[i].covariance[:3, :3])))
    if not turns:
        return gripper
    mean = np.angle(np.dot(weights, turns)) / 2
    turn_rad = _EIGHTH_RAD * (round(float(mean) / _EIGHTH_RAD) % _TURNS)
    height = float(np.clip(np.median(heights), 0.0, _MAX_HEIGHT_M))
    return replace(gripper, X_MH=make_pose(rotation_z(turn_rad), [0.0, 0.0, height]))
