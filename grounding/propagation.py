"""Frames in which the gripper was misread, measured again from the frames next to them.

Seen from its narrow side a gripper's CAD coordinates can be wrong all together, by 30 mm and 25 degrees, and still
agree with each other; its outline and the arm show that. The pose of the frame before or after is near the right one,
and from there both lead to it.
"""

from dataclasses import replace

from kinebench_drake.grounding.frame_pose import FramePose
from kinebench_drake.grounding.registration.arm_fit import ArmFitter
from kinebench_drake.grounding.registration.fit import drawn
from kinebench_drake.grounding.registration.silhouette import Silhouette
from kinebench_drake.grounding.view import GripperView

FAIR_OVERLAP, GOOD_OVERLAP = 0.6, 0.8
"""Overlap of the seen and the rendered gripper from which a pose is an example, and from which it is not doubted."""
_BETTER_OVERLAP = 0.03  # by which another pose has to cover the gripper better


def propagate(
    poses: dict[int, FramePose], wide: dict[int, GripperView], arm_fitter: ArmFitter, outline: Silhouette
) -> None:
    """Try the posture of the frame before, then of the one after, where a pose is doubted; keep what fits better.

    Args:
        poses: by number of the frame; doubted ones are replaced.
        wide: views of the whole frames.
        arm_fitter: what fits the arm.
        outline: what compares the rendered gripper with the one seen.
    """
    for step in (1, -1):
        for i in sorted(poses)[::step]:
            near = poses.get(i - step)
            if near is not None and _doubted(poses[i]) and _exemplary(near):
                poses[i] = _followed(poses[i], near, wide[i], arm_fitter, outline)


def _followed(
    pose: FramePose, near: FramePose, wide: GripperView, arm_fitter: ArmFitter, outline: Silhouette
) -> FramePose:
    arm = None if near.arm is None else arm_fitter.follow(near.arm, pose.fit, pose.view, wide, outline)
    if arm is None or not arm.agrees:
        return pose
    overlap = outline.overlap(pose.view, arm.X_CH, drawn(arm.finger_m))
    if overlap < max(FAIR_OVERLAP, pose.overlap + _BETTER_OVERLAP):
        return pose
    return replace(
        pose, X_CH=arm.X_CH, finger_m=arm.finger_m, finger_sigma_m=arm.finger_sigma_m, arm=arm, overlap=overlap
    )


def _doubted(pose: FramePose) -> bool:
    return not pose.given and not (_agrees(pose) and pose.overlap >= GOOD_OVERLAP)


def _exemplary(pose: FramePose) -> bool:
    return _agrees(pose) and pose.overlap >= FAIR_OVERLAP


def _agrees(pose: FramePose) -> bool:
    return pose.arm is not None and pose.arm.agrees
