"""Tracking of the gripper: detection in the whole image, pose estimation in a crop, refits along the video."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, interpolate_pose, transform_points
from kinebench_drake.grounding.priors import NO_PRIORS, Priors
from kinebench_drake.grounding.registration.arm_fit import ArmFitter, ArmView
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.fit import (
    UNSEEN_FINGER_M,
    HandFit,
    calibrate_depth,
    finger_or_default,
    fit_all,
    refit_all,
)
from kinebench_drake.grounding.registration.hand_contour import HandImage, fit_shape, gap_log_likelihoods
from kinebench_drake.grounding.registration.icp import IcpRefiner
from kinebench_drake.grounding.registration.image import GradientImage
from kinebench_drake.grounding.registration.silhouette import SilhouetteMatcher
from kinebench_drake.grounding.registration.solver import BATCH, Correspondences
from kinebench_drake.grounding.tracking.flange_fit import ChainFitter
from kinebench_drake.grounding.tracking.localization import find_region, likeliest_gripper
from kinebench_drake.grounding.tracking.mount import find_mount
from kinebench_drake.grounding.tracking.pose import Confidence, FramePose, frame_confidence, load_confidence
from kinebench_drake.grounding.tracking.refinement import EdgeRefinement
from kinebench_drake.grounding.tracking.view import (
    CLOSE_MARGIN,
    CLOSE_SIZE,
    GRIPPER_CENTRE_H,
    Crop,
    DenseEstimator,
    GripperView,
    OverrideEstimator,
)
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.gripper import X_HALF_TURN, GripperModel
from kinebench_drake.models.panda.cad import GripperCad, franka_hand
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.track import Domain

# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_SURE_SHARE = 0.8
"""Mean confidence of the poses below which a familiar video is tried as an unfamiliar one."""
_RECENTRE = 0.2
"""Offset of the gripper from the crop's centre, over half the crop, beyond which a new crop is taken."""
_RESCALE = 1.25
"""Factor between the gripper's size in the crop and the desired one beyond which a new crop is taken."""
_MAX_GAP = 12
"""Frames over which the crop of a lost gripper is interpolated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracking:
    """Measurements of a tracker, frame by frame."""

    poses: tuple[FramePose | None, ...]
    """(T,) gripper in each frame; None where it was not detected."""
    wide: tuple[GripperView, ...]
    """(T,) views of the whole images."""
    robot: NDArray[np.bool_]
    """(H, W) pixels of the first frame that show the robot."""
    domain: Domain = Domain.FAMILIAR
    gripper: GripperModel = field(default_factory=franka_hand)
    """Gripper as it is mounted; poses are those of its frame."""

    @property
    def agreeing(self) -> int:
        """Number of frames in which hand and arm agree."""
        return sum(pose is not None and pose.arm_agrees for pose in self.poses)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandView:
    """Hand fitted to a view alone."""

    fit: HandFit
    view: GripperView


class PoseTracker(Protocol):
    """Estimator of hand poses from frames: `CadTracker` or another program."""

    def track(
        self, frames: Frames, camera: Camera, priors: Priors = NO_PRIORS, places: Array | None = None
    ) -> Tracking:
        """Measure the gripper in each of `frames` (T, H, W, 3); `priors` replace estimates.

        A moving camera has `places` (T, 3) in the frame of `camera` [m]; poses are in the camera of each frame.

        Raises:
            InputError: the priors do not fit the video.
        """
        ...


class CadTracker:
    """Detection in the whole image, fit of the hand in its crop, fit of hand and arm, ICP.

    Every frame is measured independently, so errors do not accumulate; neighbours propose crops for frames in which
    the gripper was not detected, and initial postures for doubtful ones. Only a frame without a sure pose is reached by
    following the arm from its neighbours, and its edges must confirm it.
    """

    def __init__(
        self,
        estimator: DenseEstimator,
        gripper: GripperModel | None = None,
        confidence: Mapping[Domain, Confidence] | None = None,
    ) -> None:
        """Track a gripper, by default the Franka hand, with dense estimates of `estimator`.

        The `confidence` (default: the shipped one) decides on the domain.
        """
        self._estimator = estimator
        self._confidence = confidence or load_confidence()
        self._gripper = gripper or franka_hand()
        cad = GripperCad(self._gripper)
        self._icp = IcpRefiner(cad)
        self._silhouette = SilhouetteMatcher(cad)
        self._arm = ArmModel(self._gripper)
        self._chain = ChainFitter(ArmModel()) if self._gripper.mounts_vary else None
        self._edges = EdgeMatcher(self._gripper)

    def track(
        self, frames: Frames, camera: Camera, priors: Priors = NO_PRIORS, places: Array | None = None
    ) -> Tracking:
        """Measure the gripper in each of `frames`, as `PoseTracker.track`."""
        priors.check_shapes(*frames.shape[:3])
        priors = self._calibrate(frames, camera, priors)
        estimator = OverrideEstimator(self._estimator, priors)

        def detect(region: Crop) -> tuple[dict[int, GripperView], dict[int, Array]]:
            """Return the view of `region` by frame number, and poses X_CH of the gripper where it is detected."""
            estimates = estimator.estimate(frames, camera, dict.fromkeys(range(len(frames)), region))
            wide = dict[int, GripperView]()
            hands = dict[int, Array]()
            while views := dict(islice(estimates, BATCH)):
                wide |= views
                hands |= self._detect(views, priors)
            return wide, hands

        wide, hands = detect(Crop.of_frame(camera))
        region = find_region(estimator, frames, camera, wide, hands)
        if region is not None:
            wide, hands = detect(region)
        crops = {i: Crop.of_gripper(X_CH, CLOSE_MARGIN, CLOSE_SIZE) for i, X_CH in hands.items()}
        model = self._arm
        if self._chain is not None and crops:
            model = ArmModel(find_mount(estimator, frames, camera, crops, wide, self._gripper, self._chain))
        arm = ArmFitter(camera, model, self._edges, places)

        def measure(crops: dict[int, Crop]) -> dict[int, FramePose]:
            """Return the poses of the frames of `crops` that show a gripper."""
            estimates = estimator.estimate(frames, camera, crops)
            poses = dict[int, FramePose]()
            while views := dict(islice(estimates, BATCH)):
                poses |= self._measure(views, wide, arm, priors)
            return poses

        start = measure(crops)
        start |= measure(self._corrected_crops(start))
        start |= measure(self._proposed_crops(len(frames), start))

        def refine(*, may_be_familiar: bool) -> EdgeRefinement:
            refinement = EdgeRefinement(
                start, wide, frames, camera, arm, self._silhouette, measure, may_be_familiar=may_be_familiar
            )
            if refinement.is_familiar or not priors.camera_is_assumed:
                refinement.run()
            return refinement

        domain = Domain.FAMILIAR
        if priors.has_exact_depth:
            poses = self._register_all(start)
        else:
            refinement = refine(may_be_familiar=not priors.camera_is_fitted)
            poses = self._register_all(refinement.poses)
            domain = refinement.domain
            expected = self._expected(poses, domain)
            is_settled = not refinement.is_familiar or priors.camera_is_assumed
            if not is_settled and expected < _SURE_SHARE * len(poses):
                other = self._register_all(refine(may_be_familiar=False).poses)
                if self._expected(other, Domain.UNFAMILIAR) > expected:
                    poses = other
                    domain = Domain.UNFAMILIAR
        if domain is Domain.UNFAMILIAR:
            poses |= self._with_contours(poses, arm, frames, camera)
        return Tracking(
            poses=tuple(poses.get(i) for i in range(len(frames))),
            wide=tuple(wide[i] for i in range(len(frames))),
            robot=wide[0].to_frame(wide[0].part > 0, camera),
            domain=domain,
            gripper=model.gripper,
        )

    def fit_hands(self, frames: Frames, camera: Camera, X_CH: Mapping[int, Array]) -> dict[int, HandView]:
        """Return the hands seen near poses X_CH (4, 4) [m] by frame number, fitted without the arm."""
        crops = {i: Crop.of_gripper(X, CLOSE_MARGIN, CLOSE_SIZE) for i, X in X_CH.items()}
        views = dict(self._estimator.estimate(frames, camera, crops))
        none = [None] * len(views)
        fits = zip(views, self._fit_all(list(views.values()), none, none), strict=True)
        return {i: HandView(fit=fit, view=views[i]) for i, fit in fits if fit is not None}

    def overlap(self, hand: HandView, X_CH: Array) -> float:
        """Return the overlap of the mask of a hand with the gripper rendered at a pose (4, 4) [m]."""
        return self._silhouette.overlap(hand.view, X_CH, finger_or_default(hand.fit.finger_m))

    def _with_contours(
        self, poses: Mapping[int, FramePose], arm: ArmFitter, frames: Frames, camera: Camera
    ) -> dict[int, FramePose]:
        """Return the poses whose arm agrees with the shape of the hand and the gap of the fingers by their contours."""
        hands = {
            i: HandImage(image=GradientImage(frames[i], camera), X_CP=arm.at([i]).closed(pose.arm))
            for i, pose in poses.items()
            if pose.arm is not None and pose.arm.agrees
        }
        gaps = gap_log_likelihoods(self._edges, hands)
        fits = self._fit_all([poses[i].view for i in hands], [poses[i].X_CH for i in hands], [None] * len(hands))
        refined = {}
        for (i, hand), fit in zip(hands.items(), fits, strict=True):
            X_CP = self._gripper.open(hand.X_CP, finger_or_default(poses[i].finger_m))
            refined[i] = replace(
                poses[i],
                finger_m=float("nan") if fit is None else fit.finger_m,
                finger_sigma_m=float("nan") if fit is None else fit.finger_sigma_m,
                shape=None if self._gripper.linkage is not None else fit_shape(self._edges, hand.image, X_CP),
                gap_log_likelihood=gaps.get(i),
            )
        return refined

    def _expected(self, poses: Mapping[int, FramePose], domain: Domain) -> float:
        """Return how many of the poses are right, as their confidence states."""
        return sum(frame_confidence(pose, domain, self._confidence) for pose in poses.values())

    def _calibrate(self, frames: Frames, camera: Camera, priors: Priors) -> Priors:
        """Scale another program's estimated depth by the first frame, if the pose in it is known.

        The network's own depth is not scaled: its error varies along a video as much as between videos.
        """
        X_CH = priors.pose(0)
        depth = priors.depth
        finger_m = priors.finger_m(0)
        if X_CH is None or depth is None or depth.exact:
            return priors
        crop = Crop.of_gripper(X_CH, CLOSE_MARGIN, CLOSE_SIZE)
        ((_, view),) = OverrideEstimator(self._estimator, priors).estimate(frames, camera, {0: crop})
        is_given = np.isfinite(depth.depth_m[0]) & (depth.depth_m[0] > 0)  # elsewhere the view has the network's depth
        cells = np.asarray(crop.warp(is_given.astype(np.uint8), camera, view.stride, nearest=True), dtype=bool)
        view = replace(view, part=np.where(cells, view.part, RobotPart.BACKGROUND).astype(np.uint8))
        finger_m = UNSEEN_FINGER_M if finger_m is None else finger_m
        return replace(priors, depth=calibrate_depth(depth, view, X_CH, finger_m))

    def _fit_all(
        self, views: Sequence[GripperView], X_CH: Sequence[Array | None], finger_m: Sequence[float | None]
    ) -> list[HandFit | None]:
        return fit_all(views, X_CH, finger_m, self._gripper.max_finger_m)

    def _detect(self, views: Mapping[int, GripperView], priors: Priors) -> dict[int, Array]:
        """Return poses X_CH (4, 4) of the gripper detected in views of whole images, or known from priors [m]."""
        poses = {i: X_CH for i in views if (X_CH := priors.pose(i)) is not None}
        rest = [i for i in views if i not in poses]
        none = [None] * len(rest)
        hands = self._fit_all([likeliest_gripper(views[i]) for i in rest], none, none)
        poses |= {i: hand.X_CH for i, hand in zip(rest, hands, strict=True) if hand is not None}
        return {i: poses[i] for i in views if i in poses}

    def _measure(
        self, views: Mapping[int, GripperView], wide: Mapping[int, GripperView], arm_fitter: ArmFitter, priors: Priors
    ) -> dict[int, FramePose]:
        """Return the poses in frames whose crops show the gripper, by frame number."""
        numbers = list(views)
        fits = self._fit_all(
            list(views.values()), [priors.pose(i) for i in numbers], [priors.finger_m(i) for i in numbers]
        )
        cells_only = {i: hand for i, hand in zip(numbers, fits, strict=True) if hand is not None}
        if self._gripper.is_symmetric:
            turned = [
                i for i, hand in cells_only.items() if arm_fitter.at([i]).is_turned(ArmView.of(hand, views[i], wide[i]))
            ]
            views = {**views, **{i: views[i].half_turned() for i in turned}}
            cells_only |= {i: replace(cells_only[i], X_CH=cells_only[i].X_CH @ X_HALF_TURN) for i in turned}
        rims = {i: self._rim(views[i], hand, priors, i) for i, hand in cells_only.items()}
        with_rim = {i: rim for i, rim in rims.items() if rim is not None}
        refitted = refit_all(
            [cells_only[i] for i in with_rim],
            [views[i] for i in with_rim],
            list(with_rim.values()),
            self._gripper.max_finger_m,
        )
        hands = cells_only | dict(zip(with_rim, refitted, strict=True))
        shown = [ArmView.of(hand, views[i], wide[i]) for i, hand in hands.items()]
        arms = arm_fitter.at(list(hands)).fit_all(shown, [rims[i] for i in hands])
        poses = {}
        for (i, hand), arm in zip(hands.items(), arms, strict=True):
            from_prior = priors.pose(i) is not None
            best = arm if arm is not None and arm.agrees and not from_prior else hand
            poses[i] = FramePose(
                X_CH=best.X_CH,
                finger_m=best.finger_m,
                finger_sigma_m=best.finger_sigma_m,
                hand=hand,
                hand_without_silhouette=cells_only[i],
                arm=arm,
                view=views[i],
                overlap=self._silhouette.overlap(views[i], best.X_CH, finger_or_default(best.finger_m)),
                from_prior=from_prior,
            )
        return poses

    def _rim(self, view: GripperView, hand: HandFit, priors: Priors, number: int) -> Correspondences | None:
        """Return the correspondences of the silhouette where the pose depends on it."""
        is_exact = priors.pose(number) is not None or priors.has_exact_depth
        return None if is_exact else self._silhouette.match(view, hand.X_CH, finger_or_default(hand.finger_m))

    def _register_all(self, poses: Mapping[int, FramePose]) -> dict[int, FramePose]:
        """Return the poses combined with their registration by ICP."""
        return {i: self._register(pose) for i, pose in poses.items()}

    def _register(self, pose: FramePose) -> FramePose:
        finger_m = finger_or_default(pose.finger_m)
        icp = None if pose.from_prior else self._icp.refine(pose.view, pose.X_CH, pose.covariance, finger_m)
        if icp is None or icp.weight == 0.0:
            return replace(pose, icp=icp)
        return replace(pose, X_CH=icp.X_CH, icp=icp, overlap=self._silhouette.overlap(pose.view, icp.X_CH, finger_m))

    @staticmethod
    def _corrected_crops(poses: dict[int, FramePose]) -> dict[int, Crop]:
        """Return new crops for the frames whose gripper is off centre or of the wrong size in its crop."""
        crops = {}
        for i, pose in poses.items():
            desired = Crop.of_gripper(pose.X_CH, CLOSE_MARGIN, CLOSE_SIZE)
            used = pose.view.crop
            centre = transform_points(used.X_CV.T @ pose.X_CH, GRIPPER_CENTRE_H[None])[0]
            offset = np.abs(centre[:2] / centre[2]).max() * used.focal / (used.size / 2)
            scale = desired.focal / used.focal
            if offset > _RECENTRE or max(scale, 1 / scale) > _RESCALE:
                crops[i] = desired
        return crops

    @staticmethod
    def _proposed_crops(n: int, poses: dict[int, FramePose]) -> dict[int, Crop]:
        """Return crops for frames without a pose, between the nearest frames that have one."""
        crops = {}
        measured = sorted(poses)
        for i in set(range(n)) - set(measured):
            before = max((k for k in measured if i - _MAX_GAP <= k < i), default=None)
            after = min((k for k in measured if i < k <= i + _MAX_GAP), default=None)
            if before is not None and after is not None:
                X_CH = interpolate_pose(poses[before].X_CH, poses[after].X_CH, (i - before) / (after - before))
            elif before is not None or after is not None:
                X_CH = poses[before if before is not None else after].X_CH  # type: ignore[index]
            else:
                continue
            crops[i] = Crop.of_gripper(X_CH, 1.5 * CLOSE_MARGIN, CLOSE_SIZE)
        return crops
