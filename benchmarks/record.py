"""Results of benchmarks as files: figures, machine and revision; comparison with the results before; their pages."""

import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.markdown import replace_section, table
from kinebench_drake.environment.precision import network_precision
from kinebench_drake.errors import InputError
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import read_json, write_json
from kinebench_drake.results.provenance import host

ROOT = Path(__file__).parents[1]
RESULTS = Path("benchmarks/results")
"""Folder of the result files."""
PAGES = {
    **dict.fromkeys(("accuracy", "robustness"), Path("docs/results.md")),
    **dict.fromkeys(("ik", "audit", "simulation", "throughput", "scale"), Path("docs/benchmarks.md")),
}
"""Page of each benchmark, in the order in which they are measured."""
SLOWER = 1.1
"""Ratio to the result before from which a figure is listed as worse."""


def current_revision() -> str:
    """Return the name of the revision checked out, -dirty if files differ; "unknown" without a repository."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--abbrev=12", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def machine_text() -> str:
    """Return processor, cores and precision of the networks, such as "AMD EPYC (2 cores, networks in bfloat16)"."""
    machine = host()
    return f"{machine['cpu']} ({machine['cores']} cores, networks in {network_precision().value})"


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkRecord:
    """Result of one benchmark."""

    name: str
    """Command: `python -m benchmarks NAME`."""
    figures: Mapping[str, float]
    """Costs by name with unit: of all of them less is better."""
    section: str
    """Section of its page (`PAGES`)."""
    machine: Mapping[str, Any]
    revision: str
    """Commit that was checked out, -dirty if files differed from it."""

    @classmethod
    def of(cls, name: str, figures: Mapping[str, float], section: str) -> "BenchmarkRecord":
        """Return the record of a result just measured here."""
        return cls(
            name=name,
            figures=figures,
            section=section,
            machine=host(),
            revision=current_revision(),
        )

    @classmethod
    def read(cls, name: str, folder: Path = RESULTS) -> "BenchmarkRecord | None":
        """Read a record; None if there is none.

        Raises:
            InputError: the file is damaged.
        """
        path = folder / f"{name}.json"
        try:
            return cls(**read_json(path))  # type: ignore[arg-type]
        except FileNotFoundError:
            return None
        except (OSError, TypeError, ValueError) as error:
            raise InputError(f"{path}: is no result of a benchmark ({error})") from None

    def write(self, folder: Path = RESULTS) -> Path:
        """Write `NAME.json`."""
        path = folder / f"{self.name}.json"
        write_json(path, asdict(self))
        return path


def compare_records(before: BenchmarkRecord, now: BenchmarkRecord) -> Iterator[str]:
    """Describe what became worse since an earlier record, and by how much; ratios above 1 are worse."""
    if before.machine != now.machine:
        yield f"not compared with the result of {before.revision}, which is of another machine"
        return
    shared = [name for name in now.figures if before.figures.get(name, 0.0) > 0.0]
    ratios = {name: now.figures[name] / before.figures[name] for name in shared}
    worse = sorted((name for name in ratios if ratios[name] >= SLOWER), key=lambda name: -ratios[name])
    yield f"{len(worse)} of {len(shared)} figures are worse than at {before.revision} by {SLOWER - 1.0:.0%} or more"
    if worse:
        rows = [[n, f"{before.figures[n]:.4g}", f"{now.figures[n]:.4g}", f"{ratios[n]:.2f}"] for n in worse]
        yield from table(("figure", "before", "now", "ratio"), rows)


def write_pages(folder: Path = RESULTS) -> Iterator[str]:
    """Write the section of each record, with its revision, into its page; yields a line for each benchmark."""
    for name, page in PAGES.items():
        record = BenchmarkRecord.read(name, folder)
        if record is None:
            yield f"{name}: no result"
            continue
        section = f"{record.section}\n\nRevision {record.revision}."
        write_atomically(page, replace_section(page.read_text(), section).encode())
        yield f"{name}: {page}, measured at {record.revision}"
