"""Estimation of the camera of a video from the arm that it shows: neither camera nor joint angles are known."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.bundle_adjustment import Prior
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate, Rival
from kinebench_drake.grounding.camera.candidate import (
    COARSE,
    DIFFERENT_TURN_RAD,
    LOG_FOCAL_SIGMA,
    MIDDLE,
    BaseTurn,
    CameraCandidate,
    CandidateFitter,
    ContourImages,
    explained,
)
from kinebench_drake.grounding.camera.detections import MIN_FRAMES, ArmDetections, find_robot
from kinebench_drake.grounding.camera.hypotheses import ChainSearch, Hypothesis
from kinebench_drake.grounding.camera.lens import USUAL_FOV_DEG, Lens, centred_camera, focal_px
from kinebench_drake.grounding.camera.surroundings import Surroundings, find_lines, find_surroundings
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.tracking.flange_fit import ChainFitter
from kinebench_drake.grounding.tracking.localization import likeliest_gripper
from kinebench_drake.grounding.tracking.mount import find_mount
from kinebench_drake.grounding.tracking.view import CLOSE_MARGIN, CLOSE_SIZE, Crop, DenseEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.progress import count_steps
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.description import RobotPart

# Checked on right and wrong cameras, of which no wrong one may be accepted:
# `python -m benchmarks cameras FOLDER --out OUT --presented plain,named,mirrored,short_focal,long_focal`.
_ASKEW_LOSS = 0.2
"""Loss of the base's agreement from which on lines along its axes are those of something askew."""
_Ranked = TypeVar("_Ranked")

_FOV_DEG = (30.0, 42.0, 55.0, 72.0, 104.0)
"""Fields of view along the longer side at which the search starts [degrees]."""
JOINT_SIGMA_RAD = 0.01
"""Standard deviation of known joint angles [rad]: offsets of the joints, and clocks."""
FRAMES = 12
"""Greatest number of frames that a camera is estimated from: each adds eight unknowns."""
_CANDIDATES = 16
_FITTED = 6
"""Numbers of hypotheses compared, and of those fitted to the cells besides."""
_ROUNDS = ((4, COARSE, 8), (6, MIDDLE, 5))
"""Successive comparisons of candidates: frames, passes, candidates kept."""
_CLEARLY = 3.0
"""Multiple of the tolerances within which cameras are the same beyond which they contradict each other."""


class CameraEstimator:
    """Estimator of cameras; one instance serves any number of videos."""

    def __init__(self, estimator: DenseEstimator, gripper: GripperModel | None = None) -> None:
        """Estimate with the dense estimates of `estimator` from an arm with a gripper, by default the Franka hand.

        Raises:
            SetupError: meshes, native libraries or the robot description are missing.
        """
        self.estimator = estimator
        self.fitter = CandidateFitter(ArmModel(gripper), EdgeMatcher(gripper))

    def estimate(self, frames: Frames, camera: Camera, *, focal_free: bool = True) -> CameraEstimate:
        """Estimate place and focal length of the static camera of a video.

        Args:
            frames: (T, H, W, 3) RGB.
            camera: initial intrinsics, such as those of `usual_camera`.
            focal_free: True to estimate the focal length.

        Raises:
            UnmeasurableError: hand and arm are seen in too few frames.
        """
        detections = find_robot(self.estimator, frames, camera, FRAMES)
        if detections is None or len(detections.rows) < MIN_FRAMES:
            raise UnmeasurableError(
                f"no camera can be estimated: a gripper is seen in {len(detections.rows) if detections else 0} of the "
                f"frames searched, at least {MIN_FRAMES} are needed"
            )
        shown = frames[detections.rows]
        estimate = self._mounted(shown, camera).solve(detections, shown, camera, focal_free=focal_free)
        return replace(estimate, frames=detections.rows[estimate.frames])

    def _mounted(self, frames: Frames, camera: Camera) -> "CameraEstimator":
        """Return the estimator for the gripper as frames (T, H, W, 3) show it mounted."""
        gripper = self.fitter.model.gripper
        if not gripper.mounts_vary:
            return self
        whole = dict.fromkeys(range(len(frames)), Crop.of_frame(camera))
        wide = dict(self.estimator.estimate(frames, camera, whole))
        hands = {i: fit(likeliest_gripper(view), gripper.max_finger_m) for i, view in wide.items()}
        crops = {
            i: Crop.of_gripper(hand.X_CH, CLOSE_MARGIN, CLOSE_SIZE) for i, hand in hands.items() if hand is not None
        }
        chain = ChainFitter(ArmModel())
        mounted = find_mount(self.estimator, frames, camera, crops, wide, gripper, chain) if crops else gripper
        return CameraEstimator(self.estimator, mounted)

    def solve(self, detections: ArmDetections, frames: Frames, camera: Camera, *, focal_free: bool) -> CameraEstimate:
        """Estimate the camera from detections of the robot in frames (T, H, W, 3); its frames are rows of these.

        Raises:
            UnmeasurableError: too little of the arm is seen.
        """
        images = self.fitter.images(frames, camera)
        prior = Prior(
            lens=Lens(intrinsics=camera, X_CB=np.eye(4)), log_focal_sigma=LOG_FOCAL_SIGMA if focal_free else 0.0
        )
        search = ChainSearch(detections.cells, detections.finger_m, self.fitter.model)
        side = max(camera.width, camera.height)
        hypotheses = search.run(camera, [focal_px(side, fov) for fov in _FOV_DEG] if focal_free else [camera.fx])
        candidates = self._candidates(detections, hypotheses, prior)
        if not candidates:
            raise UnmeasurableError(
                f"no camera can be estimated: the arm behind the gripper is seen in fewer than {MIN_FRAMES} frames"
            )
        arm_images = images.without(RobotPart.LINK0)
        for frames_used, passes, kept in _ROUNDS:
            compared = [
                self.fitter.compare(c, arm_images, prior, frames_used, passes)
                for c in count_steps(candidates, f"cameras compared in {frames_used} frames", len(candidates))
            ]
            compared.sort(key=lambda candidate: -candidate.agreement)
            candidates = [
                self._extend(candidate, detections, search)
                for candidate in _distinct([(c.scene.lens, c) for c in compared])[:kept]
            ]
        # A hand from which no chain leads to a base is none.
        total = int(np.any([np.isfinite(h.q).all(axis=1) for h in hypotheses], axis=0).sum())
        arms = [self.fitter.settle(candidate, arm_images, prior, total)[0] for candidate in candidates]
        arms.sort(key=lambda arm: -arm.agreement)
        arms = _distinct([(arm.scene.lens, arm) for arm in arms], _CLEARLY)
        turns = [images.take(arm.rows).find_turns(arm.scene) for arm in arms]
        ranked = sorted(zip(arms, turns, strict=True), key=lambda pair: -(pair[0].agreement + pair[1][0].share))
        best, best_turns = ranked[0]
        estimate, turn = self.fit_turn(best, best_turns, images, prior, total)
        # Other cameras and turns are not fitted to the contours of the base: they are granted what that gained here.
        gain = max(0.0, estimate.base_agreement - turn.share)
        surroundings = self._find_surroundings(estimate, frames)
        if surroundings is not None:
            start = self._extend(replace(best, scene=estimate.scene, rows=estimate.frames), detections, search)
            aligned = self.fitter.finish(start, images, replace(prior, surroundings=surroundings), total)
            shares = [images.take(e.frames).base_share(e.scene) for e in (estimate, aligned)]
            if shares[1] >= shares[0] - _ASKEW_LOSS:
                own = arm_images.take(aligned.frames).agreement(aligned.scene)
                estimate = replace(
                    aligned,
                    agreement=max(best.agreement, explained(own, total)),
                    base_agreement=estimate.base_agreement,
                    # Other turns than by right angles would put these lines askew to the base.
                    turns=tuple(
                        replace(rival, share=min(rival.share, estimate.base_runner_up))
                        for rival in _rivals(best, [t for t in best_turns if t.is_right_angle_from(turn)], gain)
                    ),
                    is_aligned=True,
                )
        others = [
            replace(rival, share=(arm.agreement + rival.share) / 2)
            for arm, own_turns in ranked[1:]
            for rival in _rivals(arm, own_turns[:1], gain)
        ]
        return replace(estimate, others=tuple(others))

    def fit_turn(
        self, arm: CameraCandidate, turns: Sequence[BaseTurn], images: ContourImages, prior: Prior, total: int
    ) -> tuple[CameraEstimate, BaseTurn]:
        """Return the estimate with the base turned as its contours show it, and the turn; `turns` are best first.

        Turns that differ too little before the contours of the base are fitted are compared afterwards: a right one has
        more of them on image edges then.
        """
        # With less agreement there is no base frame, however the base is turned.
        is_seen = turns[0].share >= bounds.BASE_AGREEMENT
        close = [turn for turn in turns if turn.share > turns[0].share - bounds.LEAD] if is_seen else list(turns[:1])
        fits = []
        for turn in close:
            fit = self.fitter.finish(replace(arm, scene=arm.scene.turned(turn.angle_rad)), images, prior, total)
            share = images.take(fit.frames).base_share(fit.scene) if len(close) > 1 else turn.share
            fits.append(replace(fit, agreement=arm.agreement, base_agreement=share))
        best, turn = max(zip(fits, close, strict=True), key=lambda pair: pair[0].base_agreement)
        # Fits of different turns may lead to the same one.
        X_CB = best.scene.lens.X_CB
        apart = [fit for fit in fits if pose_difference(X_CB, fit.scene.lens.X_CB)[1] > DIFFERENT_TURN_RAD]
        gain = max(0.0, best.base_agreement - turn.share)  # granted to turns that are not fitted
        fitted = [Rival(camera=fit.camera, share=fit.base_agreement) for fit in apart]
        return replace(best, turns=(*fitted, *_rivals(arm, turns[len(close) :], gain))), turn

    def _find_surroundings(self, estimate: CameraEstimate, frames: Frames) -> Surroundings | None:
        """Return the lines of frames (T, H, W, 3) along the axes of the base of an estimate; None without them."""
        lens = estimate.scene.lens
        upwards = estimate.scene.lens.X_CB[:3, 2]
        X_CP = lens.X_CB @ self.fitter.model.poses(estimate.scene.q)
        lines = find_lines(frames, lens.intrinsics, X_CP, self.fitter.matcher)
        return find_surroundings(lines, lens, float(upwards @ estimate.bundle.covariance[:3, :3] @ upwards) ** 0.5)

    def _candidates(
        self, detections: ArmDetections, hypotheses: Sequence[Hypothesis], prior: Prior
    ) -> list[CameraCandidate]:
        """Return different cameras that explain the cells, as hypothesized and fitted to the cells."""
        starts = _distinct([(h.lens, h) for h in hypotheses])[:_CANDIDATES]
        raw = [_without_base(start) for h in starts if (start := self.fitter.start(detections, h)) is not None]
        fits = [self.fitter.fit_cells(candidate, prior) for candidate in raw[:_FITTED]]
        fits.sort(key=lambda fit: fit.cost)
        return _distinct([(c.scene.lens, c) for c in (*fits, *raw)])[:_CANDIDATES]

    def refine(
        self, frames: Frames, camera: Camera, start: CameraCandidate, *, focal_free: bool, centre_sigma_px: float = 0.0
    ) -> CameraEstimate:
        """Fit a camera to the contours of the robot at known joint angles, those of `start`, in frames (T, H, W, 3).

        Intrinsics are those of `camera`; the principal point has a standard deviation [px], 0 for a fixed one.

        Raises:
            UnmeasurableError: the images show no edges where the arm should be.
        """
        prior = Prior(
            lens=Lens(intrinsics=camera, X_CB=np.eye(4)),
            log_focal_sigma=LOG_FOCAL_SIGMA if focal_free else 0.0,
            centre_sigma_px=centre_sigma_px,
            joint_sigma_rad=JOINT_SIGMA_RAD,
        )
        images = self.fitter.images(frames, camera)
        scene, _ = self.fitter.fit_contours(start, images.take(start.rows), prior, COARSE)
        return self.fitter.finish(replace(start, scene=replace(scene, q=start.scene.q)), images, prior, len(frames))

    def _extend(self, candidate: CameraCandidate, detections: ArmDetections, search: ChainSearch) -> CameraCandidate:
        """Return a candidate with all frames that its camera explains."""
        return _without_base(self.fitter.extend(candidate, detections, search.explain(candidate.scene.lens)))


def usual_camera(width: int, height: int) -> Camera:
    """Return a centred camera of unknown place with a usual field of view along the longer side."""
    return centred_camera(width, height, focal_px(max(width, height), USUAL_FOV_DEG))


def _distinct(ranked: Sequence[tuple[Lens, _Ranked]], factor: float = 1.0) -> list[_Ranked]:
    """Return what belongs to cameras that see another arm than all before them; see `Lens.sees_same_arm`."""
    kept: list[tuple[Lens, _Ranked]] = []
    for lens, item in ranked:
        if not any(lens.sees_same_arm(other, factor) for other, _ in kept):
            kept.append((lens, item))
    return [item for _, item in kept]


def _rivals(arm: CameraCandidate, turns: Sequence[BaseTurn], gain: float) -> tuple[Rival, ...]:
    """Return the cameras of an arm with the base turned, granted the `gain` of a fit."""
    return tuple(
        Rival(camera=arm.scene.turned(turn.angle_rad).lens.to_camera(), share=turn.share + gain) for turn in turns
    )


def _without_base(candidate: CameraCandidate) -> CameraCandidate:
    """Return a candidate without the cells of the base link, which a wrong turn of the base puts elsewhere."""
    return replace(candidate, cells=candidate.cells.take(candidate.cells.part != RobotPart.LINK0))
