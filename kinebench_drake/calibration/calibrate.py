"""The calibration of a static camera by a video of the robot."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.calibration.correspondences import LensView, NetworkViewEstimator, ViewEstimator
from kinebench_drake.calibration.fit import Lens, with_focal
from kinebench_drake.calibration.observability import require_determined, warnings_of
from kinebench_drake.calibration.result import CalibrationMethod, CameraCalibration, describe, with_warnings
from kinebench_drake.calibration.solve import MIN_MOVING_FRAMES, LensSolution, solve_known, solve_moving
from kinebench_drake.calibration.states import (
    RobotStates,
    file_states,
    posture,
    posture_states,
    unknown_states,
)
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.grounding.anomaly.camera_motion import COMPENSABLE_PX, MOVING_PX, measure_camera_motion
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from kinebench_drake.models.panda.robot import RobotPart

FOV_DEG = (35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
"""Horizontal fields of view with which the search for the focal length begins [degrees]."""
MAX_MOVING_FRAMES = 12
"""Frames used at most without joint angles: each adds eight unknowns."""
_USUAL_FOV_DEG = 60.0
_AGAIN_ZOOM, _AGAIN_M, _AGAIN_RAD = 0.03, 0.03, np.deg2rad(3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig:
    """What to calibrate, and what is known."""

    video: Path
    joints: str | None = None
    """A file of joint angles, one posture, or its name; None where nothing is known."""
    joints_frame: int = 0
    """The frame in which the robot is in that one posture."""
    episode: str | None = None
    """Which of several episodes the file holds is this video's."""
    column: str | None = None
    """The file's array or column of joint angles, where it is not found by itself."""
    frame_period_s: float | None = None
    """Time between two frames [s]; None takes the film's own."""
    camera: Path | None = None
    """A camera.json whose intrinsics hold; its pose is where the search begins without joint angles."""
    focal_px: float | None = None
    """Focal length of the video [px]; None where it is looked for."""
    frames: int = 24
    """How many frames to use at most."""

    def __post_init__(self) -> None:
        """Check what can be checked without reading anything.

        Raises:
            UsageError: a number is out of its range, or two options contradict each other.
        """
        if self.frames < 1:
            raise UsageError(f"--frames is {self.frames}, expected 1 or more")
        if self.focal_px is not None and not 1.0 <= self.focal_px <= 1e5:
            raise UsageError(f"--focal is {self.focal_px:g}, expected pixels from 1 to 100000, such as 600")
        if self.focal_px is not None and self.camera is not None:
            raise UsageError("--focal and --camera exclude each other: the camera's file tells the focal length")
        if self.frame_period_s is not None and not 1e-4 <= self.frame_period_s <= 1e3:
            raise UsageError(f"--frame-period is {self.frame_period_s:g}, expected seconds from 0.0001 to 1000")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationOutcome:
    """A calibration with what a picture of it needs."""

    calibration: CameraCalibration
    frame: NDArray[np.uint8]
    """(H, W, 3) one of the frames it was made from."""
    X_BP: Array
    """(PARTS, 4, 4) frames of the parts' CAD coordinates in B in that frame [m]; NaN where not known."""
    finger_m: float
    """Opening of each finger in that frame [m]."""


def calibrate(config: CalibrationConfig, eye: ViewEstimator | None = None) -> CalibrationOutcome:
    """Find the camera of a video.

    Args:
        config: what to calibrate, and what is known.
        eye: what looks; the tracker's networks if None.

    Raises:
        UsageError: what is told cannot be used.
        InputError: the video or the joint angles are broken, or do not go together.
        UnmeasurableError: the camera moves, or what is seen does not determine it.
        SetupError: weights, meshes or native libraries are missing.
    """
    model = ArmModel()
    intrinsics = None if config.camera is None else load_camera(config.camera)
    if config.joints is not None and not Path(config.joints).exists():
        posture(config.joints)  # a usage error before minutes of work
    try:
        video = read_video(config.video)
        video.require_measurable()
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{config.video.name}: {error}") from None
    states = _states(config, video, model)
    guess = _guess(config, intrinsics, video.width, video.height)
    zoom_free = config.camera is None and config.focal_px is None
    chosen = _chosen(states, config.frames)
    frames = video.frames[chosen]
    eye = eye or NetworkViewEstimator.create()
    look = eye.look(frames, guess)
    shift = _camera_shift(frames, look, guess)
    states = states.take(chosen)
    solved = seek(eye, frames, look, states, guess, model, zoom_free=zoom_free)
    calibration = describe(
        solved.fit,
        solved.cells,
        solved.p_B,
        method=_method(states),
        source=states.source,
        frames=chosen[solved.rows],
        hands_B=solved.X_BP[:, RobotPart.HAND, :3, 3],
        focal_free=zoom_free,
    )
    require_determined(calibration)
    middle = len(solved.rows) // 2
    return CalibrationOutcome(
        calibration=with_warnings(calibration, (*shift, *warnings_of(calibration))),
        frame=frames[solved.rows[middle]],
        X_BP=solved.X_BP[middle],
        finger_m=float(solved.finger_m[middle]),
    )


def seek(
    eye: ViewEstimator,
    frames: Frames,
    look: LensView,
    states: RobotStates,
    guess: Camera,
    model: ArmModel,
    *,
    zoom_free: bool,
) -> LensSolution:
    """The lens by a look with a guess, and by another one with what came of it where that is elsewhere.

    Args:
        eye: what looks.
        frames: (T, H, W, 3) what it looks at.
        look: what it saw with the guess.
        states: the robot in the frames.
        guess: the camera to begin with.
        model: link poses of the arm.
        zoom_free: whether the focal length is looked for.

    Raises:
        UnmeasurableError: too little is seen, or it does not go with the postures.
    """
    solved = solve(look, states, guess, model, zoom_free=zoom_free)
    found = solved.fit.lens.placed()
    if not _elsewhere(found, guess):
        return solved
    return solve(eye.look(frames, found), states, found, model, zoom_free=zoom_free)


def _elsewhere(found: Camera, guess: Camera) -> bool:
    """Whether a camera is so far from the one it was looked with that another look may show more."""
    distance, angle = pose_difference(found.X_BC, guess.X_BC)
    return bool(abs(np.log(found.fx / guess.fx)) > _AGAIN_ZOOM or distance > _AGAIN_M or angle > _AGAIN_RAD)


def _states(config: CalibrationConfig, video: Video, model: ArmModel) -> RobotStates:
    n = len(video.frames)
    if config.joints is None:
        return unknown_states(n)
    if not Path(config.joints).exists():
        return posture_states(config.joints, config.joints_frame, n, model)
    return file_states(Path(config.joints), config.episode, config.column, _times(video, config.frame_period_s), model)


def _times(video: Video, period_s: float | None) -> Array:
    """(T,) times of the frames [s]; NaN where neither the user nor the video tells."""
    if period_s is None and video.stamps_s is not None:
        return video.stamps_s
    period = period_s or (1.0 / video.fps if video.fps else np.nan)
    return np.asarray(period * np.arange(len(video.frames)), dtype=np.float64)


def _guess(config: CalibrationConfig, intrinsics: Camera | None, width: int, height: int) -> Camera:
    """The camera to look with first: where the benchmark's stands, unless something is known."""
    if intrinsics is not None:
        return intrinsics.resized(width, height)
    focal = config.focal_px or usual_focal_px(width)
    return replace(benchmark_camera(), width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)


def usual_focal_px(width: int) -> float:
    """Focal length [px] with which a picture so wide is looked at where none is known."""
    return width / 2 / float(np.tan(np.deg2rad(_USUAL_FOV_DEG) / 2))


def _chosen(states: RobotStates, most: int) -> NDArray[np.intp]:
    """Numbers of the frames to use: spread over those that are known, or where one at most is, over all of them."""
    known, everything = np.flatnonzero(states.known), np.arange(len(states.q))
    if len(known) > 1:
        return _evenly(known, most)
    others = _evenly(np.setdiff1d(everything, known), min(most, MAX_MOVING_FRAMES) - len(known))
    return np.asarray(np.union1d(known, others), dtype=np.intp)


def _evenly(numbers: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    places = np.linspace(0, len(numbers) - 1, min(most, len(numbers)))
    return np.asarray(numbers[np.unique(places.round().astype(int))], dtype=np.intp)


def _camera_shift(frames: Frames, look: LensView, camera: Camera) -> tuple[str, ...]:
    """What there is to say of a camera that does not stand still.

    Raises:
        UnmeasurableError: it moves.
    """
    if len(frames) < 2:
        return ()
    moved = measure_camera_motion(frames, look.robot, camera).largest_px
    unit = camera.unit_px
    if moved is None:
        return ("whether the camera stands still cannot be told: the background has too few features",)
    if moved > COMPENSABLE_PX * unit:
        raise UnmeasurableError(
            f"the camera moves: the background shifts by {moved:.0f} px, at most {COMPENSABLE_PX * unit:.0f}; "
            "calibrate with a part of the video in which it stands still"
        )
    if moved > MOVING_PX * unit:
        return (f"the background shifts by {moved:.1f} px: the camera does not quite stand still",)
    return ()


def _method(states: RobotStates) -> CalibrationMethod:
    known = int(states.known.sum())
    if known == 0:
        return CalibrationMethod.MOTION
    if not np.isfinite(states.q).any():
        return CalibrationMethod.POSES
    return CalibrationMethod.POSTURE if known < len(states.q) or known == 1 else CalibrationMethod.JOINTS


def solve(look: LensView, states: RobotStates, guess: Camera, model: ArmModel, *, zoom_free: bool) -> LensSolution:
    """The lens in which the robot is where the frames show it, by all that is known of its postures.

    Args:
        look: what the frames show.
        states: the robot in the same frames.
        guess: the camera to begin with.
        model: link poses of the arm.
        zoom_free: whether the focal length is looked for.

    Raises:
        UnmeasurableError: too little is seen, or it does not go with the postures.
    """
    known = np.flatnonzero(states.known)
    if not len(known):
        return solve_moving(look, states, Lens(camera=guess, X_CB=invert(guess.X_BC)), model, zoom_free=zoom_free)
    focal = [guess.width / 2 / float(np.tan(np.deg2rad(fov) / 2)) for fov in FOV_DEG]
    cameras = [guess, *(with_focal(guess, fx) for fx in focal)] if zoom_free else [guess]
    anchored = len(known) == 1 and len(states.q) >= MIN_MOVING_FRAMES
    solved = solve_known(
        look.of_frames(known), states.take(known), cameras, model, zoom_free=zoom_free and not anchored
    )
    if not anchored or np.isfinite(look.q).all(axis=1).sum() < MIN_MOVING_FRAMES:
        return replace(solved, rows=known)
    return solve_moving(look, states, solved.fit.lens, model, zoom_free=zoom_free)
