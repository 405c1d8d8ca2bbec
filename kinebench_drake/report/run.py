"""Finished output folders of runs, for pages about one or several of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.io.jsonl import Json, as_object, intern_text, read_json
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import RESULTS, SAMPLES, read_rows, require_output

_VERSIONS = ("schema_version", "suite_version")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One finished output folder."""

    path: Path
    rows: tuple[SampleRow, ...]
    """Samples, sorted by id."""
    results: Mapping[str, Json]
    """Content of `results.json`."""

    @property
    def name(self) -> str:
        """Last component of the path."""
        return self.path.resolve().name

    @property
    def kind(self) -> str:
        """Kind of run: score, ground, audit or suite."""
        return str(self.results.get("kind"))

    @property
    def config(self) -> Mapping[str, Json]:
        """Configuration of the run."""
        return cast(Mapping[str, Json], as_object(self.results.get("config")))

    @property
    def tags(self) -> Mapping[str, str]:
        """Labels of the user."""
        return {key: str(value) for key, value in as_object(self.results.get("tags")).items()}

    @property
    def planned(self) -> int | None:
        """Samples of the whole run, ignoring shards and limits; None if unknown."""
        planned = self.results.get("samples_found")
        return planned if isinstance(planned, int) else None


def read_runs(paths: Sequence[Path]) -> list[Run]:
    """Read finished output folders.

    Raises:
        UsageError: there is none, one is named twice, is broken, unfinished or empty, or they have different schema or
            suite versions.
    """
    if not paths:
        raise UsageError("no folder named, expected output folders of runs")
    for k, path in enumerate(paths):
        if path.resolve() in {other.resolve() for other in paths[:k]}:
            raise UsageError(f"{path}: named twice; its samples would count twice")
    runs = [_read_run(path) for path in paths]
    for run in runs[1:]:
        for name in _VERSIONS:
            one = runs[0].results.get(name)
            other = run.results.get(name)
            if one != other:
                raise UsageError(
                    f"{runs[0].path} has {name} {one} and {run.path} {other}: their numbers cannot be compared; "
                    "run one of them again with the other's version"
                )
    return runs


def _read_run(path: Path) -> Run:
    """Read one finished output folder."""
    require_output(path)
    if not (path / RESULTS).is_file():
        raise UsageError(f"{path}: holds no {RESULTS}; run the same command again to finish it")
    try:
        rows = read_rows(path)
        results = read_results(path)
    except InputError as error:
        raise UsageError(str(error)) from None
    if not rows:
        raise UsageError(f"{path}: holds no sample")
    return Run(path=path, rows=tuple(rows[id] for id in sorted(rows)), results=results)


def read_results(out: Path) -> Mapping[str, Json]:
    """Read `results.json` of an output folder; empty for a run that was interrupted.

    Raises:
        InputError: the file is damaged.
    """
    try:
        data = read_json(out / RESULTS)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(f"{out / RESULTS}: not JSON ({cause(error)})") from None
    return cast(Mapping[str, Json], intern_text(data)) if isinstance(data, dict) else {}


def check_page_folder(out: Path) -> None:
    """Check that a page about runs may be written to a folder.

    Raises:
        UsageError: it is the output folder of a run.
    """
    if (out / SAMPLES).exists():
        raise UsageError(
            f"$out {out}: is the output folder of a run, whose own report it would overwrite; name another"
        )
