"""Trials: clips under conditions, measured by worker processes."""

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.perception.clip import TruthClip, TruthClipFile
from benchmarks.perception.errors import ClipErrors, Expense, compare, compare_track
from benchmarks.perception.perturbation.catalogue import Perturbation, perturb
from benchmarks.perception.reframing import Reframing, reframe
from benchmarks.perception.store import fingerprint
from benchmarks.perception.variants import (
    VARIANTS,
    Degradation,
    Ground,
    VariantTools,
    degraded,
    external,
)
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.overrides.depth import DepthPlugIn
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import hand_from_tcp
from kinebench_drake.track import GripperTrack
from training.baseline.network import Baseline


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialCondition:
    """Change of a clip or of the pipeline under which errors are measured."""

    name: str
    """Unique name in tables."""
    variant: str = "pixels"
    """Key of `VARIANTS`."""
    perturbation: Perturbation | None = None
    """Perturbation of the frames."""
    degradation: Degradation | None = None
    """Degradation of the estimated depth."""
    plug_in: DepthPlugIn | None = None
    """Another depth estimator."""
    reframing: Reframing | None = None
    """Size and shape of the frames."""
    baseline: Path | None = None
    """Weights of the learned baseline, measured in place of the grounding."""
    group: str = ""
    """Conditions of one group have one colour in figures."""

    def identity(self) -> str:
        """Return a text that is equal for equal conditions; plug-ins and weights count with their files, not paths."""
        if self.baseline is not None:
            return repr(replace(self, baseline=Path(fingerprint(files=[self.baseline]))))
        if self.plug_in is None:
            return repr(self)
        return repr(replace(self, plug_in=DepthPlugIn(f"{self.name} {fingerprint(files=self.plug_in.files)}")))


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingTrial:
    """One clip under one condition."""

    clip: TruthClipFile
    condition: TrialCondition


_RSS_UNIT_MB = 2**20 if sys.platform == "darwin" else 2**10  # of ru_maxrss in a megabyte
LoadedClip = tuple[TruthClip, Frames, NDArray[np.bool_], Array]
"""Clip with its frames, gripper masks, and the share (T,) of the gripper's silhouette that each frame shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialWorkerFactory:
    """Creates, in each process, the function that measures trials."""

    weights: Path | None = None
    """Weights in place of those shipped."""
    seed: int = 0
    """Seed of perturbations and degradations."""
    with_depth: bool = False
    """True if some condition needs the true depth."""

    def __call__(self) -> Callable[[GroundingTrial], ClipErrors]:
        """Return the function that measures one trial.

        Raises:
            SetupError: weights, CAD model or native libraries are missing.
        """
        tools = VariantTools.load(self.weights)
        loaded: dict[str, LoadedClip] = {}  # one clip, which consecutive trials share
        baselines: dict[Path, Baseline] = {}

        def measure(trial: GroundingTrial) -> ClipErrors:
            if trial.clip.id not in loaded:
                loaded.clear()
                clip = trial.clip.load(with_depth=self.with_depth)
                masks = clip.masks(tools.cad)
                share = clip.visible_share(masks, tools.cad)
                loaded[trial.clip.id] = clip, read_video(clip.path).frames, masks, share
            (clip, original, masks, share) = loaded[trial.clip.id]
            condition = trial.condition
            frames = None
            if condition.reframing is not None:
                clip, frames, shown = reframe(condition.reframing, clip, original, masks)
                share = np.asarray(share * shown)
            elif condition.perturbation is not None:
                frames, visible = perturb(condition.perturbation, original, masks, self.seed, clip.id)
                share = np.asarray(share * (visible.sum(axis=(1, 2)) / np.maximum(masks.sum(axis=(1, 2)), 1)))
            if (weights := condition.baseline) is not None:
                if weights not in baselines:
                    baselines[weights] = Baseline.load(weights)
                return evaluate_baseline(clip, baselines[weights], original if frames is None else frames, share)
            return evaluate(clip, self._pipeline(condition), tools, frames=frames, share=share)

        return measure

    def _pipeline(self, condition: TrialCondition) -> Ground:
        if condition.plug_in is not None:
            return external(condition.plug_in)
        if condition.degradation is not None:
            return degraded(condition.degradation, self.seed)
        return VARIANTS[condition.variant].ground


def evaluate(
    clip: TruthClip,
    ground: Ground,
    tools: VariantTools,
    *,
    frames: Frames | None = None,
    share: Array | None = None,
) -> ClipErrors:
    """Ground a clip and return its errors; decoding counts as expense unless `frames` are passed."""
    start = time.perf_counter(), time.process_time()
    grounding = ground(tools, clip, read_video(clip.path).frames if frames is None else frames)
    return compare(clip, grounding, _expense_since(*start), share)


def evaluate_baseline(clip: TruthClip, baseline: Baseline, frames: Frames, share: Array) -> ClipErrors:
    """Return the errors of the learned baseline, which has a pose in every frame."""
    start = time.perf_counter(), time.process_time()
    X_BG, finger_width_m = baseline.predict(frames)
    every = np.ones(len(frames), dtype=bool)
    track = GripperTrack(
        t_s=clip.t_s,
        X_CH=invert(clip.camera.X_BC) @ X_BG @ invert(hand_from_tcp()),
        X_BG=X_BG,
        tracked=every,
        confidence=every.astype(np.float64),
        finger_width_m=finger_width_m,
    )
    return compare_track(clip, track, _expense_since(*start), share)


def _expense_since(wall_s: float, cpu_s: float) -> Expense:
    return Expense(
        wall_s=time.perf_counter() - wall_s,
        cpu_s=time.process_time() - cpu_s,
        peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _RSS_UNIT_MB,
    )
