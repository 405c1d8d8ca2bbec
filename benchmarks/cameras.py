"""Estimation of cameras that nobody names, on videos whose cameras are known exactly or nearly."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.footage import ReferenceKind, ReferenceVideo, find_reference_videos
from benchmarks.markdown import table
from kinebench_drake.calibration.estimate import CameraEstimate, CameraEstimator
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.evaluation.camera import find_doubt
from kinebench_drake.geometry import pose_difference
from kinebench_drake.grounding.evaluation.store import MeasurementStore, fingerprint
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.io.atomic import make_folder, write_atomically
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.robot import RobotPart, hand_from_tcp

_TWO_SIGMA = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTrial:
    """Camera estimated from one video, and its errors."""

    id: str
    reason: str | None
    """Why there is no base frame; None if there is one."""
    position_m: float
    """Distance from the true camera [m]; this and all below are NaN where no camera was estimated."""
    rotation_rad: float
    focal: float
    """Relative error of the focal length, signed."""
    position_sigma_m: float
    rotation_sigma_rad: float
    focal_sigma: float
    tcp_m: float
    """Distance of the fitted from the true TCP in the base frame, median over the frames used [m]."""
    tcp_rad: float
    """Angle between them [rad]."""
    gripper_sigma_m: float
    gripper_sigma_rad: float
    agreement: float
    runner_up: float
    base_agreement: float
    base_runner_up: float
    cpu_s: float

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in asdict(self).items()}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "CameraTrial":
        """Read the object that `to_json` returns."""
        values: dict[str, Any] = {k: float("nan") if v is None and k != "reason" else v for k, v in data.items()}
        return cls(**values)


def try_video(video: ReferenceVideo, estimator: CameraEstimator, model: ArmModel) -> CameraTrial:
    """Estimate the camera of a video from its frames alone."""
    frames = read_video(video.video).frames
    camera = video.camera.resized(frames.shape[2], frames.shape[1])
    start = time.process_time()
    try:
        estimate = estimator.estimate(frames)
    except UnmeasurableError as error:
        nan = dict.fromkeys([name for name in CameraTrial.__slots__ if name not in ("id", "reason", "cpu_s")], np.nan)
        return CameraTrial(id=video.id, reason=str(error), cpu_s=time.process_time() - start, **nan)
    distance, angle = pose_difference(estimate.camera.X_BC, camera.X_BC)
    tcp_m, tcp_rad = _tcp_errors(video, estimate, model)
    return CameraTrial(
        id=video.id,
        reason=find_doubt(estimate),
        position_m=float(distance),
        rotation_rad=float(angle),
        focal=estimate.camera.fx / camera.fx - 1.0,
        position_sigma_m=estimate.position_sigma_m,
        rotation_sigma_rad=estimate.rotation_sigma_rad,
        focal_sigma=estimate.focal_sigma,
        tcp_m=tcp_m,
        tcp_rad=tcp_rad,
        gripper_sigma_m=estimate.gripper_sigma_m,
        gripper_sigma_rad=estimate.gripper_sigma_rad,
        agreement=estimate.agreement,
        runner_up=estimate.runner_up,
        base_agreement=estimate.base_agreement,
        base_runner_up=estimate.base_runner_up,
        cpu_s=time.process_time() - start,
    )


def _tcp_errors(video: ReferenceVideo, estimate: CameraEstimate, model: ArmModel) -> tuple[float, float]:
    if video.X_CH is None:
        return float("nan"), float("nan")
    X_BH = video.camera.X_BC @ video.X_CH[estimate.rows]
    fitted = model.poses(estimate.scene.q)[:, RobotPart.HAND]
    distance, angle = pose_difference(fitted @ hand_from_tcp(), X_BH @ hand_from_tcp())
    return float(np.median(distance)), float(np.median(angle))


def measure(
    folder: Path, out: Path, names: Sequence[str] | None, *, weights: Path | None, log: Callable[[str], None]
) -> str:
    """Estimate the cameras of a folder of videos, write cameras.md, and return it.

    Args:
        folder: see `find_reference_videos`; videos without reference poses are left out.
        out: output folder.
        names: ids of videos to measure; all if None.
        weights: weights in place of those shipped.
        log: receives a line per video.

    Raises:
        UsageError: the folder has no such videos.
    """
    videos = [v for v in find_reference_videos(folder) if v.kind in _EXACT and (names is None or v.id in names)]
    if not videos:
        raise UsageError(f"{folder.name}: no video of these names has reference poses")
    make_folder(out)
    base = fingerprint(modules=["kinebench_drake.calibration.estimate"], files=[] if weights is None else [weights])
    store = MeasurementStore(out / "cameras.jsonl", CameraTrial)
    estimator: CameraEstimator | None = None
    model, trials = ArmModel(), []
    for video in videos:
        key = f"{base}-{video.digest}-{video.id}"
        if key not in store:
            estimator = estimator or CameraEstimator.create(weights)
            store.put(key, try_video(video, estimator, model))
            log(f"{video.id}: {store[key].cpu_s:.0f} s of processor time")
        trials.append(store[key])
    text = "\n".join([*_summary(trials), "", *_rows(trials)]) + "\n"
    write_atomically(out / "cameras.md", text.encode())
    return text


_EXACT = (ReferenceKind.SIMULATOR, ReferenceKind.JOINTS, ReferenceKind.EDGES)


def _summary(trials: Sequence[CameraTrial]) -> list[str]:
    """Return medians over the videos with a base frame, and how often two sigmas cover the errors."""
    used = [t for t in trials if t.reason is None]
    if not used:
        return [f"0 of {len(trials)} videos have a base frame."]
    pairs = {
        "position": [(t.position_m, t.position_sigma_m) for t in used],
        "rotation": [(t.rotation_rad, t.rotation_sigma_rad) for t in used],
        "focal length": [(abs(t.focal), t.focal_sigma) for t in used],
    }
    covered = ", ".join(f"{k} {np.mean([e <= _TWO_SIGMA * s for e, s in v]):.0%}" for k, v in pairs.items())
    middle = {k: np.median(v, axis=0) for k, v in pairs.items()}
    tcp_m, tcp_rad = np.median([(t.tcp_m, t.tcp_rad) for t in used], axis=0)
    return [
        f"{len(used)} of {len(trials)} videos have a base frame. There, medians (stated sigma): camera "
        f"{1e3 * middle['position'][0]:.0f} ({1e3 * middle['position'][1]:.0f}) mm, "
        f"{np.rad2deg(middle['rotation'][0]):.1f} ({np.rad2deg(middle['rotation'][1]):.1f}) degrees, focal length "
        f"{100 * middle['focal length'][0]:.1f} ({100 * middle['focal length'][1]:.1f}) %, TCP {1e3 * tcp_m:.0f} mm, "
        f"{np.rad2deg(tcp_rad):.1f} degrees; two sigmas cover: {covered}."
    ]


def _rows(trials: Sequence[CameraTrial]) -> list[str]:
    rows = [
        [
            t.id,
            f"{1e3 * t.position_m:.0f} ({1e3 * t.position_sigma_m:.0f})",
            f"{np.rad2deg(t.rotation_rad):.1f} ({np.rad2deg(t.rotation_sigma_rad):.1f})",
            f"{100 * t.focal:+.1f} ({100 * t.focal_sigma:.1f})",
            f"{1e3 * t.tcp_m:.0f} ({1e3 * t.gripper_sigma_m:.0f})",
            f"{np.rad2deg(t.tcp_rad):.1f} ({np.rad2deg(t.gripper_sigma_rad):.1f})",
            f"{t.agreement:.2f}",
            f"{t.base_agreement:.2f} / {t.base_runner_up:.2f}",
            f"{(t.agreement + t.base_agreement) / 2:.2f} / {t.runner_up:.2f}",
            "yes" if t.reason is None else f"no: {t.reason}",
        ]
        for t in trials
    ]
    head = ("error (sigma)", "camera [mm]", "[degrees]", "focal length [%]", "TCP [mm]", "[degrees]")
    return table((*head, "agreement, next", "base link, next turn", "base frame"), rows)
