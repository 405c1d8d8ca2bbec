"""Verdicts of the same videos with the networks in float32 and in bfloat16: which flip, and by which measure."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.markdown import percent, section, table
from benchmarks.process import run_program
from kinebench_drake.environment.precision import PRECISION_VARIABLE, Precision
from kinebench_drake.errors import KinebenchError
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import read_rows

Rows = Mapping[str, SampleRow]


@dataclass(frozen=True, slots=True, kw_only=True)
class Flip:
    """Verdict of a clip that differs between the two precisions."""

    id: str
    name: str
    """Verdict: "feasible", "executable", "trust", or a kind of anomaly or violation."""
    values: tuple[Json, Json]
    """Verdict in float32 and in bfloat16."""
    measure: str
    """What decides, in both, with its bound."""

    @property
    def is_contradiction(self) -> bool:
        """True if one precision says yes and the other no."""
        return self.values in ((True, False), (False, True))


def score_both(
    folder: Path, work: Path, jobs: int, log: Callable[[str], None], limit: int | None = None
) -> tuple[Rows, Rows]:
    """Score a folder or manifest, or its first `limit` clips, in both precisions; what is scored already is kept.

    Raises:
        KinebenchError: a run failed.
    """
    rows = []
    for precision in Precision:
        out = work / precision.value
        log(f"{folder}: {precision.value}")
        most = [] if limit is None else ["--limit", str(limit)]
        run_program(
            ["score", str(folder), "--out", str(out), "--replays", "0", "--jobs", str(jobs), *most],
            environment={PRECISION_VARIABLE: precision.value},
        )
        rows.append(read_rows(out))
    return rows[0], rows[1]


def find_flips(single: Rows, half: Rows) -> Iterator[Flip]:
    """Yield the verdicts that differ between rows of float32 and of bfloat16.

    Raises:
        KinebenchError: they are of different clips.
    """
    if single.keys() != half.keys():
        raise KinebenchError(f"{len(single)} clips in float32, {len(half)} in bfloat16; they must be the same")
    for id in sorted(single):
        pair = single[id], half[id]
        verdicts = [_verdicts(row) for row in pair]
        for name in sorted(verdicts[0].keys() | verdicts[1].keys()):
            values = verdicts[0].get(name, False), verdicts[1].get(name, False)
            if values[0] != values[1]:
                yield Flip(id=id, name=name, values=values, measure=_measure(name, pair))


def _verdicts(row: SampleRow) -> dict[str, Json]:
    """Return the verdicts of a row by name: True, False or None; the level of trust as text."""
    return {
        "feasible": row.feasible,
        "executable": row.executable,
        "trust": None if row.trust is None else row.trust.level,
        **dict.fromkeys(row.anomalies_open or ()),
        **dict.fromkeys((anomaly.kind.value for anomaly in row.anomalies), True),
        **dict.fromkeys((violation.kind.value for violation in row.violations), True),
    }


def _measure(name: str, pair: Sequence[SampleRow]) -> str:
    """Describe the measure behind a verdict in both rows, with its bound."""
    scores = [(row.anomaly_scores or {}).get(name) for row in pair]
    if all(isinstance(score, float) for score in scores):
        return _numbers("score", scores, 1.0)
    violations = [v for row in pair for v in row.violations if name in ("feasible", v.kind.value)]
    if violations:
        first = violations[0]
        return f"{first.kind.value} {_text(first.value)}, limit {_text(first.limit)}"
    if name == "trust":
        return _numbers("agreement of the arm", [row.camera_agreement for row in pair])
    return " / ".join("; ".join(row.executable_reasons) or "nothing" for row in pair)


def _numbers(name: str, values: Sequence[object], bound: float | None = None) -> str:
    text = f"{name} {_text(values[0])} / {_text(values[1])}"
    if isinstance(values[0], float) and isinstance(values[1], float):
        text += f", difference {abs(values[0] - values[1]):.3g}"
    return text if bound is None else f"{text}, bound {bound:g}"


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "none" if value is None else str(value)


def report(results: Mapping[str, tuple[Rows, Rows]]) -> tuple[str, int]:
    """Return the section on the flips of each folder's rows, and the number of contradictions."""
    flips = {name: list(find_flips(*rows)) for name, rows in results.items()}
    summary = []
    for name, (single, half) in results.items():
        own = flips[name]
        executable = [flip for flip in own if flip.name == "executable"]
        decided = [sum(row.executable is not None for row in rows.values()) for rows in (single, half)]
        summary.append(
            [
                name,
                str(len(single)),
                str(sum(flip.is_contradiction for flip in own)),
                f"{len(executable)} ({percent(len(executable) / len(single))})",
                str(len(own)),
                f"{decided[0]} / {decided[1]}",
            ]
        )
    head = ("videos", "clips", "true against false", "`executable` to or from null", "any verdict", "decided")
    rows = [
        [flip.id, flip.name, f"{_text(flip.values[0])} / {_text(flip.values[1])}", flip.measure]
        for own in flips.values()
        for flip in own
    ]
    text = section(
        "Number formats",
        "Verdicts with the networks in float32 and in bfloat16 (float32 / bfloat16).",
        table(head, summary),
        *([table(("clip", "verdict", "values", "measure"), rows)] if rows else []),
    )
    return text, sum(flip.is_contradiction for own in flips.values() for flip in own)
