"""Checks of a camera against the arm: agreement with it, and other cameras that explain the arm better.

`check_named` decides whether a named camera is rejected.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.camera import CONFIRMED, Camera
from kinebench_drake.errors import UsageError, count_noun
from kinebench_drake.geometry import invert, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, Prior
from kinebench_drake.grounding.camera.candidate import (
    COARSE,
    LOG_FOCAL_SIGMA,
    MIDDLE,
    CameraCandidate,
    CandidateFitter,
)
from kinebench_drake.grounding.camera.detections import MIN_FRAMES, ArmDetections, find_robot
from kinebench_drake.grounding.camera.evidence import (
    BASE_UNKNOWN,
    BetterReading,
    CameraChoice,
    CameraContradiction,
    PictureReading,
)
from kinebench_drake.grounding.camera.hypotheses import ChainSearch, Hypothesis
from kinebench_drake.grounding.camera.lens import Lens, with_focal
from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.grounding.registration.fit import UNSEEN_FINGER_M
from kinebench_drake.grounding.tracking.localization import PART_CELLS
from kinebench_drake.grounding.tracking.view import DenseEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.progress import tell
from kinebench_drake.models.panda.description import GripperKind, RobotPart, hand_from_tcp
from kinebench_drake.segments import evenly, finite_rows
from kinebench_drake.track import GripperTrack

# Checked on right and wrong cameras, of which no wrong one may be accepted:
# `python -m benchmarks cameras FOLDER --out OUT --presented plain,named,mirrored,short_focal,long_focal`.
SURE_AGREEMENT = 0.68
"""Agreement from which on no other reading of the picture is tried, not even a mirrored one."""
_CONTRADICTING = 0.5
"""Least agreement with another camera that contradicts the assumed one."""
CLEARLY = 0.1
"""Least lead of the agreement with another camera or reading that contradicts the assumed one."""
LARGE_M = 0.03
"""Displacement of the gripper by the other camera from which on there is no verdict [m]."""
_LARGE_RAD = float(np.deg2rad(5.0))
"""The same of its rotation [rad]."""
_LEAST_EXPLAINED = 0.75
"""Least share of the frames with the robot that another lens explains."""
SEARCHED = 8
"""Frames that those are chosen from that check a camera."""
_AGREEMENT_FRAMES = 25
"""Frames whose mean is the agreement of a track: the median of 5 differs by up to 0.12 between number formats."""
_LIKELY = (PictureReading.MIRRORED, PictureReading.CROPPED)
"""Readings that a camera in the plane of symmetry, or a narrow margin, hides."""
_SCREENED = 3
"""Frames that tell which readings and lenses are fitted."""
_FITTED_READINGS = 2
_UPRIGHT_SHARE = 0.3
"""Agreement of unfitted postures from which on a picture is upright: turned ones have 0.16 at most, right ones of the
benchmark 0.45 at least."""
_NOT_UPRIGHT = (
    PictureReading.UPSIDE_DOWN,
    PictureReading.ROWS_REVERSED,
    PictureReading.TURNED_LEFT,
    PictureReading.TURNED_RIGHT,
)
_LENS_SHARE = 0.85
"""Share of the agreement of unfitted postures with a camera from which on another lens is fitted: next to right cameras
other focal lengths have 0.75 of it at most, crops 0.81, and crops of cropped pictures 0.92 at least."""
_CROP_ZOOMS = (1.1, 1.25, 1.45)
"""Focal lengths of cropped pictures over that of the camera."""
_CROP_PLACES = np.array([[0.0, 0.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
"""Places of a cropped picture in the whole one: its middle and its corners."""
_CROP_LOG_SIGMA = 0.15
_CROP_CENTRE_SIGMA = 0.1
"""Standard deviations of the logarithm of the focal length of a cropped picture, and of its principal point over its
width."""
_ZOOMS = (0.63, 0.72, 0.85, 1.0, 1.2, 1.4, 1.6)
"""Focal lengths over that of a camera in doubt."""
_FITTED = 3
"""Other lenses that are fitted to contours."""
_PASSES = (*COARSE, *MIDDLE[1:])


@dataclass(frozen=True, slots=True)
class CameraChecker:
    """Checks of cameras, each by frames (T, H, W, 3) RGB and their camera; one instance serves any number of videos."""

    _estimator: DenseEstimator
    _fitter: CandidateFitter

    def track_agreement(self, frames: Frames, camera: Camera, result: PipelineResult) -> float | None:
        """Return the share of the contours of hand and arm on image edges in the postures of a track; None without any.

        Mean over frames. Of a moving camera those before it moves count; contours of other hands than Franka's do not.
        """
        q = result.arm_q
        track = result.track
        path = result.camera_path
        if not len(q):
            return None
        fitted = np.flatnonzero(
            finite_rows(q) & track.tracked & (True if path is None else path.px <= bounds.FIXED_PX * camera.unit_px)
        )
        if not len(fitted):
            return None
        chosen = fitted[evenly(len(fitted), _AGREEMENT_FRAMES)]
        finger_m = np.nan_to_num(track.finger_width_m[chosen] / 2, nan=UNSEEN_FINGER_M)
        scene = ArmScene(lens=Lens.of_camera(camera), q=q[chosen], finger_m=finger_m)
        images = self._fitter.images(frames[chosen], camera)
        if result.gripper is not GripperKind.FRANKA:
            images = images.without(RobotPart.HAND)
        return float(images.agreement(scene).mean())

    def reaches(self, track: GripperTrack) -> bool:
        """Return whether the arm can hold the hand at its pose in any tracked frame; True without such frames."""
        model = self._fitter.model
        X_BH = track.X_BG[track.tracked] @ invert(hand_from_tcp())
        return not len(X_BH) or any(model.within_limits(model.postures(X)).any() for X in X_BH)

    def find_reading(
        self, frames: Frames, camera: Camera, least: float, readings: tuple[PictureReading, ...]
    ) -> BetterReading | None:
        """Return the reading of picture or camera with which the arm agrees clearly better; None if there is none.

        It has to reach the agreement `least`, besides being better than frames and camera as they are. Only readings
        that lead before any fit, in a few frames, are fitted.
        """
        leading = self._leading_readings(frames, camera, readings)
        frames = frames[evenly(len(frames), SEARCHED)]
        fits = [self._fit_reading(reading, frames, camera) for reading in leading]
        best = max((fit for fit in fits if fit is not None), key=lambda fit: fit.better, default=None)
        if best is None or best.better < least:
            return None
        own = self._agreement(self.detect(frames, camera), frames, camera)
        return replace(best, agreement=own) if best.better >= own + CLEARLY else None

    def _leading_readings(
        self, frames: Frames, camera: Camera, readings: tuple[PictureReading, ...]
    ) -> list[PictureReading]:
        """Return the readings under which unfitted postures agree better with a few frames than as they are.

        The best ones first, and no more than are fitted.
        """
        few = frames[evenly(len(frames), _SCREENED)]
        unread = self._find_in_all(few, camera)
        own = self._screen(unread, few, [camera])
        shares: dict[PictureReading, float] = {}
        for reading in readings:
            if reading is PictureReading.CROPPED:
                shares[reading] = self._screen(unread, few, [prior.lens.intrinsics for prior in _crops(camera)])
            if reading is PictureReading.CROPPED or (own >= _UPRIGHT_SHARE and reading in _NOT_UPRIGHT):
                continue
            picture = reading.frames(few)
            try:
                lens = reading.camera(camera).resized(picture.shape[2], picture.shape[1])
            except UsageError:  # a picture that is not square, on its side
                continue
            turned = unread if picture is few else self._find_in_all(picture, lens)
            shares[reading] = self._screen(turned, picture, [lens])
        if PictureReading.CROPPED in shares:  # a crop may lie between those tried
            shares[PictureReading.CROPPED] /= _LENS_SHARE
        leading = sorted((reading for reading in shares if shares[reading] > own), key=lambda reading: -shares[reading])
        return leading[:_FITTED_READINGS]

    def _find_in_all(self, few: Frames, camera: Camera) -> ArmDetections | None:
        """Return the robot in all of a few frames (T, H, W, 3); None if none shows a hand."""
        return find_robot(self._estimator, few, camera, len(few), searched=len(few))

    def _screen(self, detections: ArmDetections | None, frames: Frames, cameras: Sequence[Camera]) -> float:
        """Return the mean agreement of unfitted postures with frames, of the camera that explains the cells best.

        Frames without the robot, or with one that is not explained, count as 0.
        """
        if detections is None:
            return 0.0
        search = ChainSearch(detections.cells, detections.finger_m, self._fitter.model)
        best = min(
            (search.explain(Lens.of_camera(camera)) for camera in cameras), key=lambda hypothesis: hypothesis.cost
        )
        rows = finite_rows(best.q)
        if not rows.any():
            return 0.0
        scene = ArmScene(lens=best.lens, q=best.q[rows], finger_m=detections.finger_m[rows])
        images = self._fitter.images(frames[detections.rows[rows]], best.lens.intrinsics)
        return float(images.agreement(scene).sum()) / len(frames)

    def _fit_reading(self, reading: PictureReading, frames: Frames, camera: Camera) -> BetterReading | None:
        """Return a reading fitted to contours; None if no arm is seen.

        The agreement of the picture as it is, which a fit of its own gives, is still 0.
        """
        if reading is not PictureReading.CROPPED:
            picture = reading.frames(frames)
            lens = reading.camera(camera).resized(picture.shape[2], picture.shape[1])
            better = self._agreement(self.detect(picture, lens), picture, lens)
            return BetterReading(reading=reading, agreement=0.0, better=better, camera=lens)
        detections = self.detect(frames, camera)
        if detections is None:
            return None
        # A crop is a camera at the same place whose picture is a part of that of `camera`.
        crop = self._fit_best(detections, frames[detections.rows], [(prior.lens, prior) for prior in _crops(camera)])
        if crop is None:
            return None
        camera = crop.scene.lens.to_camera()
        return BetterReading(reading=reading, agreement=0.0, better=crop.agreement, camera=camera)

    def detect(
        self, frames: Frames, camera: Camera, used: int = bounds.SAMPLED_FRAMES, searched: int = SEARCHED
    ) -> ArmDetections | None:
        """Return the robot in at most `used` of the frames `searched`; None if too few show hand and arm.

        Of the camera only the size matters, and the focal length a little.
        """
        detections = find_robot(self._estimator, frames, camera, used, searched=searched)
        return None if detections is None or len(detections.rows) < MIN_FRAMES else detections

    def _agreement(self, detections: ArmDetections | None, frames: Frames, camera: Camera) -> float:
        """Return the agreement of the arm that is detected in frames (T, H, W, 3) with their camera; 0 without any."""
        if detections is None:
            return 0.0
        fixed = self.fit_postures(detections, frames, self.explain(detections, camera))
        return 0.0 if fixed is None else fixed.agreement

    def _fit_best(
        self, detections: ArmDetections, frames: Frames, trials: Sequence[tuple[Lens, Prior]], least: float = 0.0
    ) -> CameraCandidate | None:
        """Return the lens that agrees best with the contours, of those that explain the cells best; None without any.

        `trials` are initial lenses with their priors; each has to explain `least` of the frames detected.
        """
        images = self._fitter.images(frames, trials[0][0].intrinsics)
        search = ChainSearch(detections.cells, detections.finger_m, self._fitter.model)
        starts = [(self._fitter.start(detections, search.explain(lens)), prior) for lens, prior in trials]
        likely = [(start, prior) for start, prior in starts if start is not None and len(start.rows) >= least]
        likely = sorted(likely, key=lambda trial: trial[0].cost)[:_FITTED]
        fits = [self._fitter.compare(start, images, prior, len(start.rows), _PASSES) for start, prior in likely]
        return max(fits, key=lambda fit: fit.agreement, default=None)

    def count_hands(self, frames: Frames, camera: Camera) -> tuple[int, int]:
        """Return in how many of a few frames a hand is seen, and how many were searched.

        Only the size of the camera matters, and its focal length a little.
        """
        detections = find_robot(self._estimator, frames, camera, SEARCHED, searched=SEARCHED)
        if detections is None:
            return 0, min(SEARCHED, len(frames))
        cells_of_hand = np.bincount(detections.cells.frame[detections.cells.part == RobotPart.HAND])
        return int((cells_of_hand >= PART_CELLS).sum()), min(SEARCHED, len(frames))

    def find_contradiction(self, frames: Frames, camera: Camera) -> CameraContradiction | None:
        """Return another camera under which the arm agrees clearly better with the images; None if there is none.

        Focal lengths within a factor of 1.6 are tried at the place of the camera, and both are then fitted. The arm has
        to agree with the result, in all frames that show it. Nothing is fitted where no other focal length comes near
        in a few frames.
        """
        lenses = [with_focal(camera, zoom * camera.fx) for zoom in _ZOOMS]
        few = frames[evenly(len(frames), _SCREENED)]
        detected = self._find_in_all(few, camera)
        least = _LENS_SHARE * self._screen(detected, few, [camera])
        if all(self._screen(detected, few, [lens]) < least for lens in lenses if lens.fx != camera.fx):
            return None
        detections = self.detect(frames, camera, bounds.SAMPLED_FRAMES + 1, 2 * SEARCHED)
        if detections is None:
            return None
        fixed = self.fit_postures(detections, frames, self.explain(detections, camera))
        # Where no posture explains the hand, its detection is wrong, which says nothing about the camera.
        if fixed is None or fixed.agreement >= CONFIRMED:
            return None
        own = Lens.of_camera(camera)
        prior = Prior(lens=own, log_focal_sigma=LOG_FOCAL_SIGMA)
        trials = [(replace(own, intrinsics=lens), prior) for lens in lenses]
        best = self._fit_best(detections, frames[detections.rows], trials, _LEAST_EXPLAINED * len(detections.rows))
        if best is None or best.agreement < max(_CONTRADICTING, fixed.agreement + CLEARLY):
            return None
        X_CB = best.scene.lens.X_CB
        X_CG = X_CB @ self._fitter.model.poses(best.scene.q)[:, RobotPart.HAND] @ hand_from_tcp()
        # What the assumed camera makes of the pose of the gripper that its focal length gives.
        zoom = camera.fx / best.scene.lens.intrinsics.fx
        X_assumed = X_CG.copy()
        X_assumed[:, :3, 3] *= zoom
        moved_m, turned_rad = pose_difference(camera.X_BC @ X_assumed, invert(X_CB) @ X_CG)
        return CameraContradiction(
            agreement=fixed.agreement,
            better=best.agreement,
            focal_ratio=zoom,
            gripper_m=float(np.median(moved_m)),
            gripper_rad=float(np.median(turned_rad)),
        )

    def explain(self, detections: ArmDetections, camera: Camera) -> Hypothesis:
        """Return the postures by which a camera explains the cells of a robot that is detected."""
        search = ChainSearch(detections.cells, detections.finger_m, self._fitter.model)
        return search.explain(Lens.of_camera(camera))

    def fit_postures(self, detections: ArmDetections, frames: Frames, hypothesis: Hypothesis) -> CameraCandidate | None:
        """Return the postures of a hypothesis fitted to contours in frames (T, H, W, 3), its camera kept.

        None if it explains too few of the frames in which the robot is detected.
        """
        start = self._fitter.start(detections, hypothesis)
        lens = hypothesis.lens
        if start is None:
            return None
        images = self._fitter.images(frames[detections.rows[start.rows]], lens.intrinsics)
        return self._fitter.fit(start, images, Prior(lens=lens, log_focal_sigma=0.0, place_free=False), _PASSES)

    def base_agreement(self, frames: Frames, fit: CameraCandidate) -> float:
        """Return the share of the base link's contours on image edges in the frames (T, H, W, 3) of a fit; 0 unseen."""
        return self._fitter.images(frames, fit.scene.lens.intrinsics).base_share(fit.scene)

    def freed_agreement(self, frames: Frames, fit: CameraCandidate) -> float:
        """Return the agreement after a fit of the place of the camera as well, in the frames (T, H, W, 3) of a fit."""
        lens = fit.scene.lens
        images = self._fitter.images(frames, lens.intrinsics)
        return self._fitter.fit(fit, images, Prior(lens=lens, log_focal_sigma=0.0), MIDDLE).agreement


def _crops(camera: Camera) -> Iterator[Prior]:
    """Yield priors of cameras at the same place whose picture is a part of that of `camera`."""
    for zoom in _CROP_ZOOMS:
        margin = 0.5 * (zoom - 1.0) * np.array([camera.width, camera.height])
        for place in _CROP_PLACES:
            cx, cy = (np.array([camera.cx, camera.cy]) + place * margin).tolist()
            yield Prior(
                lens=Lens.of_camera(replace(with_focal(camera, zoom * camera.fx), cx=cx, cy=cy)),
                log_focal_sigma=_CROP_LOG_SIGMA,
                centre_sigma_px=_CROP_CENTRE_SIGMA * camera.width,
                place_free=False,
            )


def find_reading(
    frames: Frames, camera: Camera, agreement: float | None, checker: CameraChecker
) -> BetterReading | None:
    """Return a reading of picture or matrix that agrees clearly better than the track does; None if there is none.

    Where the arm confirms the camera only those are tried that a camera in the plane of symmetry, or a narrow margin,
    hides. `agreement` is that of the track with `camera` in frames (T, H, W, 3); None if it has no posture.
    """
    if (agreement or 0.0) >= SURE_AGREEMENT:
        return None
    tell("the arm agrees little with the camera: trying other readings of the picture")
    readings = _LIKELY if (agreement or 0.0) >= CONFIRMED else tuple(PictureReading)
    return checker.find_reading(frames, camera, max(CONFIRMED, agreement or 0.0), readings)


def check_named(
    choice: CameraChoice, frames: Frames, camera: Camera, result: PipelineResult, checker: CameraChecker
) -> CameraChoice:
    """Check a named camera, and the track with it in frames (T, H, W, 3), against the arm.

    If the contours of hand and arm, in the postures of the track, lie on edges of the image, the camera stays, unless
    the mirrored picture agrees clearly better. Otherwise other readings and other cameras are tried. One that explains
    the arm clearly better and puts the gripper elsewhere leaves the base frame unknown, and so does a low agreement.
    Where no posture could agree, as the arm reaches the hand in no tracked frame, the base frame is unknown as well.
    """
    agreement = checker.track_agreement(frames, camera, result)
    choice = replace(choice, agreement=agreement)
    if result.camera_path is not None:  # other readings and cameras are sought in pictures of one camera alone
        return replace(choice, reason=_explain_disagreement(agreement, result, checker))
    reading = find_reading(frames, camera, agreement, checker)
    if reading is not None:
        return replace(choice, better_reading=reading, reason=f"{BASE_UNKNOWN}: {reading.describe()}")
    if agreement is not None and agreement >= CONFIRMED:
        return choice
    tell("the arm does not confirm the camera: searching for another focal length")
    is_franka = result.gripper is GripperKind.FRANKA
    other = checker.find_contradiction(frames, camera) if is_franka else None
    reason = None
    if other is not None and (other.gripper_m > LARGE_M or other.gripper_rad > _LARGE_RAD):
        reason = f"{BASE_UNKNOWN}: {other.describe()}"
    elif other is None:
        reason = _explain_disagreement(agreement, result, checker)
    return replace(choice, contradiction=other, reason=reason)


def _explain_disagreement(agreement: float | None, result: PipelineResult, checker: CameraChecker) -> str | None:
    """Return why a camera that no other explains better gives no base frame; None if it does."""
    if agreement is None:
        if not checker.reaches(result.track):
            return _describe_reach(result.track)
        is_unseen = result.arm_consistency_px is None or not result.has_pose.any()
        if is_unseen or result.camera_path is not None:  # nothing could agree or disagree
            return None
        return (
            f"{BASE_UNKNOWN}: the arm contradicts the camera of the input: it is seen, but agrees with the "
            "hand in no tracked frame"
        )
    if agreement >= bounds.AGREEMENT:
        return None
    return (
        f"{BASE_UNKNOWN}: the arm contradicts the camera of the input: {agreement:.0%} of its contours lie "
        f"on image edges, at least {bounds.AGREEMENT:.0%} are needed"
    )


def _describe_reach(track: GripperTrack) -> str:
    """Describe a camera that puts the hand out of reach in every tracked frame."""
    distance_m = float(np.median(np.linalg.norm(track.X_BG[track.tracked, :3, 3], axis=1)))
    frames = count_noun(int(track.tracked.sum()), "tracked frame")
    return (
        "the base frame is unknown: no arm agrees with the camera of the input, which puts the hand "
        f"{distance_m:.2f} m from the robot's base, where no posture holds it in any of {frames}; "
        "base_from_camera has to be in metres and in the frame of the robot's base, not of the world"
    )
