"""Estimation of cameras that nobody names, on videos whose cameras are known exactly or nearly."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.footage import ReferenceKind, ReferenceVideo, find_reference_videos
from benchmarks.markdown import table
from kinebench_drake.datasets.videos.sample import VideoSample
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.evaluation.analyzer import Analyzer, RobotOptions
from kinebench_drake.evaluation.grounding import ground_with_camera
from kinebench_drake.geometry import pose_difference
from kinebench_drake.grounding.evaluation.store import MeasurementStore, fingerprint
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.atomic import make_folder, write_atomically
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.robot import hand_from_tcp
from kinebench_drake.segments import finite_rows
from kinebench_drake.types import GripperKind

_TWO_SIGMA = 2.0
_WRONG_M, _WRONG_RAD = 0.07, np.deg2rad(15.0)
"""Errors from which a TCP in the base frame is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTrial:
    """Camera estimated from one video, and what it makes of the track."""

    id: str
    reason: str | None
    """Why there is no base frame; None if there is one."""
    position_m: float = np.nan
    """Distance from the true camera [m]; this and all below are NaN where no camera was estimated."""
    rotation_rad: float = np.nan
    focal: float = np.nan
    """Relative error of the focal length, signed."""
    position_sigma_m: float = np.nan
    rotation_sigma_rad: float = np.nan
    focal_sigma: float = np.nan
    gripper_sigma_m: float = np.nan
    gripper_sigma_rad: float = np.nan
    agreement: float = np.nan
    base_agreement: float = np.nan
    base_runner_up: float = np.nan
    runner_up: float = np.nan
    aligned: bool = False
    """Whether lines of the surroundings were used."""
    tcp_m: tuple[float, ...] = ()
    """Distances of the tracked from the true TCPs in the base frame [m], whatever `reason` says."""
    tcp_rad: tuple[float, ...] = ()
    """Angles between them [rad]."""
    frames: int
    """Number of frames with a reference."""
    cpu_s: float

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {k: v for k, v in asdict(self).items() if not (isinstance(v, float) and np.isnan(v))}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "CameraTrial":
        """Read the object that `to_json` returns."""
        return cls(**{**data, "tcp_m": tuple(data["tcp_m"]), "tcp_rad": tuple(data["tcp_rad"])})


def try_video(video: ReferenceVideo, analyzer: Analyzer) -> CameraTrial:
    """Score a video as one whose camera nobody names."""
    sample = VideoSample(id=video.id, path=video.video, video=video.video.name)
    assert video.X_CH is not None
    frames = int(finite_rows(video.X_CH.reshape(-1, 16)).sum())
    start = time.process_time()
    try:
        grounded = ground_with_camera(
            read_video(video.video), sample, Overrides(), analyzer, video.frame_period_s, GripperKind.FRANKA
        )
    except UnmeasurableError as error:
        return CameraTrial(id=video.id, reason=str(error), frames=frames, cpu_s=time.process_time() - start)
    cpu_s = time.process_time() - start
    choice = grounded.choice
    estimate, X_BG = choice.estimate, grounded.grounding.track.X_BG
    X_true = video.camera.X_BC @ video.X_CH @ hand_from_tcp()
    both = finite_rows(X_true.reshape(-1, 16)) & finite_rows(X_BG.reshape(-1, 16))
    tcp_m, tcp_rad = pose_difference(X_BG[both], X_true[both])
    trial = CameraTrial(
        id=video.id,
        reason=choice.reason,
        tcp_m=tuple(np.round(tcp_m, 5).tolist()),
        tcp_rad=tuple(np.round(tcp_rad, 5).tolist()),
        frames=frames,
        cpu_s=cpu_s,
    )
    if estimate is None:
        return trial
    distance, angle = pose_difference(estimate.camera.X_BC, video.camera.X_BC)
    scale = estimate.camera.width / video.camera.width
    return replace(
        trial,
        position_m=float(distance),
        rotation_rad=float(angle),
        focal=estimate.camera.fx / (scale * video.camera.fx) - 1.0,
        position_sigma_m=estimate.position_sigma_m,
        rotation_sigma_rad=estimate.rotation_sigma_rad,
        focal_sigma=estimate.focal_sigma,
        gripper_sigma_m=estimate.gripper_sigma_m,
        gripper_sigma_rad=estimate.gripper_sigma_rad,
        agreement=estimate.agreement,
        base_agreement=estimate.base_agreement,
        base_runner_up=estimate.base_runner_up,
        runner_up=estimate.runner_up,
        aligned=estimate.is_aligned,
    )


def measure(folder: Path, out: Path, names: Sequence[str] | None, *, log: Callable[[str], None]) -> str:
    """Estimate the cameras of a folder of videos, write cameras.md, and return it.

    Args:
        folder: see `find_reference_videos`; videos without reference poses are left out.
        out: output folder.
        names: ids of videos to measure; all if None.
        log: receives a line per video.

    Raises:
        UsageError: the folder has no such videos.
    """
    videos = [v for v in find_reference_videos(folder) if v.kind in _EXACT and (names is None or v.id in names)]
    if not videos:
        raise UsageError(f"{folder.name}: no video of these names has reference poses")
    make_folder(out)
    base = fingerprint(modules=["kinebench_drake.evaluation.grounding"])
    store = MeasurementStore(out / "cameras.jsonl", CameraTrial)
    analyzer, trials = Analyzer(RobotOptions()), []
    for video in videos:
        key = f"{base}-{video.digest}-{video.id}"
        if key not in store:
            store.put(key, try_video(video, analyzer))
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
    tcp_m, tcp_rad = (np.concatenate([getattr(t, name) for t in used]) for name in ("tcp_m", "tcp_rad"))
    wrong = float(np.mean((tcp_m > _WRONG_M) | (tcp_rad > _WRONG_RAD))) if len(tcp_m) else 0.0
    tracked = len(tcp_m) / max(1, sum(t.frames for t in trials))
    return [
        f"{len(used)} of {len(trials)} videos have a base frame. There, medians (stated sigma): camera "
        f"{1e3 * middle['position'][0]:.0f} ({1e3 * middle['position'][1]:.0f}) mm, "
        f"{np.rad2deg(middle['rotation'][0]):.1f} ({np.rad2deg(middle['rotation'][1]):.1f}) degrees, focal length "
        f"{100 * middle['focal length'][0]:.1f} ({100 * middle['focal length'][1]:.1f}) %; "
        f"two sigmas cover: {covered}. TCP, median of the frames: "
        f"{1e3 * np.median(tcp_m):.0f} mm, {np.rad2deg(np.median(tcp_rad)):.1f} degrees. Tracked in a base "
        f"frame: {tracked:.1%} of the frames of all videos; of these {wrong:.1%} off by more than "
        f"{1e3 * _WRONG_M:.0f} mm or {np.rad2deg(_WRONG_RAD):.0f} degrees."
    ]


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def _rows(trials: Sequence[CameraTrial]) -> list[str]:
    rows = [
        [
            t.id,
            f"{1e3 * t.position_m:.0f} ({1e3 * t.position_sigma_m:.0f})",
            f"{np.rad2deg(t.rotation_rad):.1f} ({np.rad2deg(t.rotation_sigma_rad):.1f})",
            f"{100 * t.focal:+.1f} ({100 * t.focal_sigma:.1f})",
            f"{1e3 * _median(t.tcp_m):.0f} ({1e3 * t.gripper_sigma_m:.0f})",
            f"{np.rad2deg(_median(t.tcp_rad)):.1f} ({np.rad2deg(t.gripper_sigma_rad):.1f})",
            f"{len(t.tcp_m) / max(1, t.frames):.0%}",
            f"{t.agreement:.2f}",
            f"{t.base_agreement:.2f} / {t.base_runner_up:.2f}",
            f"{(t.agreement + t.base_agreement) / 2:.2f} / {t.runner_up:.2f}",
            "yes" if t.aligned else "no",
            "yes" if t.reason is None else f"no: {t.reason}",
        ]
        for t in trials
    ]
    head = (
        "video",
        "camera: error (sigma) [mm]",
        "[degrees]",
        "focal length [%]",
        "TCP: error (sigma) [mm]",
        "[degrees]",
    )
    shares = ("tracked", "arm on edges", "base, next turn", "both, next camera", "lines used", "base frame")
    return table((*head, *shares), rows)
