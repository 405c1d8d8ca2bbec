"""Comparison of the models of score, audit and ground runs: numbers on paired samples, as text, page and files."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from kinebench_drake.errors import UsageError, count_noun
from kinebench_drake.report.number import (
    NUMBERS,
    ModelComparison,
    RowPair,
    compare_numbers,
    tabulate_numbers,
)
from kinebench_drake.report.page_parts import choose_listed, list_links, write_parts
from kinebench_drake.report.run import Run
from kinebench_drake.report.table import Table, make_listing
from kinebench_drake.report.verdict import GOOD_VERDICTS, verdict_of
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.results.row import SampleRow

_NOUNS = {"suite": "episodes", "audit": "trajectories"}
"""Samples by the kind of their run, where they are no videos."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelSample:
    """One sample of one model."""

    model: str
    """Label of the model: its name, else the folder's; followed by [folder] where several folders need it."""
    run: Run
    row: SampleRow


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelPair:
    """Two models and the rows of their shared samples."""

    first: str
    second: str
    key: str
    """What identifies a sample, a key of KEYS."""
    samples: tuple[int, int]
    """Samples of the first and of the second model."""
    pairs: tuple[RowPair, ...]

    @property
    def title(self) -> str:
        """The models, the shared samples and how they are paired, in one line."""
        shared = count_noun(len(self.pairs), "shared sample")
        counts = " and ".join(map(str, self.samples))
        return f"{self.first} - {self.second}: {shared} (of {counts}), paired by {self.key}"


def compare_samples(runs: Sequence[Run]) -> ModelComparison:
    """Compare the models of runs of one kind, two by two, on the samples that they share.

    Raises:
        UsageError: the runs are of different kinds, or no two models share a sample.
    """
    for run in runs[1:]:
        if run.kind != runs[0].kind:
            one, other = (f"{_NOUNS.get(r.kind, 'videos')} of `{r.kind}` in {r.path}" for r in (runs[0], run))
            raise UsageError(f"{one} and {other} cannot be compared: name runs of one kind")
    samples = label_samples(runs)
    pairs = pair_models(samples)
    numbers = [
        c for pair in pairs for c in compare_numbers([((a,), (b,)) for a, b in pair.pairs], pair.first, pair.second)
    ]
    warnings = list(list_differences(pairs, runs))
    pairings = [pair.title for pair in pairs]

    def write_page(out: Path, leads: Sequence[str]) -> Path:
        listed = choose_listed(samples, lambda s: s.model, lambda s: verdict_of(s.row) in GOOD_VERDICTS)
        return write_parts(
            "comparison_page.html.j2",
            "Comparison of models",
            out,
            [tabulate_numbers(numbers)],
            tabulate_samples(samples),
            runs=runs,
            leads=leads,
            pairings=pairings,
            warnings=warnings,
            samples=len(samples),
            lines=[(s, list_links(s.run.path, s.row, out)) for s in listed],
        )

    return ModelComparison(
        rows=_group_rows(samples), numbers=numbers, pairings=pairings, warnings=warnings, write_page=write_page
    )


def _group_rows(samples: Sequence[ModelSample]) -> dict[str, list[SampleRow]]:
    return {model: [s.row for s in own] for model, own in group_by(samples, lambda s: s.model).items()}


def tabulate_samples(samples: Sequence[ModelSample]) -> Table:
    """Build the table of all samples, one per row, for samples.csv."""
    keys = ("model", "folder", "id", "video", "task", "seed", "status", "reason", "verdict", *NUMBERS)
    rows = (
        (
            *(s.model, s.run.name, s.row.id, s.row.video, s.row.task),
            s.row.seed,
            *(s.row.status.value, s.row.reason, verdict_of(s.row)),
            *(s.row.number(name) for name in NUMBERS),
        )
        for s in samples
    )
    return make_listing("samples", keys, rows)


KEYS: Mapping[str, Callable[[SampleRow], Hashable | None]] = {
    "task and seed": lambda row: None if row.task is None or row.seed is None else (row.task, row.seed),
    "id": lambda row: row.id,
    "file name": lambda row: Path(row.video).stem or None,
}
"""Identities of a sample, the first that all samples of two models have, once each, is used."""


def label_samples(runs: Sequence[Run]) -> list[ModelSample]:
    """List the samples of all runs, model by model in the order of the runs.

    Folders of one model are pooled, such as shards, unless their tags or settings differ or they hold the same samples:
    then the folder's name is appended to the model's.
    """
    names = _folder_names(runs)
    owners: dict[str, list[Run]] = {}
    for run in runs:
        for model in dict.fromkeys(_model_of(row, names[run.path]) for row in run.rows):
            owners.setdefault(model, []).append(run)
    apart = {model for model, own in owners.items() if any(_differ(a, b, model) for a, b in combinations(own, 2))}
    samples = []
    for run in runs:
        for row in run.rows:
            model = _model_of(row, names[run.path])
            label = f"{model} [{names[run.path]}]" if model in apart else model
            samples.append(ModelSample(model=label, run=run, row=row))
    order = {model: k for k, model in enumerate(dict.fromkeys(sample.model for sample in samples))}
    return sorted(samples, key=lambda sample: order[sample.model])


def _model_of(row: SampleRow, folder: str) -> str:
    return row.model or folder


def _folder_names(runs: Sequence[Run]) -> dict[Path, str]:
    """Name each folder by the end of its path, as long as it takes to tell them apart."""
    paths = {run.path: run.path.resolve().parts for run in runs}
    length = 1
    while len({parts[-length:] for parts in paths.values()}) < len(paths):
        length += 1
    return {path: "/".join(parts[-length:]) for path, parts in paths.items()}


def _differ(a: Run, b: Run, model: str) -> bool:
    """Return whether two runs of one model are different runs, not parts of one."""
    if a.tags != b.tags or _settings(a) != _settings(b):
        return True
    rows = [[row for row in run.rows if row.model in (None, model)] for run in (a, b)]
    return any(
        {key(row) for row in rows[0]} & {key(row) for row in rows[1]} - {None}
        for key in (KEYS["task and seed"], KEYS["id"])
    )


def _settings(run: Run) -> dict[str, object]:
    """Return the configuration without what differs among shards or machines."""
    free = {"source", "limit", "shard", "jobs", "engine", "replays", "overlay", "model", "task"}
    return {name: value for name, value in run.config.items() if name not in free}


def pair_models(samples: Sequence[ModelSample]) -> list[ModelPair]:
    """Pair the samples of every two models.

    Raises:
        UsageError: there are not two models, no two share a sample, or two paired samples are of different tasks.
    """
    models = _group_rows(samples)
    if len(models) < 2:
        raise UsageError(
            f"all samples are of one model, {next(iter(models))}: there is nothing to compare; name folders of two "
            "models, or name the models with `model` in the manifest or $model"
        )
    pairs = [pair for one, two in combinations(models, 2) if (pair := _pair(one, two, models[one], models[two]))]
    if not pairs:
        one, two = (rows[0].id for rows in list(models.values())[:2])
        raise UsageError(
            f"no two of {', '.join(models)} share a sample: ids and file names differ (such as {one!r} and {two!r}), "
            "and not all samples have a task and a seed; name both in the manifest, or give the files equal names"
        )
    return pairs


def _pair(first: str, second: str, ones: Sequence[SampleRow], twos: Sequence[SampleRow]) -> ModelPair | None:
    """Pair the samples of two models by the first key that identifies them; None if they share none."""
    for name, key in KEYS.items():
        one, two = ({key(row): row for row in rows} for rows in (ones, twos))
        unique = len(one) == len(ones) and len(two) == len(twos) and None not in one and None not in two
        shared = [k for k in one if k in two]
        if unique and shared:
            pairs = tuple((one[k], two[k]) for k in shared)
            for a, b in pairs:
                _check_same(a, b, first, second)
            return ModelPair(first=first, second=second, key=name, samples=(len(ones), len(twos)), pairs=pairs)
    return None


def _check_same(a: SampleRow, b: SampleRow, first: str, second: str) -> None:
    for name, one, two in (("task", a.task, b.task), ("seed", a.seed, b.seed)):
        if one is not None and two is not None and one != two:
            raise UsageError(
                f"{a.id} has {name} {one} in {first} and {two} in {second}: they are different samples; name task and "
                "seed of all samples in the manifest, or give the files of different samples different names"
            )


def list_differences(pairs: Sequence[ModelPair], runs: Sequence[Run]) -> Iterator[str]:
    """Describe what else differs between paired samples: frame periods, cameras, code and weights, robot."""
    for pair in pairs:
        for name, label, effect in (
            ("frame_period_s", "frame periods", "times, speeds and smoothness are not comparable"),
            ("camera_source", "sources of the camera", "poses may differ for that reason alone"),
            ("judged", "judged columns", "a pose track is feasible by any posture, joint angles as they are"),
        ):
            values = [(getattr(a, name), getattr(b, name)) for a, b in pair.pairs]
            if unequal := [(one, two) for one, two in values if None not in (one, two) and one != two]:
                one, two = (f"{v:.4g}" if isinstance(v, float) else v for v in unequal[0])
                yield (
                    f"{label} of {pair.first} and {pair.second} differ in {len(unequal)} of "
                    f"{count_noun(len(values), 'shared sample')} (such as {one} and {two}): {effect}"
                )
    for name in ("code_sha256", "weights_sha256"):
        if len({str(run.results.get(name)) for run in runs}) > 1:
            yield f"the runs differ in {name}: small differences may be those of the versions; run all with one version"
    for name in ("robot", "robot_id", "table_height_m"):
        if len({str(run.config.get(name)) for run in runs}) > 1:
            yield f"the runs were judged with different {name}: {', '.join(str(run.config.get(name)) for run in runs)}"
