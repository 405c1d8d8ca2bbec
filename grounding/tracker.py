"""From frames to hand poses: find the gripper in every frame, look closely, fit, refine, then judge along the video."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import interpolate_pose, invert, transform_points
from kinebench_drake.grounding.crop import CLOSE_SIZE, GRIPPER_CENTRE_H, WIDE_SIZE, Crop
from kinebench_drake.grounding.frame_pose import FramePose
from kinebench_drake.grounding.override_estimator import OverrideEstimator, calibrated
from kinebench_drake.grounding.propagation import propagate
from kinebench_drake.grounding.registration.arm_fit import ArmFitter
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.fit import UNSEEN_FINGER_M, drawn, fit, refit
from kinebench_drake.grounding.registration.icp import IcpRefiner
from kinebench_drake.grounding.registration.silhouette import Silhouette
from kinebench_drake.grounding.view import DepthEstimator, Frames, GripperView
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.types import NO_PRIORS, Priors

CLOSE_MARGIN = 1.3
"""Half width of the close view over the gripper's radius."""
_RECENTRE = 0.2  # offset of the gripper from the middle of its view, over half the view, that asks for a new look
_RESCALE = 1.25  # likewise the factor between its size there and the wanted one
_PROPOSAL_GAP = 12  # frames across which a lost gripper is looked for between its neighbours


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracking:
    """What a tracker saw in a video."""

    poses: tuple[FramePose | None, ...]
    """(T,) the gripper in each frame, None where it was not found."""
    wide: tuple[GripperView, ...]
    """(T,) views of the whole frames."""
    robot: NDArray[np.bool_]
    """(H, W) pixels of the first frame that show the robot: no background."""


class PoseTracker(Protocol):
    """What turns frames into hand poses: the CAD tracker here, or another program's."""

    def track(self, frames: Frames, camera: Camera, known: Priors = NO_PRIORS) -> Tracking:
        """Track the gripper through `frames` (T, H, W, 3), of which something may be `known` beforehand."""
        ...


def whole_frame(camera: Camera, size: int = WIDE_SIZE) -> Crop:
    """The square view that holds the whole frame."""
    half = np.array([camera.width / 2, camera.height / 2])
    direction = np.array([(half[0] - camera.cx) / camera.fx, (half[1] - camera.cy) / camera.fy, 1.0])
    return Crop.towards(direction, float(max(half / [camera.fx, camera.fy])), size)


class CadTracker:
    """Detection in the whole frame, a close look, a fit of the hand, then of hand and arm, ICP where depth is exact.

    Every frame is measured by itself, so that an error cannot drift on; neighbours only propose where to look again
    for a gripper that was not found.
    """

    def __init__(self, estimator: DepthEstimator, cad: GripperCad | None = None) -> None:
        """Track with `estimator`."""
        self._estimator = estimator
        self._cad = cad or GripperCad()
        self._icp = IcpRefiner(self._cad)
        self._outline = Silhouette(self._cad)
        self._arm = ArmModel()

    def track(self, frames: Frames, camera: Camera, known: Priors = NO_PRIORS) -> Tracking:
        """See `PoseTracker`.

        Raises:
            InputError: what is known is of another video.
        """
        known.check_shapes(*frames.shape[:3])
        known = self._calibrated(frames, camera, known)
        estimator = OverrideEstimator(self._estimator, known)
        crops: dict[int, Crop] = {}
        detections: dict[int, GripperView] = {}
        for i, view in estimator.estimate(frames, camera, dict.fromkeys(range(len(frames)), whole_frame(camera))):
            detections[i] = view
            X_CH = known.pose(i)
            found = None if X_CH is not None else fit(view)
            if found is not None:
                X_CH = found.X_CH
            if X_CH is not None:
                crops[i] = Crop.of_gripper(X_CH, CLOSE_MARGIN, CLOSE_SIZE)
        arm = ArmFitter(camera, self._arm)
        poses: dict[int, FramePose] = {}

        def look(crops: dict[int, Crop]) -> None:
            """Measure the frames of `crops` in their views and enter what was found into `poses`."""
            for i, view in estimator.estimate(frames, camera, crops):
                pose = self._measure(view, detections[i], arm, known, i)
                if pose is not None:
                    poses[i] = pose

        look(crops)
        look(self._badly_framed(poses))
        look(self._proposals(len(frames), poses))
        if not known.has_exact_depth:
            propagate(poses, detections, arm, self._outline)
        return Tracking(
            poses=tuple(poses.get(i) for i in range(len(frames))),
            wide=tuple(detections[i] for i in range(len(frames))),
            robot=detections[0].to_frame(detections[0].part > 0, camera),
        )

    def _calibrated(self, frames: Frames, camera: Camera, known: Priors) -> Priors:
        """What is known, estimated depth of others set right in the first frame where its pose is known.

        The network's own depth has no factor of that kind: its error varies along a video as much as between videos.
        """
        X_CH, depth, finger_m = known.pose(0), known.depth, known.finger_m(0)
        if X_CH is None or depth is None or depth.exact:
            return known
        crop = Crop.of_gripper(X_CH, CLOSE_MARGIN, CLOSE_SIZE)
        ((_, view),) = OverrideEstimator(self._estimator, known).estimate(frames, camera, {0: crop})
        return replace(known, depth=calibrated(depth, view, X_CH, UNSEEN_FINGER_M if finger_m is None else finger_m))

    def _measure(
        self, view: GripperView, wide: GripperView, arm_fitter: ArmFitter, known: Priors, number: int
    ) -> FramePose | None:
        given = known.pose(number)
        by_cells = fit(view, X_CH=given, finger_m=known.finger_m(number))
        if by_cells is None:
            return None
        hand = by_cells
        free = given is None
        rim = self._outline.rim(view, hand.X_CH, drawn(hand.finger_m)) if free and not known.has_exact_depth else None
        if rim is not None:
            hand = refit(hand, view, rim)
        arm = arm_fitter.fit(hand, view, wide, rim)
        best = arm if arm is not None and arm.agrees and free else hand
        X_CH = best.X_CH
        if known.has_exact_depth and free:
            refined = self._icp.refine(view, invert(view.crop.X_CV) @ X_CH, drawn(best.finger_m))
            X_CH = X_CH if refined is None else view.crop.X_CV @ refined.X_VH
        return FramePose(
            X_CH=X_CH,
            finger_m=best.finger_m,
            finger_sigma_m=best.finger_sigma_m,
            fit=hand,
            by_cells=by_cells,
            arm=arm,
            view=view,
            overlap=self._outline.overlap(view, X_CH, drawn(best.finger_m)),
            given=not free,
        )

    @staticmethod
    def _badly_framed(poses: dict[int, FramePose]) -> dict[int, Crop]:
        """New crops for the frames whose close view turned out off centre or of the wrong size."""
        crops = {}
        for i, pose in poses.items():
            wanted = Crop.of_gripper(pose.X_CH, CLOSE_MARGIN, CLOSE_SIZE)
            had = pose.view.crop
            centre = transform_points(had.X_CV.T @ pose.X_CH, GRIPPER_CENTRE_H[None])[0]
            offset = np.abs(centre[:2] / centre[2]).max() * had.focal / (had.size / 2)
            scale = wanted.focal / had.focal
            if offset > _RECENTRE or max(scale, 1 / scale) > _RESCALE:
                crops[i] = wanted
        return crops

    @staticmethod
    def _proposals(n: int, poses: dict[int, FramePose]) -> dict[int, Crop]:
        """Crops for frames without a pose, between the nearest frames that have one."""
        crops = {}
        known = sorted(poses)
        for i in set(range(n)) - set(known):
            before = max((k for k in known if i - _PROPOSAL_GAP <= k < i), default=None)
            after = min((k for k in known if i < k <= i + _PROPOSAL_GAP), default=None)
            if before is not None and after is not None:
                s = (i - before) / (after - before)
                guess = interpolate_pose(poses[before].X_CH, poses[after].X_CH, s)
            elif before is not None or after is not None:
                guess = poses[before if before is not None else after].X_CH  # type: ignore[index]
            else:
                continue
            crops[i] = Crop.of_gripper(guess, 1.5 * CLOSE_MARGIN, CLOSE_SIZE)
        return crops
