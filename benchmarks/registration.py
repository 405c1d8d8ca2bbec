"""Contribution of ICP to the pose of single frames, with depth from exact to estimated.

Each video is measured with the network's depth, with true depth, with true depth that has a share of the network's
errors, and with true depth that has smooth errors. In each frame the errors of the fit, of the registration and of
their combination are compared.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks import markdown
from benchmarks.bootstrap import cluster_bootstrap
from benchmarks.perception.clip import TruthClip, TruthClipFile, choose, find_clips
from benchmarks.perception.perturbation.gripper import smooth_noise
from benchmarks.perception.store import MeasurementStore, fingerprint
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Executor, Observer
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.priors import NO_PRIORS, ExternalDepth, Priors
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.tracker import CadTracker
from kinebench_drake.grounding.tracking.view import Crop, DenseEstimator, GripperView, replace_depth
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.perception.network import WEIGHTS, load_network

ERROR_CELLS = 12
"""Nodes of a smooth error across the image: about a gripper's width apart."""
ERROR_FRAMES = 8
"""Frames from one smooth error to the next; it is interpolated in between."""
_FLIP_RAD = np.pi / 2
_POSES = ("fit", "ICP", "combined")


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthKind:
    """Depth that videos are measured with."""

    name: str
    network_share: float = 0.0
    """Share of the network's errors, 1 for its own depth."""
    smooth_error: float = 0.0
    """Root mean square of a further relative error, which varies smoothly over image and time."""
    exact: bool = False
    """True if the depth is stated to be exact."""


KINDS = (
    DepthKind(name="network", network_share=1.0),
    DepthKind(name="a fifth of its error", network_share=0.2),
    DepthKind(name="smooth error of 1 %", smooth_error=0.01),
    DepthKind(name="exact", exact=True),
)


class BlendedEstimator:
    """Network whose depth errors are scaled; where the truth is unknown, its depth remains."""

    def __init__(self, base: DenseEstimator, depth: ExternalDepth, share: float) -> None:
        """Keep a share of the errors of `base` against the true `depth`."""
        self._base = base
        self._depth = depth
        self._share = share

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Yield the views of the network with scaled errors."""
        for number, view in self._base.estimate(frames, camera, crops):
            true_m = replace_depth(view, self._depth, number, camera).depth_m
            yield number, replace(view, depth_m=true_m * (view.depth_m / true_m) ** self._share)


class SmoothErrorEstimator:
    """Estimator whose depth has a relative error that varies smoothly over image and time."""

    def __init__(self, base: DenseEstimator, count: int, rms: float, rng: np.random.Generator) -> None:
        """Draw the errors, of root mean square `rms`, for a video of `count` frames."""
        self._base = base
        self._rms = rms
        self._nodes = smooth_noise(rng, count, ERROR_FRAMES, (ERROR_CELLS, ERROR_CELLS)).astype(np.float32)

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Yield the views of the estimator with wrong depth."""
        for number, view in self._base.estimate(frames, camera, crops):
            field = cv2.resize(self._nodes[number], (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
            error = self._rms * np.asarray(field) / field.std()
            yield (
                number,
                replace(
                    view, depth_m=view.depth_m * (1.0 + np.asarray(view.crop.warp(error, camera, view.stride), float))
                ),
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class RegistrationTrial:
    """One video with one kind of depth."""

    clip: TruthClipFile
    kind: DepthKind
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RegistrationErrors:
    """Errors in the frames of one video in which ICP converged and no pose is flipped."""

    position_m: dict[str, list[float]]
    """Position errors of fit, ICP and combination [m]."""
    rotation_rad: dict[str, list[float]]
    """Rotation errors [rad]."""
    weight: list[float]
    """Weight of the registration."""


class _Worker:
    """Measures trials."""

    def __init__(self) -> None:
        self._estimator = NetworkEstimator(load_network(WEIGHTS))

    def __call__(self, trial: RegistrationTrial) -> RegistrationErrors:
        clip = trial.clip.load(with_depth=True)
        if clip.depth_m is None:
            raise UsageError(f"{clip.id}: its truth holds no depth; make the videos with --with-depth")
        kind = trial.kind
        depth = ExternalDepth(depth_m=clip.depth_m, exact=True)
        estimator: DenseEstimator = self._estimator
        if kind.network_share < 1.0 and not kind.exact:
            estimator = BlendedEstimator(estimator, depth, kind.network_share)
        if kind.smooth_error:
            rng = np.random.default_rng([trial.seed, *clip.id.encode()])
            estimator = SmoothErrorEstimator(estimator, len(clip.t_s), kind.smooth_error, rng)
        priors = Priors(depth=depth) if kind.exact else NO_PRIORS
        tracking = CadTracker(estimator).track(read_video(clip.path).frames, clip.camera, priors)
        return _errors(clip, tracking.poses)


def _errors(clip: TruthClip, poses: Sequence[FramePose | None]) -> RegistrationErrors:
    rows = []
    for X_true, pose in zip(clip.X_CH, poses, strict=True):
        if pose is None or pose.icp is None or not np.isfinite(X_true).all():
            continue
        difference = pose_difference(X_true, np.stack([pose.icp.X_fit, pose.icp.registration.X_CH, pose.X_CH]))
        if difference[1][0] < _FLIP_RAD:
            rows.append((*difference, pose.icp))
    return RegistrationErrors(
        position_m={name: [round(float(p[k]), 7) for p, _, _ in rows] for k, name in enumerate(_POSES)},
        rotation_rad={name: [round(float(r[k]), 6) for _, r, _ in rows] for k, name in enumerate(_POSES)},
        weight=[icp.weight for *_, icp in rows],
    )


def measure(
    folder: Path, keep: Path, limit: int | None, seed: int, executor: Executor, observer: Observer
) -> dict[str, list[RegistrationErrors]]:
    """Return the errors of all videos by kind of depth; an interrupted measurement resumes from the file `keep`.

    Raises:
        UsageError: the folder holds no videos with true depth.
        SetupError: weights are missing, or a worker died.
    """
    clips = choose(find_clips(folder), limit)
    trials = [RegistrationTrial(clip=clip, kind=kind, seed=seed) for clip in clips for kind in KINDS]
    code = fingerprint(seed, modules=["kinebench_drake.grounding.tracking.tracker"])
    digests = {clip.id: clip.digest() for clip in clips}
    store = MeasurementStore(keep, RegistrationErrors)
    done = store.complete(
        trials,
        lambda t: f"{code}-{digests[t.clip.id]}-{t.kind}",
        executor,
        _Worker,
        observer,
        lambda t: f"{t.clip.id}  {t.kind.name}",
    )
    return {kind.name: [e for t, e in zip(trials, done, strict=True) if t.kind == kind] for kind in KINDS}


def section(results: Mapping[str, Sequence[RegistrationErrors]], seed: int = 0) -> str:
    """Return the section of docs/grounding-evidence.md: medians by kind of depth, with intervals over videos."""
    videos = len(next(iter(results.values())))
    frames = sum(len(e.weight) for e in next(iter(results.values())))
    head = ["depth", "weight"]
    head += [f"{name}, mm / degrees" for name in _POSES] + ["combined less fit, mm / degrees"]
    rows = [[name, *_cells(errors, seed)] for name, errors in results.items()]
    return markdown.section(
        "What ICP contributes",
        f"Written by `python -m benchmarks icp heldout --keep icp.jsonl --limit {videos} "
        f"--out docs/grounding-evidence.md`: {frames} single frames of {videos} held-out videos, before smoothing. "
        "The depth is the network's, the true "
        "one with errors, or exact. All columns but the last are medians. The last is the mean difference in the same "
        "frames, with its 95 % bootstrap interval over videos.",
        markdown.table(head, rows),
    )


def _cells(errors: Sequence[RegistrationErrors], seed: int) -> Iterator[str]:
    yield f"{np.median(np.concatenate([e.weight for e in errors])):.2f}"
    for name in _POSES:
        position = float(np.median(np.concatenate([e.position_m[name] for e in errors])))
        rotation = float(np.median(np.concatenate([e.rotation_rad[name] for e in errors])))
        yield f"{1e3 * position:.2f} / {np.rad2deg(rotation):.2f}"
    mm = _difference([e.position_m for e in errors], 1e3, seed)
    yield f"{mm} / {_difference([e.rotation_rad for e in errors], float(np.rad2deg(1.0)), seed)}"


def _difference(videos: Sequence[Mapping[str, Sequence[float]]], unit: float, seed: int) -> str:
    """Return the mean of combined less fit with its interval over videos."""
    gains: list[Array] = [unit * (np.array(v["combined"]) - np.array(v["fit"])) for v in videos if len(v["fit"])]
    gain = cluster_bootstrap(gains, lambda drawn: float(np.mean(np.concatenate(drawn))), seed)
    return f"{gain.value:+.2f} ({gain.low:+.2f} to {gain.high:+.2f})"
