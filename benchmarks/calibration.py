"""How well the camera of rendered videos is found again: `python -m benchmarks calibration`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinebench_drake.calibration.calibrate import default_focal_px, solve_with_reestimate
from kinebench_drake.calibration.correspondences import NetworkViewEstimator, ViewEstimator
from kinebench_drake.calibration.fit import with_focal
from kinebench_drake.calibration.result import CalibrationMethod, CameraCalibration, describe
from kinebench_drake.calibration.states import RobotStates, unknown_states
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError, UsageError, cause
from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.grounding.evaluation.clip import TruthClipFile, choose, find_clips
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.robot import RobotPart
from kinebench_drake.types import Json

_OFF_RAD = 0.15  # about the axis of joint 1: where nothing tells the camera's turn, the true one is no start


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """What is known in a measurement."""

    method: CalibrationMethod
    focal_free: bool

    @property
    def label(self) -> str:
        """What stands in tables."""
        return f"{self.method.value}, focal length {'estimated' if self.focal_free else 'given'}"


CONDITIONS = tuple(Condition(method=m, focal_free=z) for m in CalibrationMethod for z in (False, True))
"""Everything that is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One video under one condition."""

    clip: str
    condition: Condition
    distance_m: float
    """Between the camera found and the true one [m]; NaN where none was found."""
    angle_rad: float
    """Between their axes [rad]."""
    focal: float
    """Focal length found over the true one, less 1."""
    found: CameraCalibration | None
    """With the standard deviations it claims."""

    def to_json(self) -> dict[str, Json]:
        """All figures."""
        claimed = None
        if self.found is not None:
            claimed = (self.found.position_sigma_m, self.found.rotation_sigma_rad, self.found.focal_sigma)
        return {
            "clip": self.clip,
            "condition": self.condition.label,
            "distance_m": self.distance_m,
            "angle_rad": self.angle_rad,
            "focal": self.focal,
            "claimed": claimed,
        }


def measure(
    folder: Path,
    *,
    limit: int | None,
    frames: int,
    part: float = 1.0,
    conditions: Sequence[Condition] = CONDITIONS,
    estimator: ViewEstimator | None = None,
) -> Iterator[Trial]:
    """Find the cameras of a demonstration folder's videos again.

    Args:
        folder: what `suite demos` writes: videos, camera.json, manifest.jsonl and truth/.
        limit: so many videos only, tasks in turn.
        frames: frames of each video to use.
        part: how much of each picture's width and height is shown, in the middle: less is a longer lens.
        conditions: what is to be known.
        estimator: view estimator; the tracker's networks if None.

    Yields:
        Trials, those of a video one after the other.

    Raises:
        UsageError: the folder holds no such videos, or their truth no joint angles.
    """
    model = ArmModel()
    clips = choose(find_clips(folder), limit)
    estimator = estimator or NetworkViewEstimator.create()
    for clip in clips:
        film = read_video(clip.video).frames
        rows = np.unique(np.linspace(0, len(film) - 1, min(frames, len(film))).round().astype(int))
        truth = _states(clip, rows, model)
        shown, camera = _middle(film[rows], clip.camera, part)
        usual = with_focal(camera, default_focal_px(camera.width))
        given = estimator.estimate(shown, camera)
        views = {False: given, True: given if np.isclose(usual.fx, camera.fx) else estimator.estimate(shown, usual)}
        off = make_pose(rotation_exp([0.0, 0.0, _OFF_RAD]), np.zeros(3)) @ camera.X_BC
        for condition in conditions:
            states = _known(truth, condition.method)
            moving = condition.method is CalibrationMethod.MOTION
            free = condition.focal_free
            guess = replace(usual if free else camera, X_BC=off if moving else camera.X_BC)
            try:
                solved = solve_with_reestimate(estimator, shown, views[free], states, guess, model, focal_free=free)
            except UnmeasurableError:
                yield Trial(
                    clip=clip.id, condition=condition, distance_m=np.nan, angle_rad=np.nan, focal=np.nan, found=None
                )
                continue
            found = describe(
                solved,
                method=condition.method,
                source=states.source,
                frames=rows[solved.rows],
                focal_free=free,
            )
            distance, angle = pose_difference(found.camera.X_BC, camera.X_BC)
            yield Trial(
                clip=clip.id,
                condition=condition,
                distance_m=float(distance),
                angle_rad=float(angle),
                focal=found.camera.fx / camera.fx - 1.0,
                found=found,
            )


def _middle(frames: Frames, camera: Camera, part: float) -> tuple[Frames, Camera]:
    """The middle of the frames (T, H, W, 3), and its camera."""
    left, top = (round(side * (1.0 - part) / 2) for side in (camera.width, camera.height))
    width, height = camera.width - 2 * left, camera.height - 2 * top
    cut = np.ascontiguousarray(frames[:, top : top + height, left : left + width])
    return cut, replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)


def table(trials: Sequence[Trial]) -> list[str]:
    """A line for each condition: errors, and what part of them the claimed standard deviations explain."""
    lines = ["| known | videos | position, median / 95 % | rotation | focal length | claimed sigma, median |"]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    for condition in dict.fromkeys(trial.condition for trial in trials):
        own = [t for t in trials if t.condition == condition]
        done = [t for t in own if t.found is not None]
        claimed = [t.found for t in done if t.found is not None]
        if not done:
            lines.append(f"| {condition.label} | 0 of {len(own)} | | | | |")
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
        lines.append(f"| {condition.label} | {len(done)} of {len(own)} | {mm} mm | {deg} degrees | {focal} | {sigma} |")
    return lines


def _pair(values: Sequence[float], digits: int) -> str:
    return f"{np.median(values):.{digits}f} / {np.quantile(values, 0.95):.{digits}f}"


def _states(clip: TruthClipFile, rows: Array, model: ArmModel) -> RobotStates:
    try:
        with np.load(clip.truth, allow_pickle=False) as truth:
            q, width = truth["q"][rows], truth["finger_width_m"][rows]
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise UsageError(f"{clip.truth.name}: holds no joint angles of the frames ({cause(error)})") from None
    return RobotStates(q=q, X_BH=model.poses(q)[:, RobotPart.HAND], finger_m=width / 2, source="the truth")


def _known(truth: RobotStates, method: CalibrationMethod) -> RobotStates:
    """What of the truth is told."""
    nothing = unknown_states(len(truth.q))
    if method is CalibrationMethod.JOINTS:
        return truth
    if method is CalibrationMethod.POSES:
        return replace(truth, q=nothing.q)
    if method is CalibrationMethod.MOTION:
        return nothing
    first = np.arange(len(truth.q)) == 0
    return replace(
        nothing,
        q=np.where(first[:, None], truth.q, np.nan),
        X_BH=np.where(first[:, None, None], truth.X_BH, np.nan),
        source=truth.source,
    )
