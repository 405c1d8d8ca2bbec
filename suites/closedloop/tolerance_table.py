"""Success under graded error as a table."""

from collections.abc import Iterator, Sequence
from typing import Any

from kinebench_drake.suites.closedloop.tolerance import GRADES, Attempt, Error, Grade
from kinebench_drake.suites.trial import interval

_UNITS = {Error.BIAS: (1000.0, "mm"), Error.JITTER: (1000.0, "mm"), Error.FINGERS: (1.0, "frames")}


def tasks_of(attempts: Sequence[Attempt]) -> list[str]:
    """Tasks, in their order."""
    return list(dict.fromkeys(a.episode.task for a in attempts))


def grades_of(attempts: Sequence[Attempt], error: Error) -> list[Grade]:
    """Sizes of an error that were tried, in rising order, without error among them; none if it was not."""
    exact = Grade(error=None, size=0.0)
    tried = [Grade(error=error, size=size) for size in GRADES[error]]
    tried = [grade for grade in tried if any(a.grade == grade for a in attempts)]
    return sorted([exact, *tried], key=lambda grade: grade.size) if tried else []


def rate(attempts: Sequence[Attempt], grade: Grade, task: str | None = None) -> tuple[int, int]:
    """Successes and attempts of a grade, of one task or of all."""
    chosen = [a for a in attempts if a.grade == grade and task in (None, a.episode.task)]
    return sum(a.success for a in chosen), len(chosen)


def label(error: Error, grade: Grade) -> str:
    """A size in its unit, such as "15 mm"."""
    factor, unit = _UNITS[error]
    return f"{grade.size * factor:g} {unit}"


def table_lines(attempts: Sequence[Attempt]) -> Iterator[str]:
    """The tables to print, one for each error."""
    for error in Error:
        tried = grades_of(attempts, error)
        if not tried:
            continue
        yield f"success under {error.value.replace('_', ' ')}"
        yield f"{'':20}" + "".join(f"{label(error, grade):>11}" for grade in tried)
        for task in (*tasks_of(attempts), None):
            cells = [rate(attempts, grade, task) for grade in tried]
            yield f"{task or 'all':20}" + "".join(f"{good:>7}/{n:<3}" for good, n in cells)
        bounds = [interval(*rate(attempts, grade)) for grade in tried]
        yield f"{'95 % interval':20}" + "".join(f"{f'{low:.0%}-{high:.0%}':>11}" for low, high in bounds)
        yield ""


def table_json(attempts: Sequence[Attempt]) -> dict[str, Any]:
    """Every attempt, as JSON."""
    return {
        "attempts": [
            {
                "task": a.episode.task,
                "seed": a.episode.seed,
                "error": None if a.grade.error is None else a.grade.error.value,
                "size": a.grade.size,
                "success": a.success,
                "progress": a.progress,
                "reason": a.reason,
            }
            for a in attempts
        ]
    }
