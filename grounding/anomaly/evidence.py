"""What the detectors look at, gathered from frames and from what the tracker saw."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.grounding.anomaly.camera_motion import CameraMotion
from kinebench_drake.grounding.anomaly.duplicate import second_gripper
from kinebench_drake.grounding.anomaly.freeze import still_frames
from kinebench_drake.grounding.anomaly.shape import shape_misfit
from kinebench_drake.grounding.crop import GRIPPER_CENTRE_H
from kinebench_drake.grounding.frame_pose import FramePose
from kinebench_drake.grounding.gripper_width import SHARP_M
from kinebench_drake.grounding.view import Frames, GripperView

FAIR_CONFIDENCE = 0.1
"""From here on a frame's position counts where jumps are looked for, and its shape: a gripper that has lost it is posed
with little confidence ..."""
SURE_CONFIDENCE = 0.3
"""... from here on its fingers ..."""
GOOD_CONFIDENCE = 0.5
"""... and its size, which a pose that is off by a few degrees belies."""
SEEN_M = 0.006
"""Gaps count for impossible openings where they are known to this (standard deviation) [m]."""
SIZE_SIDE = 0.5
"""Size counts only where the fingers' axis and the line of sight have a cosine below this: from the side the gripper is
narrow, and fingers hide each other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """One video's series over T frames; NaN where something is unknown."""

    t_s: Array
    """(T,) task time [s]."""
    p_C: Array
    """(T, 3) centre of the gripper in the camera frame [m]."""
    confidence: Array
    """(T,) 0..1, 0 where no gripper was found."""
    explained: Array
    """(T,) cells of the close view that the posed gripper explains, 0 where none was found."""
    finger_width_m: Array
    """(T,) gap between the pads [m] where it is seen sharply."""
    other: Array
    """(T,) share of a gripper that is seen apart from the tracked one."""
    misfit: Array
    """(T,) relative misfit of the gripper's shape."""
    residual: Array
    """(T,) of the cells against the rigid gripper [standard deviations]."""
    scale: Array
    """(T,) apparent size of the hand over the size that it has where the arm puts it, seen from its broad side."""
    still: NDArray[np.bool_]
    """(T,) frames that repeat the one before."""
    motion: CameraMotion
    camera: Camera

    def __post_init__(self) -> None:
        """Check that all series are equally long.

        Raises:
            InputError: one is not.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray) and len(value) != len(self.t_s):
                raise InputError(f"{field.name} is of {len(value)} frames, t_s of {len(self.t_s)}; they must be equal")

    @property
    def fair(self) -> NDArray[np.bool_]:
        """(T,) frames whose position counts."""
        return np.asarray(self.confidence >= FAIR_CONFIDENCE)

    @property
    def good(self) -> NDArray[np.bool_]:
        """(T,) frames whose pose is more likely right than wrong."""
        return np.asarray(self.confidence >= GOOD_CONFIDENCE)


def gather(
    frames: Frames,
    camera: Camera,
    t_s: Array,
    wide: Sequence[GripperView],
    poses: Sequence[FramePose | None],
    confidence: Array,
    motion: CameraMotion,
) -> Evidence:
    """Gather the evidence of a video.

    Args:
        frames: (T, H, W, 3) RGB.
        camera: of the first frame.
        t_s: (T,) task time [s].
        wide: (T,) views of whole frames.
        poses: (T,) the tracker's poses, in the readings that suit the video; against the first frame's camera.
        confidence: (T,) of these, 0 where there is none.
        motion: of the camera.
    """
    n = len(frames)
    p_C = np.full((n, 3), np.nan)
    explained = np.zeros(n)
    width, misfit, residual, scale = (np.full(n, np.nan) for _ in range(4))
    for i, pose in enumerate(poses):
        if pose is None:
            continue
        explained[i] = pose.fit.points * pose.overlap
        p_C[i] = transform_points(pose.X_CH, GRIPPER_CENTRE_H[None])[0]
        if confidence[i] >= FAIR_CONFIDENCE:
            hand = pose.by_cells
            sharp = 2 * hand.finger_sigma_m <= SHARP_M
            misfit[i] = shape_misfit(pose.view, hand.X_CH, hand.finger_m if sharp else np.nan)
            residual[i] = hand.residual
        if confidence[i] >= SURE_CONFIDENCE:
            sigma_m = 2 * pose.fit.finger_sigma_m
            width[i] = 2 * pose.finger_m if sigma_m <= SEEN_M else np.nan
            side = abs(float(pose.X_CH[:3, 1] @ p_C[i])) / float(np.linalg.norm(p_C[i]))
            if side <= SIZE_SIDE and pose.arm is not None and confidence[i] >= GOOD_CONFIDENCE:
                scale[i] = pose.arm.scale
    other = [
        second_gripper(view, None if pose is None else pose.X_CH, camera)
        for view, pose in zip(wide, poses, strict=True)
    ]
    return Evidence(
        t_s=t_s,
        p_C=p_C,
        confidence=confidence,
        explained=explained,
        finger_width_m=width,
        other=np.array(other),
        misfit=misfit,
        residual=residual,
        scale=scale,
        still=still_frames(frames),
        motion=motion,
        camera=camera,
    )
