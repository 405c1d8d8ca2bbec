"""Trials: clips under conditions, measured by worker processes."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.perception.clip import TruthClip, TruthClipFile
from benchmarks.perception.errors import ClipErrors, compare, compare_track
from benchmarks.perception.perturbation.catalogue import Perturbation, perturb
from benchmarks.perception.store import fingerprint
from benchmarks.perception.variants import VARIANTS, PipelineVariant
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.cad import GripperCad
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
    baseline: Path | None = None
    """Weights of the learned baseline, measured in place of the grounding."""

    def identity(self) -> str:
        """Return a text that is equal for equal conditions; weights count with their content, not their path."""
        if self.baseline is None:
            return repr(self)
        return repr(replace(self, baseline=Path(fingerprint(files=[self.baseline]))))


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingTrial:
    """One clip under one condition."""

    clip: TruthClipFile
    condition: TrialCondition


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedClip:
    """Clip with its frames and what they show of the gripper."""

    truth: TruthClip
    frames: Frames
    masks: NDArray[np.bool_]
    """(T, H, W) pixels of the gripper."""
    share: Array
    """(T,) share of the gripper's silhouette that each frame shows."""

    @classmethod
    def read(cls, file: TruthClipFile, cad: GripperCad, *, with_depth: bool) -> "LoadedClip":
        """Read a clip; depth maps only if `with_depth`."""
        truth = file.load(with_depth=with_depth)
        masks = truth.masks(cad)
        frames = read_video(truth.path).frames
        return cls(truth=truth, frames=frames, masks=masks, share=truth.visible_share(masks, cad))

    def perturbed(self, perturbation: Perturbation, seed: int) -> "LoadedClip":
        """Return the clip with perturbed frames."""
        frames, visible = perturb(perturbation, self.frames, self.masks, seed, self.truth.id)
        left = visible.sum(axis=(1, 2)) / np.maximum(self.masks.sum(axis=(1, 2)), 1)
        return replace(self, frames=frames, share=np.asarray(self.share * left))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialWorkerFactory:
    """Creates, in each process, the function that measures trials."""

    weights: Path | None = None
    """Weights in place of those shipped."""
    seed: int = 0
    """Seed of perturbations."""
    with_depth: bool = False
    """True if some condition needs the true depth."""

    def __call__(self) -> Callable[[GroundingTrial], ClipErrors]:
        """Return the function that measures one trial.

        Raises:
            SetupError: weights, CAD model or native libraries are missing.
        """
        pipeline = GroundingPipeline.create(weights=self.weights)
        cad = GripperCad()
        loaded: dict[str, LoadedClip] = {}  # one clip, which consecutive trials share
        load_baseline = cache(Baseline.load)

        def measure(trial: GroundingTrial) -> ClipErrors:
            if trial.clip.id not in loaded:
                loaded.clear()
                loaded[trial.clip.id] = LoadedClip.read(trial.clip, cad, with_depth=self.with_depth)
            clip = loaded[trial.clip.id]
            condition = trial.condition
            if condition.perturbation is not None:
                clip = clip.perturbed(condition.perturbation, self.seed)
            if condition.baseline is not None:
                return evaluate_baseline(clip.truth, load_baseline(condition.baseline), clip.frames, clip.share)
            variant = VARIANTS[condition.variant]
            return evaluate(clip.truth, variant, pipeline, frames=clip.frames, share=clip.share)

        return measure


def evaluate(
    clip: TruthClip,
    variant: PipelineVariant,
    pipeline: GroundingPipeline,
    *,
    frames: Frames | None = None,
    share: Array | None = None,
) -> ClipErrors:
    """Ground a clip, or other `frames` of it, and return its errors."""
    start = time.process_time()
    grounding = variant.ground(pipeline, clip, read_video(clip.path).frames if frames is None else frames)
    return compare(clip, grounding, time.process_time() - start, share)


def evaluate_baseline(clip: TruthClip, baseline: Baseline, frames: Frames, share: Array) -> ClipErrors:
    """Return the errors of the learned baseline, which has a pose in every frame."""
    start = time.process_time()
    track = baseline.track(frames, clip.t_s, clip.camera)
    return compare_track(clip, track, time.process_time() - start, share)
