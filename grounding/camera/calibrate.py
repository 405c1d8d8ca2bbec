"""Calibration of a static camera from a video of the robot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.camera_motion import FeatureTracks, measure_camera_motion
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, BundleAdjustment, Observations, Prior, adjust
from kinebench_drake.grounding.camera.camera_estimate import GRIPPER_SIGMA_RAD, CameraEstimate, FittedCamera
from kinebench_drake.grounding.camera.candidate import CameraCandidate
from kinebench_drake.grounding.camera.detections import (
    MIN_FRAMES,
    ArmDetections,
    CalibrationCorrespondences,
    detect_all,
    track_all,
)
from kinebench_drake.grounding.camera.estimate import FRAMES, CameraEstimator
from kinebench_drake.grounding.camera.lens import (
    USUAL_FOV_DEG,
    Lens,
    centred_camera,
    focal_px,
    pixel_shapes,
    solve_pnp,
    with_focal,
)
from kinebench_drake.grounding.camera.links import LinkCalibrator, LinkEvidence
from kinebench_drake.grounding.camera.states import (
    RobotStates,
    make_posture_states,
    parse_posture,
    read_states,
)
from kinebench_drake.grounding.registration.arm_model import MIN_CELLS, ArmModel
from kinebench_drake.grounding.registration.solver import CAUCHY
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.tracker import CadTracker
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json
from kinebench_drake.io.progress import tell
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from kinebench_drake.models.panda.description import ARM, GRIPPER, GripperKind, RobotPart
from kinebench_drake.models.perception.network import load_network
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.segments import evenly, finite_rows

# Chosen by hand; checked by `python -m benchmarks calibration FOLDER`.
_FOCAL_LIMIT = 0.05
"""Relative standard deviation of the focal length that is an error."""
_POSITION_LIMIT_M = 0.05
"""Standard deviation of the camera's place that is an error [m]."""
_ROTATION_LIMIT_RAD = GRIPPER_SIGMA_RAD
"""Standard deviation of the camera's turn that is an error [rad]."""
_MISFIT_LIMIT_PX = 6.0
"""Median error of the gripper in a fit to cells that is an error [px of an image 384 px wide]."""
_INLIER_SHARE = 0.5
"""Least share of the cells that agree with a fit to cells."""
_WARNING_SHARE = 0.4
"""Share of these limits from which on there is a warning."""
_MIN_MOTION_M = 0.1
"""Distance between hand positions below which a video shows one posture [m]."""
_MIN_DEPTH_RATIO = 1.25
"""Ratio of farthest to nearest depth below which perspective hardly determines the focal length."""
_GROUPS = {"gripper": GRIPPER, "arm": ARM[1:], "base": ARM[:1]}
_FOV_DEG = (35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
"""Horizontal fields of view at which the search for the focal length starts [degrees]."""
_POSTURE_SIGMA_RAD = np.array([10.0, *[0.7] * 6])
"""Standard deviations of an initial posture [rad]; that of joint 1 is uninformative."""
_STARTS = 2
"""Initial lenses that are refined."""
_FIXED_SIGMA_RAD = 1e-3
"""Standard deviation of a posture that is known [rad]."""
RobotSource = Callable[[Frames, Camera], ArmDetections]
"""Detection of the robot in frames (T, H, W, 3) that were taken with approximately this camera."""
_DEFAULT_FRAMES = 24
_INLIER_SIGMAS = 4.0
"""Standard deviations within which a cell agrees with a fit."""
_CENTRE_SIGMA = 0.06
"""Standard deviation of an unknown principal point over the image's width."""
_OTHER_M = 0.03
"""Distance from the initial camera from which on the frames are measured again: the views depend on the camera [m]."""
_OTHER_RAD = float(np.deg2rad(5.0))
"""Angle to the initial camera from which on they are [rad]."""
_OTHER_ZOOM = 0.05
"""Logarithm of the ratio of focal lengths from which on they are."""


class CameraMotionError(UnmeasurableError):
    """The camera of a video moves."""


class CalibrationMethod(Enum):
    """Source of the robot's postures."""

    JOINTS = "joint angles of the frames"
    POSES = "poses of the gripper in the frames"
    POSTURE = "posture of one frame"
    ESTIMATE = "no postures"


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationBasis:
    """Prior information of a calibration."""

    method: CalibrationMethod
    source: str
    """Source of the postures."""
    focal_free: bool
    """True if the focal length was estimated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCalibration(FittedCamera):
    """Calibrated camera with its uncertainty."""

    basis: CalibrationBasis
    X_BP: Array
    """(T, PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; NaN where unknown."""
    residual_px: float
    """Of a fit to cells the root mean square of the reprojection error, weighted by the certainty of each cell; of one
    to contours the median distance from edges [px]."""
    inlier_share: float
    """Share of the cells within four standard deviations, or of the contour points on edges."""
    depth_m: tuple[float, float]
    """Depths of the nearest and farthest visible parts of the robot, 5th and 95th percentile [m]."""
    agreement: float | None = None
    """Share of the contours of hand and arm on image edges; None if the camera was fitted to cells alone."""
    links: LinkEvidence | None = None
    """What was estimated besides, if the camera was fitted to the links alone; None if to the hand, too."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""
    image: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))
    """(H, W, 3) middle one of the frames used; empty until it is set."""

    @property
    def part_px(self) -> dict[str, float]:
        """Median error [px] of the cells or contour points of gripper, arm and base; NaN without any."""
        errors = {name: self.bundle.error_px[np.isin(self.part, parts)] for name, parts in _GROUPS.items()}
        return {name: float(np.median(own)) if len(own) else float("nan") for name, own in errors.items()}

    @property
    def part_cells(self) -> dict[str, int]:
        """Number of cells or contour points of gripper, arm and base."""
        return {name: int(np.isin(self.part, parts).sum()) for name, parts in _GROUPS.items()}

    @property
    def motion_m(self) -> float:
        """Greatest distance between hand positions in the frames [m]."""
        hands_B = self.X_BP[:, RobotPart.HAND, :3, 3]
        return float(np.nanmax(np.linalg.norm(hands_B[:, None] - hands_B[None], axis=-1), initial=0.0))

    def drawn_parts(self, row: int) -> Array:
        """Return the frames (PARTS, 4, 4) in B [m] of the parts that were fitted in a frame used; NaN for others."""
        X_BP: Array = self.X_BP[row].copy()
        if self.links is not None:
            X_BP[list(GRIPPER)] = np.nan
        return X_BP

    @property
    def fitted_to(self) -> str:
        """Measurements of the fit: "cells" or "contours"."""
        return "cells" if self.agreement is None else "contours"

    def to_json(self) -> dict[str, Json]:
        """Serialize all results; the camera as in `camera.json`."""
        return {
            "camera": self.camera.to_json(),
            "method": self.basis.method.value,
            "source": self.basis.source,
            "frames": self.frames.tolist(),
            "focal_length": "estimated" if self.basis.focal_free else "fixed",
            "sigma": {
                "position_mm": 1e3 * self.position_sigma_m,
                "rotation_deg": float(np.rad2deg(self.rotation_sigma_rad)),
                "focal_percent": 100 * self.focal_sigma,
            },
            "fitted_to": self.fitted_to,
            "residual_px": self.residual_px,
            "part_median_px": {name: px if np.isfinite(px) else None for name, px in self.part_px.items()},
            "part_cells": dict(self.part_cells),
            "inlier_share": self.inlier_share,
            "agreement": self.agreement,
            "depth_m": list(self.depth_m),
            "hand_motion_m": self.motion_m,
            "links_alone": None if self.links is None else self.links.to_json(),
            "warnings": list(self.warnings),
        }


def format_lines(c: CameraCalibration) -> list[str]:
    """Format a calibration as lines of text."""
    camera = c.camera
    place = ", ".join(f"{1e3 * x:.0f}" for x in camera.X_BC[:3, 3])
    fov = np.rad2deg(2 * np.arctan(camera.width / 2 / camera.fx))
    sure = f" +- {100 * c.focal_sigma:.1f} %" if c.basis.focal_free else ", fixed"
    report = [
        f"from: {c.basis.source}; {len(c.frames)} frames, {len(c.part)} points of the robot's {c.fitted_to} "
        f"(gripper {c.part_cells['gripper']}, arm {c.part_cells['arm']}, base {c.part_cells['base']})",
        f"camera in the base frame: {place} mm, +- {1e3 * c.position_sigma_m:.0f} mm, "
        f"{np.rad2deg(c.rotation_sigma_rad):.2f} degrees",
        f"focal length: {camera.fx:.1f} px{sure} (field of view {fov:.1f} degrees across {camera.width} px)",
        f"residual: {c.residual_px:.2f} px {'rms' if c.agreement is None else 'median'}; medians "
        + ", ".join(f"{name} {px:.1f}" for name, px in c.part_px.items() if np.isfinite(px)),
    ]
    if c.agreement is not None:
        report.append(f"contours of {'hand and arm' if c.links is None else 'links'} on image edges: {c.agreement:.0%}")
    if c.links is not None:
        report += c.links.format_lines()
    report.append(
        f"depth of the robot: {c.depth_m[0]:.2f} to {c.depth_m[1]:.2f} m; the hand moves {1e3 * c.motion_m:.0f} mm"
    )
    return [*report, *(f"warning: {warning}" for warning in c.warnings)]


def require_determined(calibration: CameraCalibration) -> None:
    """Check that the camera is determined and consistent with the known postures.

    Raises:
        UnmeasurableError: the postures contradict the images, or the camera is not determined; the message names the
            quantity and the reason.
    """
    unit = calibration.camera.unit_px
    misfit = calibration.part_px["gripper"]
    agreement = calibration.agreement
    if calibration.links is not None:
        calibration.links.require_agreement(calibration.basis.source, agreement or 0.0)
    if agreement is not None and agreement < bounds.AGREEMENT:
        raise UnmeasurableError(
            f"{calibration.basis.source}: with no camera does the robot lie on the edges of the images "
            f"({agreement:.0%} of its contours do, at least {bounds.AGREEMENT:.0%} are needed): is it a Panda with the "
            "Franka hand, is the camera static and its lens free of distortion, and do joint angles belong to these "
            "frames, in radians?"
        )
    if agreement is None and (misfit > _MISFIT_LIMIT_PX * unit or calibration.inlier_share < _INLIER_SHARE):
        raise UnmeasurableError(
            f"{calibration.basis.source} contradicts the images: the gripper is {misfit:.1f} px off (median, at most "
            f"{_MISFIT_LIMIT_PX * unit:.1f}), {calibration.inlier_share:.0%} of the cells agree; do the angles "
            "belong to this video and the times of its frames, in radians? Is the lens free of distortion?"
        )
    if calibration.focal_sigma > _FOCAL_LIMIT:
        raise UnmeasurableError(
            f"the focal length is not determined ({calibration.focal_sigma:.1%} standard deviation, at most "
            f"{_FOCAL_LIMIT:.0%}): {_why(calibration)}; give $focal_px PX or $camera FILE, or a video in which "
            "the arm moves towards the camera"
        )
    if calibration.position_sigma_m > _POSITION_LIMIT_M or calibration.rotation_sigma_rad > _ROTATION_LIMIT_RAD:
        sigmas = (
            f"{1e3 * calibration.position_sigma_m:.0f} mm and {np.rad2deg(calibration.rotation_sigma_rad):.1f} degrees "
            f"standard deviation, at most {1e3 * _POSITION_LIMIT_M:.0f} mm and "
            f"{np.rad2deg(_ROTATION_LIMIT_RAD):.0f}"
        )
        raise UnmeasurableError(f"base_from_camera is not determined ({sigmas}): {_why(calibration)}")


def warnings_of(calibration: CameraCalibration) -> tuple[str, ...]:
    """Return warnings for the user, one line each."""
    warnings = []
    unit = calibration.camera.unit_px
    misfit = calibration.part_px["gripper"]
    if misfit > _WARNING_SHARE * _MISFIT_LIMIT_PX * unit:
        warnings.append(
            f"the gripper is {misfit:.1f} px off (median): the joint angles may be late or early, the joints badly "
            "calibrated, or the lens distorted"
        )
    if calibration.focal_sigma > _WARNING_SHARE * _FOCAL_LIMIT:
        warnings.append(f"the focal length is uncertain by {calibration.focal_sigma:.1%}: {_why(calibration)}")
    if (
        calibration.position_sigma_m > _WARNING_SHARE * _POSITION_LIMIT_M
        or calibration.rotation_sigma_rad > _WARNING_SHARE * _ROTATION_LIMIT_RAD
    ):
        warnings.append(
            f"base_from_camera is uncertain by {1e3 * calibration.position_sigma_m:.0f} mm and "
            f"{np.rad2deg(calibration.rotation_sigma_rad):.1f} degrees: {_why(calibration)}"
        )
    if calibration.basis.method is not CalibrationMethod.POSTURE and calibration.motion_m < _MIN_MOTION_M:
        warnings.append(
            f"the hand moves by {1e3 * calibration.motion_m:.0f} mm only, less than {1e3 * _MIN_MOTION_M:.0f}: "
            "errors that all frames have in common are not averaged out"
        )
    return tuple(warnings)


def _why(calibration: CameraCalibration) -> str:
    """Explain what the video lacks."""
    near, far = calibration.depth_m
    reasons = []
    if len(calibration.frames) == 1:
        reasons.append("one frame is used")
    elif calibration.motion_m < _MIN_MOTION_M:
        reasons.append(f"the hand moves by {1e3 * calibration.motion_m:.0f} mm only")
    if far < _MIN_DEPTH_RATIO * near:
        reasons.append(f"the visible parts of the robot are {near:.2f} to {far:.2f} m away, at nearly the same depth")
    if not reasons:
        reasons.append(f"{sum(calibration.part_cells.values())} cells show the robot, few of them with low uncertainty")
    return ", ".join(reasons)


@dataclass(frozen=True, slots=True, kw_only=True)
class LensSolution:
    """Lens fitted to cells of T frames."""

    bundle: BundleAdjustment
    """Fit; its joint angles are NaN where unknown."""
    cells: CalibrationCorrespondences
    X_BP: Array
    """(T, PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; NaN where unknown."""
    rows: NDArray[np.intp]
    """(T,) rows of the detections that were used."""


def solve(
    robot: ArmDetections, states: RobotStates, guess: Camera, model: ArmModel, *, focal_free: bool
) -> LensSolution:
    """Solve the lens that projects the robot to where the frames show it, with all known postures.

    Args:
        robot: robot in some frames.
        states: robot states in the same frames.
        guess: initial camera.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: too little of the robot is visible, or it contradicts the postures.
    """
    rows = np.flatnonzero(states.has_hand)
    focal = [focal_px(guess.width, fov) for fov in _FOV_DEG]
    cameras = [guess, *(with_focal(guess, fx) for fx in focal)] if focal_free else [guess]
    anchored = len(rows) == 1 and len(states.q) >= MIN_FRAMES
    free = focal_free and not anchored
    cells = robot.cells.of_frames(rows)
    solved = _solve_lens(cells, robot.finger_m[rows], states.take(rows), cameras, model, focal_free=free)
    if not anchored or robot.q is None or finite_rows(robot.q).sum() < MIN_FRAMES:
        return replace(solved, rows=rows)
    q = np.where(states.has_posture[:, None], states.q, robot.q)
    return _solve_lens_and_postures(robot, q, states, solved.bundle.scene.lens, model, focal_free=focal_free)


def _solve_lens(
    cells: CalibrationCorrespondences,
    opening_m: Array,
    states: RobotStates,
    cameras: Sequence[Camera],
    model: ArmModel,
    *,
    focal_free: bool,
) -> LensSolution:
    """Solve the lens where the posture, or at least the hand pose, is known in every frame, from initial `cameras`."""
    X_BP = states.part_poses(model)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, opening_m)
    cells = cells.take(np.flatnonzero(finite_rows(cells.locate(X_BP, finger_m))))
    _require_enough(cells)
    starts = _find_consensus(cells, cells.locate(X_BP, finger_m), cameras)[:_STARTS]
    if not starts:
        raise UnmeasurableError(
            f"none of the {len(cells)} cells of the robot agree with {states.source}: do the angles belong to this "
            "video, in the order of its frames, in radians?"
        )
    fits = [fit_cells(cells, lens, model, X_BP, finger_m, focal_free=focal_free) for lens in starts]
    bundle = min(fits, key=lambda fit: fit.cost)
    flip = _misread(cells, bundle, X_BP, finger_m)
    if flip.any():
        cells = cells.flip(flip)
        bundle = fit_cells(cells, bundle.scene.lens, model, X_BP, finger_m, focal_free=focal_free)
    scene = ArmScene(lens=bundle.scene.lens, q=states.q, finger_m=finger_m)
    return LensSolution(bundle=replace(bundle, scene=scene), cells=cells, X_BP=X_BP, rows=np.arange(len(X_BP)))


def _solve_lens_and_postures(
    robot: ArmDetections, q: Array, states: RobotStates, start: Lens, model: ArmModel, *, focal_free: bool
) -> LensSolution:
    """Solve lens and postures jointly, where postures are known in few frames.

    A rotation of the camera about the axis of joint 1 is equivalent to other postures: only the base link, and known
    postures, determine it.
    """
    rows = np.flatnonzero(finite_rows(q))
    cells = robot.cells.of_frames(rows).thin()
    _require_enough(cells)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, robot.finger_m)[rows]
    q_sigma = np.where(states.has_posture[rows, None], _FIXED_SIGMA_RAD, _POSTURE_SIGMA_RAD)
    q = q[rows]
    X_BP = model.poses(q)
    bundle = fit_cells(cells, start, model, X_BP, finger_m, focal_free=focal_free, q=q, q_sigma=q_sigma)
    return LensSolution(bundle=bundle, cells=cells, X_BP=model.poses(bundle.scene.q), rows=rows)


def fit_cells(
    cells: CalibrationCorrespondences,
    start: Lens,
    model: ArmModel,
    X_BP: Array,
    finger_m: Array,
    *,
    focal_free: bool,
    q: Array | None = None,
    q_sigma: Array | None = None,
) -> BundleAdjustment:
    """Fit a lens to cells, with postures and openings or at known ones; parts at rest count once in its information.

    Args:
        cells: cells of T frames.
        start: initial lens.
        model: link poses of the arm.
        X_BP: (T, PARTS, 4, 4) poses of the parts in B [m].
        finger_m: (T,) opening of each finger [m].
        focal_free: True to estimate the focal length.
        q: (T, 7) initial joint angles to be estimated, too [rad]; None to keep all parts where they are.
        q_sigma: (T, 7) their standard deviations [rad].
    """
    prior = Prior(lens=start, log_focal_sigma=np.inf if focal_free else 0.0)
    p_B = cells.locate(X_BP, finger_m)

    def adjusted(scene: ArmScene, weight: Array, steps: int = 20) -> BundleAdjustment:
        points = p_B if q is None else cells.locate(model.poses(scene.q), scene.finger_m)
        observed = replace(Observations.of_cells(cells, cells.sigma_px(scene.lens, points)), weight=weight)
        if q is None:
            observed = observed.at_rest(p_B)
        return adjust(observed, scene, prior, model, q=q, q_sigma=q_sigma, iterations=steps)

    scene = ArmScene(lens=start, q=np.zeros((len(X_BP), N_JOINTS)) if q is None else q, finger_m=finger_m)
    for _ in range(2):  # each with newly computed standard deviations of the cells
        scene = adjusted(scene, cells.weight).scene
    return adjusted(scene, cells.weight / cells.count_repeats(X_BP), 0)


def _find_consensus(cells: CalibrationCorrespondences, p_B: Array, cameras: Sequence[Camera]) -> list[Lens]:
    """Return initial lenses by RANSAC from the cells' points `p_B` (N, 3) [m], by decreasing number of inliers."""
    solutions = [(camera, solve_pnp(p_B, cells.uv_px, camera)) for camera in cameras]
    solved = [(camera, *solution) for camera, solution in solutions if solution is not None]
    return [Lens(intrinsics=camera, X_CB=X_CB) for camera, X_CB, _ in sorted(solved, key=lambda one: -one[2])]


def _require_enough(cells: CalibrationCorrespondences) -> None:
    """Check that enough of the robot is visible.

    Raises:
        UnmeasurableError: there are fewer than MIN_CELLS cells.
    """
    if len(cells) < MIN_CELLS:
        raise UnmeasurableError(
            f"{len(cells)} cells show a Panda over all frames, at least {MIN_CELLS} are needed: it is not in the "
            "images, or its appearance differs from that of the training data"
        )


def _misread(
    cells: CalibrationCorrespondences, bundle: BundleAdjustment, X_BP: Array, finger_m: Array
) -> NDArray[np.bool_]:
    """Return (T,) frames whose gripper cells fit better with the gripper rotated by 180 degrees about its axis."""
    lens = bundle.scene.lens
    turned = cells.flip(np.ones(len(X_BP), dtype=bool))
    other_px = np.linalg.norm(lens.project(turned.locate(X_BP, finger_m))[0] - cells.uv_px, axis=1)
    scale = CAUCHY * cells.sigma_px(lens, cells.locate(X_BP, finger_m))
    gain = np.log1p((bundle.error_px / scale) ** 2) - np.log1p((other_px / scale) ** 2)
    return np.asarray(np.bincount(cells.frame, weights=gain * cells.of_gripper, minlength=len(X_BP)) > 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig:
    """Video to calibrate and prior information."""

    video: Path
    joints: str | None = None
    """File of joint angles, one posture, or the name of a posture; None without either."""
    joints_frame: int = 0
    """Frame in which the robot is in that posture."""
    episode: str | None = None
    """Episode of the video in a file of several."""
    column: str | None = None
    """Array or column of joint angles in the file, if ambiguous."""
    frame_period_s: float | None = None
    """Time between two frames [s]; None for that of the video."""
    camera: Path | None = None
    """camera.json with the intrinsics; without joint angles its pose is the initial guess."""
    focal_px: float | None = None
    """Focal length of the video [px]; None to estimate it."""
    frames: int = _DEFAULT_FRAMES
    """Greatest number of frames used."""
    gripper: GripperKind = GripperKind.AUTO
    """Gripper of the robot; the camera is fitted to the links alone unless it is the Franka hand."""

    def __post_init__(self) -> None:
        """Check the options without reading files.

        Raises:
            UsageError: two options contradict each other.
        """
        if self.focal_px is not None and self.camera is not None:
            raise UsageError("$focal_px and $camera exclude each other: the camera file states the focal length")
        if self.joints is None and self.joints_frame:
            raise UsageError(f"$joints_frame {self.joints_frame}: there is no $joints, whose posture it would be")
        is_file = self.joints is not None and (Path(self.joints).exists() or parse_posture(self.joints) is None)
        if not is_file and (self.episode or self.column):
            raise UsageError("$episode and $column choose from a file of joint angles, and $joints names none")


class Calibrator:
    """Calibration of cameras from decoded videos; one instance serves any number of them."""

    def __init__(
        self,
        detected: RobotSource,
        tracked: RobotSource,
        cameras: CameraEstimator,
        links: Callable[[GripperKind], LinkCalibrator] = LinkCalibrator.load,
    ) -> None:
        """Set the sources of detections: `tracked` ones have postures where only one posture is known.

        `links` loads the calibrator for arms with another gripper.
        """
        self._detected = detected
        self._tracked = tracked
        self._cameras = cameras
        self._links = cache(links)
        self._model = ArmModel()

    @staticmethod
    def load() -> "Calibrator":
        """Return a calibrator with the networks of the tracker.

        Raises:
            SetupError: weights, meshes or native libraries are missing.
        """
        dense = NetworkEstimator(load_network())
        return Calibrator(partial(detect_all, dense), partial(track_all, CadTracker(dense)), CameraEstimator(dense))

    def calibrate(
        self,
        frames: Frames,
        states: RobotStates | None,
        guess: Camera,
        *,
        focal_free: bool,
        centre_free: bool = False,
        most: int = _DEFAULT_FRAMES,
        gripper: GripperKind = GripperKind.AUTO,
        rows: NDArray[np.intp] | None = None,
    ) -> CameraCalibration:
        """Calibrate the camera of frames (T, H, W, 3).

        Args:
            frames: images.
            states: robot states in these frames; None to estimate the camera without any.
            guess: initial camera.
            focal_free: True to estimate the focal length.
            centre_free: True if principal point and shape of the pixels are not known exactly.
            most: greatest number of frames used.
            gripper: gripper of the robot; at AUTO the links alone are tried where the Franka hand gives no camera.
            rows: (N,) numbers of frames of known state that the fit may use; None: any. The others confirm it.

        Raises:
            UsageError: the gripper needs joint angles of the frames.
            UnmeasurableError: the camera moves, or the video does not determine it.
        """
        allowed = states if states is None or rows is None else states.only(rows)
        with_hand = partial(self._fit_robot, frames, allowed, guess, focal_free, centre_free, most)
        if gripper is GripperKind.FRANKA or (gripper is GripperKind.AUTO and not _has_joints(states)):
            return with_hand()
        if states is None or not _has_joints(states):
            raise UsageError(f"$gripper {gripper.value} needs the joint angles of all frames: give $joints FILE")
        if gripper is GripperKind.AUTO:
            try:
                return with_hand()
            except CameraMotionError:
                raise
            except UnmeasurableError:
                tell("no camera agrees with the Franka hand: trying the links alone")
            gripper = GripperKind.ROBOTIQ_2F85
        return self._fit_links(frames, states, guess, focal_free, centre_free, most, gripper, rows)

    def compare_links(self, frames: Frames, camera: Camera, postures: Sequence[Array]) -> Array:
        """Return the shares (K, T) of the contours of the moving links on image edges in K postures (T, 7) [rad]."""
        return self._links(GripperKind.NONE).compare(frames, Lens.of_camera(camera), postures)

    def _fit_robot(
        self,
        frames: Frames,
        states: RobotStates | None,
        guess: Camera,
        focal_free: bool,
        centre_free: bool,
        most: int,
    ) -> CameraCalibration:
        """Calibrate by links and Franka hand; arguments and errors as of `calibrate`."""
        chosen = evenly(len(frames), min(most, FRAMES)) if states is None else _chosen(states, most)
        method = choose_method(states)
        source = self._tracked if method is CalibrationMethod.POSTURE else self._detected
        images = frames[chosen]
        robot = source(images, guess)
        shift = _camera_shift(images, robot.robot, guess)
        basis = CalibrationBasis(
            method=method, source="nothing" if states is None else states.source, focal_free=focal_free
        )
        if states is None:
            estimate = self._cameras.estimate(frames, guess, focal_free=focal_free)
            if estimate.doubt is not None:
                raise UnmeasurableError(
                    f"base_from_camera is not determined without joint angles: {estimate.doubt}; give $joints FILE, "
                    "or the posture of one frame ($joints q1,...,q7)"
                )
            calibration = describe_estimate(estimate, self._model, basis)
        else:
            solved = solve(robot, states.take(chosen[robot.rows]), guess, self._model, focal_free=focal_free)
            camera = solved.bundle.scene.lens.to_camera()
            if _is_other(camera, guess):
                robot = source(images, camera)
                solved = solve(robot, states.take(chosen[robot.rows]), camera, self._model, focal_free=focal_free)
            if method is CalibrationMethod.JOINTS:
                centre_sigma_px = _CENTRE_SIGMA * guess.width if centre_free else 0.0
                used = images[robot.rows]
                start = CameraCandidate(
                    scene=solved.bundle.scene,
                    rows=solved.rows,
                    cells=solved.cells,
                    costs=np.zeros(len(solved.rows)),
                    cost=0.0,
                )
                estimate = self._cameras.refine(
                    used, guess, start, focal_free=focal_free, centre_sigma_px=centre_sigma_px
                )
                calibration = describe_estimate(estimate, self._model, basis)
            else:
                calibration = describe(solved, basis)
            calibration = replace(calibration, frames=chosen[robot.rows[calibration.frames]])
            require_determined(calibration)
        image = frames[calibration.frames[len(calibration.frames) // 2]]
        return replace(calibration, warnings=(*shift, *warnings_of(calibration)), image=image)

    def _fit_links(
        self,
        frames: Frames,
        states: RobotStates,
        guess: Camera,
        focal_free: bool,
        centre_free: bool,
        most: int,
        gripper: GripperKind,
        rows: NDArray[np.intp] | None,
    ) -> CameraCalibration:
        """Calibrate by the links alone; arguments and errors as of `calibrate`."""
        links = self._links(gripper)
        detected = links.detect(frames, states, guess, focal_free=focal_free, most=most, allowed=rows)
        shift = _camera_shift(frames[detected[0].rows], detected[0].robot, guess)
        estimate, evidence = links.solve(
            detected,
            frames,
            states,
            guess,
            focal_free=focal_free,
            shapes=pixel_shapes(guess.width, guess.height) if centre_free else (guess.fy / guess.fx,),
            centre_sigma_px=_CENTRE_SIGMA * guess.width if centre_free else 0.0,
        )
        basis = CalibrationBasis(method=CalibrationMethod.JOINTS, source=states.source, focal_free=focal_free)
        calibration = replace(describe_estimate(estimate, self._model, basis), links=evidence)
        require_determined(calibration)
        image = frames[estimate.frames[len(estimate.frames) // 2]]
        return replace(calibration, warnings=(*shift, *warnings_of(calibration)), image=image)


def calibrate(config: CalibrationConfig, calibrator: Calibrator | None = None) -> CameraCalibration:
    """Calibrate the camera of a video.

    Args:
        config: video and prior information.
        calibrator: with the tracker's networks if None.

    Raises:
        UsageError: an option cannot be used.
        InputError: the video or the joint angles are invalid, or inconsistent with each other.
        UnmeasurableError: the camera moves, or the video does not determine it.
        SetupError: weights, meshes or native libraries are missing.
    """
    intrinsics = None if config.camera is None else load_camera(config.camera).camera
    try:
        video = read_video(config.video)
        video.require_measurable()
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{config.video.name}: {error}") from None
    return (calibrator or Calibrator.load()).calibrate(
        video.frames,
        _states(config, video, ArmModel()),
        _guess(config, intrinsics, video.width, video.height),
        focal_free=config.camera is None and config.focal_px is None,
        centre_free=config.camera is None,
        most=config.frames,
        gripper=config.gripper,
    )


def describe(solution: LensSolution, basis: CalibrationBasis) -> CameraCalibration:
    """Return the calibration of a camera that was fitted to cells."""
    bundle = solution.bundle
    cells = solution.cells
    p_B = cells.locate(solution.X_BP, bundle.scene.finger_m)
    lens = bundle.scene.lens
    error_px = bundle.error_px
    sigma_px = cells.sigma_px(lens, p_B)
    inlier = error_px <= _INLIER_SIGMAS * sigma_px
    sure = np.where(inlier, cells.weight / sigma_px**2, 0.0)
    z = lens.project(p_B)[1][inlier]
    near, far = np.quantile(z, [0.05, 0.95]) if len(z) else (np.nan, np.nan)
    return CameraCalibration(
        bundle=bundle,
        frames=solution.rows,
        part=cells.part,
        basis=basis,
        X_BP=solution.X_BP,
        residual_px=float(np.sqrt((sure * error_px**2).sum() / max(sure.sum(), 1e-12))),
        inlier_share=float(inlier.mean()),
        depth_m=(float(near), float(far)),
    )


def describe_estimate(estimate: CameraEstimate, model: ArmModel, basis: CalibrationBasis) -> CameraCalibration:
    """Return the calibration of a camera that was fitted to contours."""
    X_BP = model.poses(estimate.scene.q)
    z = (estimate.scene.lens.X_CB @ X_BP)[:, np.unique(estimate.part), 2, 3]
    near, far = np.quantile(z, [0.05, 0.95])
    return CameraCalibration(
        **{f.name: getattr(estimate, f.name) for f in fields(FittedCamera)},
        basis=basis,
        X_BP=X_BP,
        residual_px=estimate.residual_px,
        inlier_share=estimate.agreement,
        depth_m=(float(near), float(far)),
        agreement=estimate.agreement,
    )


def _states(config: CalibrationConfig, video: Video, model: ArmModel) -> RobotStates | None:
    if config.joints is None:
        return None
    if not Path(config.joints).exists():
        return make_posture_states(config.joints, config.joints_frame, len(video.frames), model)
    return read_states(
        Path(config.joints), config.episode, config.column, frame_times(video, config.frame_period_s), model
    )


def frame_times(video: Video, period_s: float | None) -> Array:
    """Return the times (T,) of the frames [s]; NaN if neither the user nor the video states them."""
    if period_s is None and video.stamps_s is not None:
        return video.stamps_s
    period = period_s or (1.0 / video.fps if video.fps else np.nan)
    return np.asarray(period * np.arange(len(video.frames)), dtype=np.float64)


def _guess(config: CalibrationConfig, intrinsics: Camera | None, width: int, height: int) -> Camera:
    """Return the initial camera: the pose of the benchmark camera unless a camera is provided."""
    focal = config.focal_px or focal_px(max(width, height), USUAL_FOV_DEG)
    return centred_camera(width, height, focal) if intrinsics is None else intrinsics.resized(width, height)


def _chosen(states: RobotStates, most: int) -> NDArray[np.intp]:
    """Return the frames to use: spread over those of known hand pose if there are two or more, else over all."""
    rows = np.flatnonzero(states.has_hand)
    if len(rows) > 1:
        return np.asarray(rows[evenly(len(rows), most)])
    others = np.setdiff1d(np.arange(len(states.q)), rows)
    others = others[evenly(len(others), min(most, FRAMES) - len(rows))]
    return np.asarray(np.union1d(rows, others), dtype=np.intp)


def _camera_shift(frames: Frames, robot: NDArray[np.bool_], camera: Camera) -> tuple[str, ...]:
    """Return warnings about camera motion.

    Raises:
        CameraMotionError: the camera moves.
    """
    if len(frames) < 2:
        return ()
    moved_px = measure_camera_motion(FeatureTracks(frames), robot, camera).largest_px
    unit = camera.unit_px
    if moved_px is None:
        return ("it is unknown whether the camera is static: the background has too few features",)
    if moved_px > bounds.COMPENSABLE_PX * unit:
        raise CameraMotionError(
            f"the camera moves: the background shifts by {moved_px:.0f} px, at most {bounds.COMPENSABLE_PX * unit:.0f}"
            "; calibrate with a part of the video in which it stands still"
        )
    if moved_px > bounds.MOVING_PX * unit:
        return (f"the background shifts by {moved_px:.1f} px: the camera is not quite static",)
    return ()


def _is_other(camera: Camera, guess: Camera) -> bool:
    """Return whether a camera differs much from another one."""
    distance, angle = pose_difference(camera.X_BC, guess.X_BC)
    return bool(distance > _OTHER_M or angle > _OTHER_RAD or abs(np.log(camera.fx / guess.fx)) > _OTHER_ZOOM)


def _has_joints(states: RobotStates | None) -> bool:
    return choose_method(states) is CalibrationMethod.JOINTS


def choose_method(states: RobotStates | None) -> CalibrationMethod:
    """Return the method that the states allow."""
    if states is None:
        return CalibrationMethod.ESTIMATE
    if not np.isfinite(states.q).any():
        return CalibrationMethod.POSES
    return CalibrationMethod.POSTURE if states.has_hand.sum() == 1 else CalibrationMethod.JOINTS
