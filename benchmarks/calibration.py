"""Accuracy of the camera calibration on rendered videos with known cameras."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.markdown import table
from benchmarks.perception.clip import TruthClipFile, choose, find_clips
from kinebench_drake.errors import UnmeasurableError, UsageError, cause
from kinebench_drake.geometry import pose_difference
from kinebench_drake.grounding.camera.calibrate import Calibrator
from kinebench_drake.grounding.camera.calibration_result import CalibrationMethod, CameraCalibration
from kinebench_drake.grounding.camera.lens import USUAL_FOV_DEG, focal_px, with_focal
from kinebench_drake.grounding.camera.states import RobotStates
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import RobotPart


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationCondition:
    """Prior information of a calibration."""

    method: CalibrationMethod
    focal_free: bool

    @property
    def label(self) -> str:
        """Label in tables."""
        return f"{self.method.value}, focal length {'estimated' if self.focal_free else 'given'}"


CONDITIONS = tuple(CalibrationCondition(method=m, focal_free=z) for m in CalibrationMethod for z in (False, True))
"""All conditions that are measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationTrial:
    """One video under one condition."""

    clip: str
    condition: CalibrationCondition
    distance_m: float = float("nan")
    """Distance of estimated and true camera [m]; NaN if the calibration failed."""
    angle_rad: float = float("nan")
    """Angle between them [rad]."""
    focal: float = float("nan")
    """Estimated / true focal length - 1."""
    calibration: CameraCalibration | None = None
    """Estimate with its standard deviations; None if the calibration failed."""
    reason: str | None = None
    """Why it failed."""


def measure(
    folder: Path,
    *,
    limit: int | None,
    frames: int,
    conditions: Sequence[CalibrationCondition] = CONDITIONS,
    calibrator: Calibrator | None = None,
) -> Iterator[CalibrationTrial]:
    """Calibrate the cameras of a demonstration folder's videos.

    Of at most `limit` videos, tasks in turn, `frames` frames each are used. Trials come video by video.

    Raises:
        UsageError: the folder holds no such videos, or their truth no joint angles.
    """
    model = ArmModel()
    calibrator = calibrator or Calibrator.load()
    for clip in choose(find_clips(folder), limit):
        truth = _states(clip, model)
        images = read_video(clip.video).frames
        camera = clip.camera
        usual = with_focal(camera, focal_px(camera.width, USUAL_FOV_DEG))
        for condition in conditions:
            try:
                calibration = calibrator.calibrate(
                    images,
                    _prior_states(truth, condition.method),
                    usual if condition.focal_free else camera,
                    focal_free=condition.focal_free,
                    most=frames,
                )
            except UnmeasurableError as error:
                yield CalibrationTrial(clip=clip.id, condition=condition, reason=str(error))
                continue
            distance, angle = pose_difference(calibration.camera.X_BC, camera.X_BC)
            yield CalibrationTrial(
                clip=clip.id,
                condition=condition,
                distance_m=float(distance),
                angle_rad=float(angle),
                focal=calibration.camera.fx / camera.fx - 1.0,
                calibration=calibration,
            )


def trial_table(trials: Sequence[CalibrationTrial]) -> list[str]:
    """Return the lines of a Markdown table of errors and claimed standard deviations by condition."""
    rows = []
    for condition in dict.fromkeys(trial.condition for trial in trials):
        own = [t for t in trials if t.condition == condition]
        done = [t for t in own if t.calibration is not None]
        claimed = [t.calibration for t in done if t.calibration is not None]
        if not done:
            rows.append([condition.label, f"0 of {len(own)}", *[""] * 4])
            continue
        mm = _pair([1e3 * t.distance_m for t in done], 1)
        deg = _pair([float(np.rad2deg(t.angle_rad)) for t in done], 2)
        focal = _pair([100 * abs(t.focal) for t in done], 2) + " %" if condition.focal_free else "given"
        sigma = (
            f"{1e3 * np.median([c.position_sigma_m for c in claimed]):.1f} mm, "
            f"{np.rad2deg(np.median([c.rotation_sigma_rad for c in claimed])):.2f} degrees"
        )
        if condition.focal_free:
            sigma += f", {100 * np.median([c.focal_sigma for c in claimed]):.2f} %"
        rows.append([condition.label, f"{len(done)} of {len(own)}", f"{mm} mm", f"{deg} degrees", focal, sigma])
    head = ("known", "videos", "position, median / 95 %", "rotation", "focal length", "claimed sigma, median")
    return table(head, rows)


def _pair(values: Sequence[float], digits: int) -> str:
    return f"{np.median(values):.{digits}f} / {np.quantile(values, 0.95):.{digits}f}"


def _states(clip: TruthClipFile, model: ArmModel) -> RobotStates:
    try:
        with np.load(clip.truth, allow_pickle=False) as truth:
            q = truth["q"]
            width = truth["finger_width_m"]
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise UsageError(f"{clip.truth.name}: holds no joint angles of the frames ({cause(error)})") from None
    return RobotStates(q=q, X_BH=model.poses(q)[:, RobotPart.HAND], finger_m=width / 2, source="the truth")


def _prior_states(truth: RobotStates, method: CalibrationMethod) -> RobotStates | None:
    """Return the part of the true states that a method uses; None for the one that uses none."""
    if method is CalibrationMethod.JOINTS:
        return truth
    if method is CalibrationMethod.POSES:
        return replace(truth, q=np.full_like(truth.q, np.nan))
    if method is CalibrationMethod.ESTIMATE:
        return None
    first = np.arange(len(truth.q)) == 0
    return replace(
        truth,
        q=np.where(first[:, None], truth.q, np.nan),
        X_BH=np.where(first[:, None, None], truth.X_BH, np.nan),
        finger_m=np.full_like(truth.finger_m, np.nan),
    )
