"""Calibration of a static camera from a video of the robot."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.camera_motion import FeatureTracks, measure_camera_motion
from kinebench_drake.grounding.camera.calibration_result import (
    CalibrationBasis,
    CalibrationMethod,
    CameraCalibration,
    describe,
    describe_estimate,
    require_determined,
    warnings_of,
)
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.grounding.camera.candidate import CameraCandidate
from kinebench_drake.grounding.camera.detections import ArmDetections, detect_all, track_all
from kinebench_drake.grounding.camera.estimate import FRAMES, CameraEstimator
from kinebench_drake.grounding.camera.lens import USUAL_FOV_DEG, centred_camera, focal_px
from kinebench_drake.grounding.camera.solve import LensSolution, solve
from kinebench_drake.grounding.camera.states import (
    RobotStates,
    make_posture_states,
    parse_posture,
    read_states,
)
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.tracker import CadTracker
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from kinebench_drake.models.perception.network import load_network
from kinebench_drake.segments import evenly

RobotSource = Callable[[Frames, Camera], ArmDetections]
"""Detection of the robot in frames (T, H, W, 3) that were taken with approximately this camera."""
_DEFAULT_FRAMES = 24
_CENTRE_SIGMA = 0.06
"""Standard deviation of an unknown principal point over the image's width."""
_OTHER_M = 0.03
"""Distance from the initial camera from which on the frames are measured again: the views depend on the camera [m]."""
_OTHER_RAD = float(np.deg2rad(5.0))
"""Angle to the initial camera from which on they are [rad]."""
_OTHER_ZOOM = 0.05
"""Logarithm of the ratio of focal lengths from which on they are."""


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

    def __post_init__(self) -> None:
        """Check the options without reading files.

        Raises:
            UsageError: a number is out of range, or two options contradict each other.
        """
        if self.frames < 1:
            raise UsageError(f"$frames is {self.frames}, expected 1 or more")
        if self.focal_px is not None and not 1.0 <= self.focal_px <= 1e5:
            raise UsageError(f"$focal_px is {self.focal_px:g}, expected pixels from 1 to 100000, such as 600")
        if self.focal_px is not None and self.camera is not None:
            raise UsageError("$focal_px and $camera exclude each other: the camera file states the focal length")
        if self.frame_period_s is not None and not 1e-4 <= self.frame_period_s <= 1e3:
            raise UsageError(f"$frame_period_s is {self.frame_period_s:g}, expected seconds from 0.0001 to 1000")
        if self.joints is None and self.joints_frame:
            raise UsageError(f"$joints_frame {self.joints_frame}: there is no $joints, whose posture it would be")
        is_file = self.joints is not None and (Path(self.joints).exists() or parse_posture(self.joints) is None)
        if not is_file and (self.episode or self.column):
            raise UsageError("$episode and $column choose from a file of joint angles, and $joints names none")


class Calibrator:
    """Calibration of cameras from decoded videos; one instance serves any number of them."""

    def __init__(self, detected: RobotSource, tracked: RobotSource, cameras: CameraEstimator) -> None:
        """Set the sources of detections: `tracked` ones have postures where only one posture is known."""
        self._detected = detected
        self._tracked = tracked
        self._cameras = cameras
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
    ) -> CameraCalibration:
        """Calibrate the camera of frames (T, H, W, 3).

        Args:
            frames: images.
            states: robot states in these frames; None to estimate the camera without any.
            guess: initial camera.
            focal_free: True to estimate the focal length.
            centre_free: True if the principal point is not known exactly.
            most: greatest number of frames used.

        Raises:
            UnmeasurableError: the camera moves, or the video does not determine it.
        """
        chosen = evenly(len(frames), min(most, FRAMES)) if states is None else _chosen(states, most)
        method = _method(states)
        source = self._tracked if method is CalibrationMethod.POSTURE else self._detected
        images = frames[chosen]
        robot = source(images, guess)
        shift = _camera_shift(images, robot.robot, guess)
        basis = CalibrationBasis(
            method=method, source="nothing" if states is None else states.source, focal_free=focal_free
        )
        if states is None:
            calibration = describe_estimate(self._estimate(frames, guess, focal_free=focal_free), self._model, basis)
        else:
            solved = solve(robot, states.take(chosen[robot.rows]), guess, self._model, focal_free=focal_free)
            camera = solved.bundle.scene.lens.to_camera()
            if _is_other(camera, guess):
                robot = source(images, camera)
                solved = solve(robot, states.take(chosen[robot.rows]), camera, self._model, focal_free=focal_free)
            if method is CalibrationMethod.JOINTS:
                centre_sigma_px = _CENTRE_SIGMA * guess.width if centre_free else 0.0
                used = images[robot.rows]
                estimate = self._cameras.refine(
                    used, guess, _start(solved), focal_free=focal_free, centre_sigma_px=centre_sigma_px
                )
                calibration = describe_estimate(estimate, self._model, basis)
            else:
                calibration = describe(solved, basis)
            calibration = replace(calibration, frames=chosen[robot.rows[calibration.frames]])
            require_determined(calibration)
        image = frames[calibration.frames[len(calibration.frames) // 2]]
        return replace(calibration, warnings=(*shift, *warnings_of(calibration)), image=image)

    def _estimate(self, frames: Frames, guess: Camera, *, focal_free: bool) -> CameraEstimate:
        """Estimate the camera of frames (T, H, W, 3) without joint angles.

        Raises:
            UnmeasurableError: the camera is in doubt.
        """
        estimate = self._cameras.estimate(frames, guess, focal_free=focal_free)
        if estimate.doubt is not None:
            raise UnmeasurableError(
                f"base_from_camera is not determined without joint angles: {estimate.doubt}; give $joints FILE, "
                "or the posture of one frame ($joints q1,...,q7)"
            )
        return estimate


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
    states = _states(config, video, ArmModel())
    return (calibrator or Calibrator.load()).calibrate(
        video.frames,
        states,
        _guess(config, intrinsics, video.width, video.height),
        focal_free=config.camera is None and config.focal_px is None,
        centre_free=config.camera is None,
        most=config.frames,
    )


def _start(solved: LensSolution) -> CameraCandidate:
    """Return the solution from the cells as the start of the fit to contours."""
    costs = np.zeros(len(solved.rows))
    return CameraCandidate(scene=solved.bundle.scene, rows=solved.rows, cells=solved.cells, costs=costs, cost=0.0)


def _states(config: CalibrationConfig, video: Video, model: ArmModel) -> RobotStates | None:
    if config.joints is None:
        return None
    if not Path(config.joints).exists():
        return make_posture_states(config.joints, config.joints_frame, len(video.frames), model)
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
    return centred_camera(width, height, config.focal_px or focal_px(max(width, height), USUAL_FOV_DEG))


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
        UnmeasurableError: the camera moves.
    """
    if len(frames) < 2:
        return ()
    moved_px = measure_camera_motion(FeatureTracks(frames), robot, camera).largest_px
    unit = camera.unit_px
    if moved_px is None:
        return ("it is unknown whether the camera is static: the background has too few features",)
    if moved_px > bounds.COMPENSABLE_PX * unit:
        raise UnmeasurableError(
            f"the camera moves: the background shifts by {moved_px:.0f} px, at most {bounds.COMPENSABLE_PX * unit:.0f}"
            "; calibrate with a part of the video in which it stands still"
        )
    if moved_px > bounds.MOVING_PX * unit:
        return (f"the background shifts by {moved_px:.1f} px: the camera is not quite static",)
    return ()


def _is_other(camera: Camera, guess: Camera) -> bool:
    """Return whether a camera differs much from another one."""
    distance, angle = pose_difference(camera.X_BC, guess.X_BC)
    moved = distance > _OTHER_M or angle > _OTHER_RAD
    return bool(abs(np.log(camera.fx / guess.fx)) > _OTHER_ZOOM or moved)


def _method(states: RobotStates | None) -> CalibrationMethod:
    if states is None:
        return CalibrationMethod.ESTIMATE
    if not np.isfinite(states.q).any():
        return CalibrationMethod.POSES
    return CalibrationMethod.POSTURE if states.has_hand.sum() == 1 else CalibrationMethod.JOINTS
