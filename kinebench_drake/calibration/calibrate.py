"""Calibration of a static camera from a video of the robot."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.calibration.bundle import ArmScene
from kinebench_drake.calibration.camera_estimate import CameraEstimate
from kinebench_drake.calibration.candidate import Candidate
from kinebench_drake.calibration.correspondences import LensView, NetworkViewEstimator, ViewEstimator
from kinebench_drake.calibration.detections import DetectedViewEstimator
from kinebench_drake.calibration.estimate import CameraEstimator
from kinebench_drake.calibration.fit import Lens, with_focal
from kinebench_drake.calibration.observability import require_determined, warnings_of
from kinebench_drake.calibration.result import CalibrationMethod, CameraCalibration, describe, describe_estimate
from kinebench_drake.calibration.solve import MIN_MOVING_FRAMES, LensSolution, solve_lens, solve_lens_and_postures
from kinebench_drake.calibration.states import (
    RobotStates,
    make_posture_states,
    parse_posture,
    read_states,
    unknown_states,
)
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.grounding.anomaly.camera_motion import (
    COMPENSABLE_PX,
    MOVING_PX,
    FeatureTracks,
    measure_camera_motion,
)
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from kinebench_drake.models.perception.network import load_network

FOV_DEG = (35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
"""Horizontal fields of view at which the search for the focal length starts [degrees]."""
MAX_MOVING_FRAMES = 12
"""Greatest number of frames without joint angles: each adds eight unknowns."""
_USUAL_FOV_DEG = 60.0
_CENTRE_SIGMA = 0.06  # standard deviation of an unknown principal point over the image's width
_AGAIN_ZOOM, _AGAIN_M, _AGAIN_RAD = 0.03, 0.03, np.deg2rad(3.0)


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
    frames: int = 24
    """Greatest number of frames used."""

    def __post_init__(self) -> None:
        """Check the options without reading files.

        Raises:
            UsageError: a number is out of range, or two options contradict each other.
        """
        if self.frames < 1:
            raise UsageError(f"--frames is {self.frames}, expected 1 or more")
        if self.focal_px is not None and not 1.0 <= self.focal_px <= 1e5:
            raise UsageError(f"--focal is {self.focal_px:g}, expected pixels from 1 to 100000, such as 600")
        if self.focal_px is not None and self.camera is not None:
            raise UsageError("--focal and --camera exclude each other: the camera file states the focal length")
        if self.frame_period_s is not None and not 1e-4 <= self.frame_period_s <= 1e3:
            raise UsageError(f"--frame-period is {self.frame_period_s:g}, expected seconds from 0.0001 to 1000")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationOutcome:
    """Calibration with the data of its figure."""

    calibration: CameraCalibration
    frame: NDArray[np.uint8]
    """(H, W, 3) one of the frames used."""
    X_BP: Array
    """(PARTS, 4, 4) frames of the parts' CAD coordinates in B in that frame [m]; NaN where unknown."""
    finger_m: float
    """Opening of each finger in that frame [m]."""


def calibrate(config: CalibrationConfig, estimator: ViewEstimator | None = None) -> CalibrationOutcome:
    """Calibrate the camera of a video.

    Args:
        config: video and prior information.
        estimator: view estimator; the tracker's networks if None.

    Raises:
        UsageError: an option cannot be used.
        InputError: the video or the joint angles are invalid, or inconsistent with each other.
        UnmeasurableError: the camera moves, or the video does not determine it.
        SetupError: weights, meshes or native libraries are missing.
    """
    model = ArmModel()
    intrinsics = None if config.camera is None else load_camera(config.camera)
    if config.joints is not None and not Path(config.joints).exists():
        parse_posture(config.joints)  # raises a usage error before minutes of work
    try:
        video = read_video(config.video)
        video.require_measurable()
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{config.video.name}: {error}") from None
    states = _states(config, video, model)
    guess = _guess(config, intrinsics, video.width, video.height)
    focal_free = config.camera is None and config.focal_px is None
    chosen = _chosen(states, config.frames)
    frames = video.frames[chosen]
    states = states.take(chosen)
    method = _method(states)
    cameras = None
    if estimator is None:
        dense = NetworkEstimator(load_network())
        anchored = method is CalibrationMethod.POSTURE
        estimator = NetworkViewEstimator(CadTracker(dense)) if anchored else DetectedViewEstimator(dense)
        cameras = CameraEstimator(dense, model)
    view = estimator.estimate(frames, guess)
    shift = _camera_shift(frames, view, guess)
    estimate, X_BP, finger_m = None, np.zeros(0), np.zeros(0)
    if cameras is not None and method is CalibrationMethod.MOTION:
        estimate = cameras.estimate(video.frames, None if focal_free else guess, focal_free=focal_free)
    else:
        solved = solve_with_reestimate(estimator, frames, view, states, guess, model, focal_free=focal_free)
        if cameras is not None and method is CalibrationMethod.JOINTS:
            estimate = _fit_contours(cameras, frames, states, guess, solved, config, focal_free=focal_free)
            estimate = replace(estimate, rows=chosen[estimate.rows])
    if estimate is not None:
        calibration = describe_estimate(estimate, model, method=method, source=states.source, focal_free=focal_free)
        X_BP, finger_m = model.poses(estimate.scene.q), estimate.scene.finger_m
    else:
        calibration = describe(
            solved, method=method, source=states.source, frames=chosen[solved.rows], focal_free=focal_free
        )
        X_BP, finger_m = solved.X_BP, solved.finger_m
    require_determined(calibration)
    middle = len(calibration.frames) // 2
    return CalibrationOutcome(
        calibration=replace(calibration, warnings=(*shift, *warnings_of(calibration))),
        frame=video.frames[calibration.frames[middle]],
        X_BP=X_BP[middle],
        finger_m=float(finger_m[middle]),
    )


def _fit_contours(
    cameras: CameraEstimator,
    frames: Frames,
    states: RobotStates,
    guess: Camera,
    solved: LensSolution,
    config: CalibrationConfig,
    *,
    focal_free: bool,
) -> CameraEstimate:
    """Refine a camera by the contours of the robot; the principal point is free unless a camera file states it."""
    scene = ArmScene(lens=solved.fit.lens, q=states.q[solved.rows], finger_m=solved.finger_m)
    start = Candidate(
        scene=scene, rows=solved.rows, cells=solved.cells, costs=np.zeros(len(solved.rows)), cost=solved.fit.cost
    )
    centre_sigma_px = _CENTRE_SIGMA * guess.width if config.camera is None else 0.0
    return cameras.refine(frames, guess, start, focal_free=focal_free, centre_sigma_px=centre_sigma_px)


def solve_with_reestimate(
    estimator: ViewEstimator,
    frames: Frames,
    view: LensView,
    states: RobotStates,
    guess: Camera,
    model: ArmModel,
    *,
    focal_free: bool,
) -> LensSolution:
    """Solve the lens with the views of a guess; if the solution differs much, again with views of the solution.

    Args:
        estimator: view estimator.
        frames: (T, H, W, 3) images.
        view: views estimated with the guess.
        states: robot states in the frames.
        guess: initial camera.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: too little of the robot is visible, or it contradicts the postures.
    """
    solved = solve(view, states, guess, model, focal_free=focal_free)
    camera = solved.fit.lens.to_camera()
    distance, angle = pose_difference(camera.X_BC, guess.X_BC)
    if abs(np.log(camera.fx / guess.fx)) > _AGAIN_ZOOM or distance > _AGAIN_M or angle > _AGAIN_RAD:
        return solve(estimator.estimate(frames, camera), states, camera, model, focal_free=focal_free)
    return solved


def _states(config: CalibrationConfig, video: Video, model: ArmModel) -> RobotStates:
    n = len(video.frames)
    if config.joints is None:
        return unknown_states(n)
    if not Path(config.joints).exists():
        return make_posture_states(config.joints, config.joints_frame, n, model)
    return read_states(Path(config.joints), config.episode, config.column, _times(video, config.frame_period_s), model)


def _times(video: Video, period_s: float | None) -> Array:
    """Return the times (T,) of the frames [s]; NaN if neither the user nor the video states them."""
    if period_s is None and video.stamps_s is not None:
        return video.stamps_s
    period = period_s or (1.0 / video.fps if video.fps else np.nan)
    return np.asarray(period * np.arange(len(video.frames)), dtype=np.float64)


def _guess(config: CalibrationConfig, intrinsics: Camera | None, width: int, height: int) -> Camera:
    """Return the initial camera: the pose of the benchmark camera unless a camera is provided."""
    if intrinsics is not None:
        return intrinsics.resized(width, height)
    focal = config.focal_px or default_focal_px(width)
    return replace(benchmark_camera(), width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)


def default_focal_px(width: int, fov_deg: float = _USUAL_FOV_DEG) -> float:
    """Return an initial focal length [px] of an image of this width, by its horizontal field of view [degrees]."""
    return width / 2 / float(np.tan(np.deg2rad(fov_deg) / 2))


def _chosen(states: RobotStates, most: int) -> NDArray[np.intp]:
    """Return the frames to use: spread over those of known hand pose if there are two or more, else over all."""
    rows, everything = np.flatnonzero(states.has_hand), np.arange(len(states.q))
    if len(rows) > 1:
        return _evenly(rows, most)
    others = _evenly(np.setdiff1d(everything, rows), min(most, MAX_MOVING_FRAMES) - len(rows))
    return np.asarray(np.union1d(rows, others), dtype=np.intp)


def _evenly(numbers: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    places = np.linspace(0, len(numbers) - 1, min(most, len(numbers)))
    return np.asarray(numbers[np.unique(places.round().astype(int))], dtype=np.intp)


def _camera_shift(frames: Frames, view: LensView, camera: Camera) -> tuple[str, ...]:
    """Return warnings about camera motion.

    Raises:
        UnmeasurableError: the camera moves.
    """
    if len(frames) < 2:
        return ()
    moved_px = measure_camera_motion(FeatureTracks(frames), view.robot, camera).largest_px
    unit = camera.unit_px
    if moved_px is None:
        return ("it is unknown whether the camera is static: the background has too few features",)
    if moved_px > COMPENSABLE_PX * unit:
        raise UnmeasurableError(
            f"the camera moves: the background shifts by {moved_px:.0f} px, at most {COMPENSABLE_PX * unit:.0f}; "
            "calibrate with a part of the video in which it stands still"
        )
    if moved_px > MOVING_PX * unit:
        return (f"the background shifts by {moved_px:.1f} px: the camera is not quite static",)
    return ()


def _method(states: RobotStates) -> CalibrationMethod:
    count = int(states.has_hand.sum())
    if count == 0:
        return CalibrationMethod.MOTION
    if not np.isfinite(states.q).any():
        return CalibrationMethod.POSES
    return CalibrationMethod.POSTURE if count < len(states.q) or count == 1 else CalibrationMethod.JOINTS


def solve(view: LensView, states: RobotStates, guess: Camera, model: ArmModel, *, focal_free: bool) -> LensSolution:
    """Solve the lens that projects the robot to where the frames show it, with all known postures.

    Args:
        view: views of the frames.
        states: robot states in the same frames.
        guess: initial camera.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: too little of the robot is visible, or it contradicts the postures.
    """
    rows = np.flatnonzero(states.has_hand)
    if not len(rows):
        return solve_lens_and_postures(
            view, states, Lens(camera=guess, X_CB=invert(guess.X_BC)), model, focal_free=focal_free
        )
    focal = [default_focal_px(guess.width, fov) for fov in FOV_DEG]
    cameras = [guess, *(with_focal(guess, fx) for fx in focal)] if focal_free else [guess]
    anchored = len(rows) == 1 and len(states.q) >= MIN_MOVING_FRAMES
    solved = solve_lens(view.of_frames(rows), states.take(rows), cameras, model, focal_free=focal_free and not anchored)
    if not anchored or np.isfinite(view.q).all(axis=1).sum() < MIN_MOVING_FRAMES:
        return replace(solved, rows=rows)
    return solve_lens_and_postures(view, states, solved.fit.lens, model, focal_free=focal_free)
