"""Propagation of arm postures between neighbouring frames, for frames whose CAD coordinates are wrong.

Seen edge-on, a gripper's CAD coordinates can all be wrong by the same 30 mm and 25 degrees and still be consistent with
each other; only silhouette and arm contradict them. Started from the posture of the frame before or after, the fit of
silhouette and arm converges to the right pose.
"""

from dataclasses import replace

from kinebench_drake.grounding.frame_pose import FramePose
from kinebench_drake.grounding.registration.arm_fit import ArmFitter
from kinebench_drake.grounding.registration.fit import finger_or_default
from kinebench_drake.grounding.registration.silhouette import SilhouetteMatcher
from kinebench_drake.grounding.view import GripperView

SOURCE_OVERLAP, GOOD_OVERLAP = 0.6, 0.8
"""Overlap of segmented and rendered gripper from which a pose is propagated, and from which it is not replaced."""
_OVERLAP_GAIN = 0.03  # least improvement of the overlap by a propagated pose


def propagate(
    poses: dict[int, FramePose], wide: dict[int, GripperView], arm_fitter: ArmFitter, silhouette: SilhouetteMatcher
) -> None:
    """Refit doubtful poses from the frame before, then from the one after; keep a refit that matches better.

    Args:
        poses: pose by frame number; doubtful ones are replaced.
        wide: view of the whole image by frame number.
        arm_fitter: fitter of the arm.
        silhouette: comparison of the rendered with the segmented gripper.
    """
    for step in (1, -1):
        for i in sorted(poses)[::step]:
            near = poses.get(i - step)
            if near is not None and _is_doubtful(poses[i]) and _arm_agrees(near) and near.overlap >= SOURCE_OVERLAP:
                poses[i] = _refit(poses[i], near, wide[i], arm_fitter, silhouette)


def _refit(
    pose: FramePose, near: FramePose, wide: GripperView, arm_fitter: ArmFitter, silhouette: SilhouetteMatcher
) -> FramePose:
    arm = None if near.arm is None else arm_fitter.fit_from_neighbour(near.arm, pose.hand, pose.view, wide, silhouette)
    if arm is None or not arm.agrees:
        return pose
    overlap = silhouette.overlap(pose.view, arm.X_CH, finger_or_default(arm.finger_m))
    if overlap < max(SOURCE_OVERLAP, pose.overlap + _OVERLAP_GAIN):
        return pose
    return replace(
        pose, X_CH=arm.X_CH, finger_m=arm.finger_m, finger_sigma_m=arm.finger_sigma_m, arm=arm, overlap=overlap
    )


def _is_doubtful(pose: FramePose) -> bool:
    return not pose.from_prior and not (_arm_agrees(pose) and pose.overlap >= GOOD_OVERLAP)


def _arm_agrees(pose: FramePose) -> bool:
    return pose.arm is not None and pose.arm.agrees
