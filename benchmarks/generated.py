"""Study of a learned world model: which numbers of its videos go along with success, and what a person sees in them.

The study is a folder of output folders of `suite run` on the same episodes, as `examples/worldmodel/study.sh` makes it:
the best training in closed loop, policies to compare it with, and one clip an episode of each training. A cell is one
task of one training. Images are compared with the expert's first clip, which begins with the same frame.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import rankdata
from torch.nn import functional

from benchmarks.markdown import section, table
from benchmarks.perception.store import MeasurementStore, Milli, fingerprint
from kinebench_drake.api.scorer import reward_of
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import as_object
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.power import least_difference
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.stats import IntervalEstimate, PairedShares, percentile_interval, resampled_counts, wilson
from kinebench_drake.suites.closed_loop.gap import signal_noise_ratio_db, structural_similarity
from kinebench_drake.suites.report.correlation import standardise

BEST = "best"
EXPERT = "oracle"
STILL = "still"
RANDOM = "random"
TRANSFER = "transfer"
SAMPLES = "samples"
"""Folders of the best training, the expert's videos, videos that do not move, random motions, a task that the best
training has not seen, and several samples of each episode."""
LEARNED = "learned-"
"""Beginning of the names of the runs of one clip an episode; other runs have no part in correlations."""
LEAST_CELLS = 8
"""Cells with some success and some failure that a correlation needs."""
_STRIDE = 4  # every fourth frame of a clip is compared with the expert's


@dataclass(frozen=True, slots=True, kw_only=True)
class Likeness:
    """Likeness of a clip and the expert's, means over frames."""

    psnr_db: Milli
    ssim: float
    feature_distance: float
    """1 - cosine of the two frames' features: EfficientNet-Lite0, trained on ImageNet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipPair:
    """First clips of the same episode."""

    id: str
    generated: Path
    expert: Path


class _Comparer:
    """Compares clips; loads the network once."""

    @cached_property
    def _encoder(self) -> torch.nn.Module:
        from kinebench_drake.models.perception.network import GripperNetwork
        from training.loop import load_imagenet

        encoder = GripperNetwork().encoder.eval()
        load_imagenet(encoder)
        return encoder

    def __call__(self, pair: ClipPair) -> Likeness:
        generated, expert = (read_video(path).frames for path in (pair.generated, pair.expert))
        chosen = range(_STRIDE, min(len(generated), len(expert)), _STRIDE)
        one = generated[list(chosen)]
        other = expert[list(chosen)]
        grey = [[cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames] for frames in (one, other)]
        like = functional.cosine_similarity(self._features(one), self._features(other))
        return Likeness(
            psnr_db=float(np.mean([signal_noise_ratio_db(a, b) for a, b in zip(one, other, strict=True)])),
            ssim=float(np.mean([structural_similarity(a, b) for a, b in zip(*grey, strict=True)])),
            feature_distance=float(1 - like.mean()),
        )

    @torch.inference_mode()
    def _features(self, frames: NDArray[np.uint8]) -> torch.Tensor:
        images = functional.interpolate(torch.from_numpy(frames).movedim(-1, 1) / 127.5 - 1, (224, 224), mode="area")
        features: torch.Tensor = self._encoder(images)[-1].mean(dim=(2, 3))
        return features

    def close(self) -> None:
        """Nothing is held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Predictor:
    """Number of a video that may go along with success."""

    name: str
    value: Callable[[SampleRow, Likeness | None], float | None]
    sign: int = 1
    """-1 where less is better."""


def _likeness(name: str) -> Callable[[SampleRow, Likeness | None], float | None]:
    return lambda row, likeness: None if likeness is None else float(getattr(likeness, name))


def _metric(name: str) -> Callable[[SampleRow, Likeness | None], float | None]:
    def value(row: SampleRow, likeness: Likeness | None) -> float | None:
        number = row.metrics.get(name)
        return float(number) if isinstance(number, int | float) else None

    return value


PREDICTORS = (
    Predictor(name="executable share", value=lambda row, likeness: float(row.executable is True)),
    Predictor(name="SPARC", value=_metric("sparc")),
    Predictor(name="manipulability", value=_metric("manipulability_mean")),
    Predictor(name="tracked share", value=_metric("tracked_fraction")),
    Predictor(name="PSNR to the expert", value=_likeness("psnr_db")),
    Predictor(name="SSIM to the expert", value=_likeness("ssim")),
    Predictor(name="feature distance", value=_likeness("feature_distance"), sign=-1),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One task of one training; rows of arrays are episodes in the order of their ids."""

    training: str
    task: str
    success: Array
    """(N,) 0 or 1."""
    numbers: Array
    """(N, len(PREDICTORS)), the greater the better; where it is not measurable the worst of the study."""

    @property
    def is_mixed(self) -> bool:
        """True if some episodes succeed and some do not."""
        return bool(0 < self.success.mean() < 1)


def read_runs(study: Path) -> dict[str, list[SampleRow]]:
    """Return the rows of each run of a study, those with an outcome, by the folder's name.

    Raises:
        UsageError: the folder is no study.
    """
    folders = sorted(path.parent for path in study.glob("*/samples.jsonl"))
    rows = {f.name: [r for r in read_rows(f).values() if r.status is not Status.ERROR] for f in folders}
    if missing := [name for name in (BEST, EXPERT) if name not in rows]:
        raise UsageError(f"{study.name}: has no folder {missing[0]}; make it with examples/worldmodel/study.sh")
    return rows


def compare_clips(
    study: Path, trainings: Mapping[str, Sequence[SampleRow]], jobs: int, observer: RunObserver
) -> dict[tuple[str, str], Likeness]:
    """Compare the first clips with the expert's, by training and id; an interrupted comparison resumes."""
    pairs = {
        (name, row.id): ClipPair(
            id=f"{name}/{row.id}",
            generated=study / name / "videos" / f"{row.id}_r0.mp4",
            expert=study / EXPERT / "videos" / f"{row.id}_r0.mp4",
        )
        for name, rows in trainings.items()
        for row in rows
    }
    pairs = {key: pair for key, pair in pairs.items() if pair.generated.exists() and pair.expert.exists()}
    store = MeasurementStore(study / "likeness.jsonl", Likeness)
    done = store.complete(
        list(pairs.values()),
        lambda pair: f"{pair.id}-{fingerprint(files=[pair.generated, pair.expert])}",
        LocalExecutor(jobs=jobs),
        _Comparer,
        observer,
        lambda pair: pair.id,
    )
    return dict(zip(pairs, done, strict=True))


def make_cells(
    trainings: Mapping[str, Sequence[SampleRow]], likeness: Mapping[tuple[str, str], Likeness]
) -> list[Cell]:
    """Return the cells of the trainings."""
    keys, rows = zip(*((name, row) for name, own in trainings.items() for row in own), strict=True)
    columns = []
    for predictor in PREDICTORS:
        values = [predictor.value(row, likeness.get((name, row.id))) for name, row in zip(keys, rows, strict=True)]
        numbers = np.array([np.nan if v is None else predictor.sign * v for v in values], dtype=np.float64)
        columns.append(np.where(np.isfinite(numbers), numbers, np.nanmin(numbers)))
    numbers = np.stack(columns, axis=1)
    success = np.array([_hit(row) for row in rows])
    cells: dict[tuple[str, str], list[int]] = {}
    for k in np.argsort([row.id for row in rows]).tolist():
        cells.setdefault((keys[k], str(rows[k].task)), []).append(k)
    return [
        Cell(training=name, task=task, success=success[own], numbers=numbers[own])
        for (name, task), own in sorted(cells.items())
    ]


def _hit(row: SampleRow) -> float:
    return float(row.extra.get("success") is True)


def correlate(cells: Sequence[Cell], *, within: bool) -> list[IntervalEstimate]:
    """Return Spearman's rho (1904) of each predictor's mean and success over the cells.

    With `within` both are standardised within each task, which removes the tasks' difficulty. The interval is the
    percentile bootstrap over episodes, drawn alike in all cells with as many: their scenes are the same.
    """
    rng = np.random.default_rng(0)
    drawn = {n: resampled_counts(n, rng) / n for n in sorted({len(cell.success) for cell in cells})}
    draws = _rhos(cells, [drawn[len(cell.success)] for cell in cells], within=within)
    (values,) = _rhos(cells, [np.full((1, len(cell.success)), 1 / len(cell.success)) for cell in cells], within=within)
    ends = [percentile_interval(column[np.isfinite(column)]) for column in draws.T]
    return [
        IntervalEstimate(value=float(rho), low=low, high=high) for rho, (low, high) in zip(values, ends, strict=True)
    ]


def _rhos(cells: Sequence[Cell], weights: Sequence[Array], *, within: bool) -> Array:
    """Return the coefficients (D, P) for weights (D, N) of the episodes of each cell; NaN where a variable is flat."""
    x = np.stack([w @ cell.numbers for w, cell in zip(weights, cells, strict=True)])  # (C, D, P)
    y = np.stack([w @ cell.success for w, cell in zip(weights, cells, strict=True)])[..., None]
    if within:
        for task in {cell.task for cell in cells}:
            own = [cell.task == task for cell in cells]
            for values in (x, y):
                values[own] = standardise(values[own].reshape(sum(own), -1)).reshape(values[own].shape)
    a, b = (rankdata(values.round(9), axis=0) - (len(cells) + 1) / 2 for values in (x, y))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((a * b).sum(axis=0) / np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0)))


def clip_ends(row: SampleRow) -> list[int]:
    """Return the number of frames of an episode up to the end of each clip."""
    frames = row.extra["clip_frames"]
    return list(accumulate(int(str(n)) for n in frames)) if isinstance(frames, list) else []


def reported_kinds(row: SampleRow, clip: int) -> set[str]:
    """Return the kinds of anomalies that are reported in a clip of an episode, from 0."""
    start, end = [0, *clip_ends(row)][clip : clip + 2]
    anomalies = row.metrics.get("anomalies")
    objects = [as_object(a) for a in anomalies] if isinstance(anomalies, list) else []
    return {str(a["kind"]) for a in objects if start <= int(str(a["frame_start"])) < end}


def success_lines(runs: Mapping[str, Sequence[SampleRow]]) -> list[str]:
    """Return the table of successes by run and task, with the share that is executable."""
    tasks = sorted({str(row.task) for own in runs.values() for row in own})
    lines = []
    for name, own in runs.items():
        hits = [[_hit(row) for row in own if row.task == task] for task in tasks]
        texts = [f"{sum(h):.0f} of {len(h)}" if h else "" for h in hits]
        executable = float(np.mean([row.executable is True for row in own]))
        low, high = wilson(round(sum(map(sum, hits))), len(own))
        total = f"{100 * np.mean([_hit(row) for row in own]):.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
        lines.append([name, *texts, total, f"{100 * executable:.0f} %"])
    return table(["run", *tasks, "success", "executable"], lines)


def gain_text(runs: Mapping[str, Sequence[SampleRow]]) -> str:
    """Return the difference of the best training's success and that of policies that see nothing, on their episodes."""
    best = {row.id: _hit(row) for row in runs[BEST]}
    texts = []
    for name in (STILL, RANDOM):
        both = [(best[row.id], _hit(row)) for row in runs.get(name, ()) if row.id in best]
        if both:
            texts.append(
                f"`{name}` {points_text(_pair([a for a, _ in both], [b for _, b in both]))} ({len(both)} episodes)"
            )
    return f"Success of `{BEST}` less that of {', of '.join(texts)}." if texts else ""


def transfer_text(rows: Sequence[SampleRow]) -> str:
    """Return the success in a task that was not trained."""
    hits = int(sum(map(_hit, rows)))
    low, high = wilson(hits, len(rows))
    return f"In {rows[0].task}, not seen in training: {hits} of {len(rows)} [{100 * low:.0f}, {100 * high:.0f}] %."


def _pair(first: Sequence[float] | Array, second: Sequence[float] | Array, samples: int = 1) -> PairedShares:
    return PairedShares(first=np.asarray(first), second=np.asarray(second), samples=samples)


def points_text(paired: PairedShares) -> str:
    """Return the difference in percentage points, with its interval."""
    low, high = paired.interval()
    return f"{100 * paired.difference:.0f} points [{100 * low:.0f}, {100 * high:.0f}]"


def correlation_lines(cells: Sequence[Cell]) -> list[str]:
    """Return the table of correlations, or why there is none."""
    mixed = [cell for cell in cells if cell.is_mixed]
    if len(mixed) < LEAST_CELLS:
        return [f"No correlation: {len(mixed)} cells have some success and some failure, {LEAST_CELLS} are needed."]
    both = [correlate(mixed, within=within) for within in (False, True)]
    rows = [[p.name, *map(_interval, pair)] for p, *pair in zip(PREDICTORS, *both, strict=True)]
    return table(["number", f"rho over {len(mixed)} cells", "within tasks"], rows)


def _interval(estimate: IntervalEstimate) -> str:
    return f"{estimate.value:.2f} [{estimate.low:.2f}, {estimate.high:.2f}]"


def best_lines(folder: Path) -> list[str]:
    """Return the success of the sample with the best verdict of each episode beside that of all, and the gain.

    The verdict of a sample is its reward (`kinebench_drake.api.scorer.reward_of`); the first of equal ones is taken.
    """
    groups: dict[str, list[SampleRow]] = {}
    for row in sorted(read_rows(folder).values(), key=lambda row: row.sample_index):
        groups.setdefault(row.episode, []).append(row)
    success = np.array([[_hit(row) for row in own] for own in groups.values()])
    best = [int(np.argmax([reward_of(row) for row in own])) for own in groups.values()]
    paired = _pair(success[np.arange(len(success)), best], success.mean(axis=1), success.shape[1])
    least = least_difference(paired)
    shares = (paired.second.mean(), paired.first.mean(), success.max(axis=1).mean())
    head = ("episodes", "samples", "success of a sample", "of the best verdict", "of any", "gain of the choice")
    texts = (
        f"{len(success)}",
        f"{success.shape[1]}",
        *(f"{100 * share:.0f} %" for share in shares),
        points_text(paired),
    )
    shown = "none" if least is None else f"{100 * least:.0f} points"
    return table([*head, "least gain that would be shown"], [[*texts, shown]])


def sections(study: Path, jobs: int, observer: RunObserver) -> Iterator[str]:
    """Yield the sections of docs/worldmodel.md that follow from the rows and videos of a study."""
    runs = read_runs(study)
    samples = runs.pop(SAMPLES, None)
    transfer = runs.pop(TRANSFER, None)
    trainings = {name: own for name, own in runs.items() if name.startswith(LEARNED)}
    cells = make_cells(trainings, compare_clips(study, trainings, jobs, observer))
    yield section("Success", success_lines(runs), gain_text(runs), transfer_text(transfer) if transfer else "")
    one_sided = ", ".join(f"{cell.training} {cell.task}" for cell in cells if not cell.is_mixed)
    yield section(
        "Numbers beside success", correlation_lines(cells), f"All or none succeed in: {one_sided}." if one_sided else ""
    )
    if samples:
        yield section("Choice by the verdict", best_lines(study / SAMPLES))
