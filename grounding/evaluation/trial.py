"""Trials: clips under conditions, measured by workers and kept."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.executors.progress import Observer
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.clip import TruthClip, TruthClipFile
from kinebench_drake.grounding.evaluation.degradation import Degradation
from kinebench_drake.grounding.evaluation.errors import ClipErrors, compare, metered
from kinebench_drake.grounding.evaluation.perturbation.catalogue import Perturbation, perturb
from kinebench_drake.grounding.evaluation.reframed import Reframing, reframe
from kinebench_drake.grounding.evaluation.store import TrialStore, fingerprint
from kinebench_drake.grounding.evaluation.variants import VARIANTS, Ground, Make, VariantTools, degraded, plug_in
from kinebench_drake.grounding.evaluation.visibility import true_masks, visible_share
from kinebench_drake.grounding.overrides.depth import depth_source_files
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.reader import read_video


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialCondition:
    """What is done to a clip or to the pipeline before it is measured."""

    name: str
    """What stands in tables; tells conditions apart."""
    variant: str = "pixels"
    """Name of a pipeline of `VARIANTS`."""
    perturbation: Perturbation | None = None
    """What is done to the frames."""
    degradation: Degradation | None = None
    """What is done to the estimated depth."""
    plug_in: str | None = None
    """Another depth estimator, as given on the command line."""
    reframing: Reframing | None = None
    """In what size and shape the frames are shown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingTrial:
    """One clip under one condition."""

    clip: TruthClipFile
    condition: TrialCondition


MakeWorker = Callable[[], Callable[[GroundingTrial], ClipErrors]]


@dataclass(slots=True)
class _TrialStand:
    """What a worker keeps from one trial to the next of the same clip."""

    id: str = ""
    clip: TruthClip | None = None
    frames: Frames = field(default_factory=lambda: np.zeros((0, 1, 1, 3), np.uint8))
    masks: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 1, 1), dtype=bool))
    share: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRunner:
    """Makes, in each process, what measures trials."""

    weights: Path | None = None
    """Weights in place of those shipped."""
    seed: int = 0
    """Draws perturbations and degradations."""
    with_depth: bool = False
    """Whether some condition needs the true depth."""

    def __call__(self) -> Callable[[GroundingTrial], ClipErrors]:
        """A function that measures one trial.

        Raises:
            SetupError: weights, CAD model or native libraries are missing.
        """
        tools, stand = VariantTools.load(self.weights), _TrialStand()

        def measure(trial: GroundingTrial) -> ClipErrors:
            if stand.id != trial.clip.id or stand.clip is None:
                stand.clip = trial.clip.load(with_depth=self.with_depth)
                stand.frames = read_video(stand.clip.path).frames
                stand.masks = true_masks(stand.clip, tools.cad)
                stand.share = visible_share(stand.clip, stand.masks, tools.cad)
                stand.id = trial.clip.id
            clip, condition = stand.clip, trial.condition
            if condition.reframing is not None:
                other = reframe(condition.reframing, clip, stand.frames, stand.masks)
                ground = self._maker(condition)(tools, other.clip)
                share = np.asarray(stand.share * other.shown)
                return evaluate(other.clip, ground, frames=other.frames, share=share)
            ground = self._maker(condition)(tools, clip)
            if condition.perturbation is None:
                return evaluate(clip, ground, share=stand.share)
            frames, masks = perturb(condition.perturbation, stand.frames, stand.masks, self.seed, clip.id)
            shown = masks.sum(axis=(1, 2)) / np.maximum(stand.masks.sum(axis=(1, 2)), 1)
            return evaluate(clip, ground, frames=frames, share=np.asarray(stand.share * shown))

        return measure

    def _maker(self, condition: TrialCondition) -> Make:
        if condition.plug_in is not None:
            return plug_in(condition.plug_in)
        if condition.degradation is not None:
            return degraded(condition.degradation, self.seed)
        return VARIANTS[condition.variant].make


def evaluate(
    clip: TruthClip, ground: Ground, *, frames: Frames | None = None, share: Array | None = None
) -> ClipErrors:
    """Ground a clip and hold it against its truth; the time of decoding counts unless `frames` are given."""
    grounding, expense = metered(lambda: ground(read_video(clip.path).frames if frames is None else frames))
    return compare(clip, grounding, expense, share)


def run(
    trials: Sequence[GroundingTrial],
    workshop: TrialRunner,
    engine: Executor,
    store: TrialStore,
    observer: Observer,
    make_worker: MakeWorker | None = None,
) -> Mapping[str, list[ClipErrors]]:
    """Measure what is not in the store yet; the results of each condition, in the order of the trials.

    Raises:
        SetupError: a worker died; what is finished is kept.
    """  # fmt: skip
    settings = (workshop.seed,)
    base = fingerprint(*settings, files=[workshop.weights] if workshop.weights else [])
    digests = {t.clip.id: t.clip.digest() for t in {t.clip.id: t for t in trials}.values()}
    conditions = {t.condition: _told(t.condition) for t in trials}
    keys = {_name(t): f"{base}-{digests[t.clip.id]}-{t.clip.id}-{conditions[t.condition]}" for t in trials}
    todo = [t for t in trials if keys[_name(t)] not in store]
    observer.start(len(trials), len(trials) - len(todo))
    for done in engine.run(make_worker or workshop, sorted(todo, key=lambda t: t.clip.id)):
        if isinstance(done, WorkerCrash):
            raise SetupError(
                f"{done.item.clip.id}, {done.item.condition.name}: {done.reason}; run the same command again, what is "
                "finished is kept"
            )
        store.put(keys[_name(done.item)], done.result)
        observer.advance(f"{done.item.clip.id}  {done.item.condition.name}")
    results: dict[str, list[ClipErrors]] = {}
    for trial in trials:
        results.setdefault(trial.condition.name, []).append(store[keys[_name(trial)]])
    return results


def _told(condition: TrialCondition) -> str:
    """All that tells a condition from others; a plug-in by what it consists of, not by where it lies."""
    if condition.plug_in is None:
        return repr(condition)
    plug_in = f"{condition.name} {fingerprint(files=depth_source_files(condition.plug_in))}"
    return repr(replace(condition, plug_in=plug_in))


def _name(trial: GroundingTrial) -> tuple[str, str]:
    return trial.clip.id, trial.condition.name
