"""Tables and figure of the validity study, as sections of docs/validity.md."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.faults.fault import unit_of
from benchmarks.markdown import section, table
from benchmarks.validity import SPLIT, SUITE, ValidityTrial
from benchmarks.validity_response import (
    FALSE_DISCOVERIES,
    NUMBERS,
    SEPARATION,
    Study,
    Verdict,
)
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.figure import new_figure, save
from kinebench_drake.io.jsonl import Json
from kinebench_drake.stats import sign_test, wilson

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE = "validity_separation.png"
"""Figure beside the page."""
RESPONSES = "validity_responses.csv"
"""Changes of each number with each fault and size, beside the page."""


def write_report(trials: Sequence[ValidityTrial], source: Mapping[str, Json], folder: Path) -> list[str]:
    """Write the figure and the table of responses into a folder, and return the sections of the page."""
    study = Study(trials)
    save(draw_separation(study), folder / FIGURE)
    write_atomically(folder / RESPONSES, _responses(study).encode())
    return [
        section("Episodes and faults", _fault_lines(study, source)),
        section("Which number responds to which fault", _verdict_lines(study)),
        section(
            "Dose and response",
            f"[{RESPONSES}]({RESPONSES}) has each mean change against the clean video of the same episode, where both "
            "have the number, with its bootstrap interval over episodes. It counts the episodes in which the number "
            "gets worse, better and null (null is the worst value). `distinct`: distinct from chance (sign test, 5 % "
            "false discoveries among all rows).",
        ),
    ]


def _fault_lines(study: Study, source: Mapping[str, Json]) -> Iterator[str]:
    tasks = {t.task for t in study.clean.values()}
    yield (
        f"{len(study.clean)} episodes of {len(tasks)} tasks (suite {SUITE}, {SPLIT}), {len(study.trials)} videos, "
        f"{min(map(len, study.faulty.values()))} to {max(map(len, study.faulty.values()))} a size, at "
        f"revision {source['revision']} with the weights {source['weights']}. Wilson's 95 % intervals of these shares "
        f"reach {_reach(min(map(len, study.faulty.values()))):.0%} at most to either side."
    )
    yield ""
    yield from table(
        ("fault", "sizes", "success in closed loop", "executable", "fault named by the detectors"),
        _fault_rows(study),
    )


def _fault_rows(study: Study) -> Iterator[list[str]]:
    clean = list(study.clean.values())
    yield ["none", "", _share(_successes(clean), len(clean)), _executable(clean), ""]
    for kind in study.kinds:
        groups = [list(study.faulty[grade].values()) for grade in study.grades(kind)]
        columns = [
            [_share(_successes(trials), len(trials)) for trials in groups],
            [_executable(trials) for trials in groups],
            [_share(sum(kind.value in t.anomalies for t in trials), len(trials)) for trials in groups],
        ]
        sizes = ", ".join(grade.number for grade in study.grades(kind))
        yield [f"`{kind.value}`", f"{sizes} {unit_of(kind)}", *(", ".join(cells) for cells in columns)]


def _reach(n: int) -> float:
    """Return the longest side of the Wilson intervals of all shares of n."""
    return max(abs(edge - hits / n) for hits in range(n + 1) for edge in wilson(hits, n))


def _successes(trials: Sequence[ValidityTrial]) -> int:
    return sum(t.success for t in trials)


def _executable(trials: Sequence[ValidityTrial]) -> str:
    return _share(sum(t.numbers["executable"] is True for t in trials), len(trials))


def _share(hits: int, n: int) -> str:
    return f"{hits / n:.0%}"


def _verdict_lines(study: Study) -> Iterator[str]:
    yield f"![Area under the ROC curve of every number, fault and size]({FIGURE})"
    yield ""
    if (p := sign_test(len(study.clean), 0)) > FALSE_DISCOVERIES:
        yield (
            f"Preliminary, without verdicts: {len(study.clean)} episodes cannot show that a response is distinct from "
            f"chance (p = {p:.2g} at best)."
        )
        return
    yield (
        f"Numbers **separate** from an area of {SEPARATION:g} on, at the greatest size. Bold in the figure: responds."
    )
    yield ""
    yield from table(("fault", "**separates**"), [[f"`{k.value}`", _separating(study, k)] for k in study.kinds])
    yield ""
    wrong = [(name, kind) for name in NUMBERS for kind in study.kinds if study.verdict(name, kind) is Verdict.IMPROVES]
    if not wrong:
        yield "No number improves under any fault by more than chance explains."
        return
    yield "Numbers that improve under a fault, and are **not for it**:"
    yield ""
    yield from table(
        ("number", "fault", "size", "better in", "mean change of all"),
        (row for name, kind in wrong for row in _improvements(study, name, kind)),
    )


def _improvements(study: Study, name: str, kind: AnomalyKind) -> Iterator[list[str]]:
    for grade in study.grades(kind):
        r = study.responses[name, grade]
        if study.is_significant(name, grade) and r.better > r.worse:
            change = "" if r.change is None else f"{r.change.value:+.2g}"
            yield [f"`{name}`", f"`{kind.value}`", grade.label, f"{r.better} of {r.episodes} videos", change]


def _separating(study: Study, kind: AnomalyKind) -> str:
    """Return the numbers that separate videos with a kind of fault from clean ones."""
    separating = [f"`{name}`" for name in NUMBERS if study.verdict(name, kind) is Verdict.SEPARATES]
    others = [f"`{name}`" for name in NUMBERS if f"`{name}`" not in separating]
    return f"all but {', '.join(others)}" if len(separating) > 2 * len(others) else ", ".join(separating)


def _responses(study: Study) -> str:
    """Return the responses as csv; empty cells: no change where the number is null, no interval of equal changes."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("fault", "size", "number", "change", "low", "high", "worse", "better", "null", "distinct"))
    for kind in study.kinds:
        for grade in study.grades(kind):
            for name in NUMBERS:
                r = study.responses[name, grade]
                change = (
                    ["", "", ""]
                    if r.change is None
                    else [_short(x) for x in (r.change.value, r.change.low, r.change.high)]
                )
                counts = [r.worse, r.better, r.nulls, int(study.is_significant(name, grade))]
                writer.writerow([kind.value, grade.label, name, *change, *counts])
    return text.getvalue()


def _short(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else ""


def draw_separation(study: Study) -> "Figure":
    """Draw the area under the ROC curve of every number (rows) at every grade (columns); a frame: improves."""
    from matplotlib.patches import Rectangle

    grades = [grade for kind in study.kinds for grade in study.grades(kind)]
    figure, axes = new_figure(3.2 + 0.5 * len(grades), 1.8 + 0.29 * len(NUMBERS))
    ax = axes[0, 0]
    ax.grid(False)
    area = np.array([[study.responses[name, g].area.value for g in grades] for name in NUMBERS])
    image = ax.imshow(area, cmap="PuOr_r", vmin=0.0, vmax=1.0, aspect="auto")
    for i, name in enumerate(NUMBERS):
        for j, grade in enumerate(grades):
            response = study.responses[name, grade]
            significant = study.is_significant(name, grade)
            dark = abs(area[i, j] - 0.5) > 0.35
            style = {"color": "white" if dark else "black", "fontweight": "bold" if significant else "normal"}
            ax.text(j, i, f"{area[i, j]:.2f}", ha="center", va="center", fontsize=7, **style)
            if significant and response.better > response.worse:
                ax.add_patch(
                    Rectangle((j - 0.46, i - 0.46), 0.92, 0.92, fill=False, edgecolor="#c00000", linewidth=2.0)
                )
    ax.set_yticks(range(len(NUMBERS)), NUMBERS, fontsize=8)
    ax.set_xticks(range(len(grades)), [grade.number for grade in grades], fontsize=8)
    start = 0
    for kind in study.kinds:
        n = len(study.grades(kind))
        ax.text(start + (n - 1) / 2, -0.7, _column(kind), ha="center", va="bottom", fontsize=8)
        if start:
            ax.axvline(start - 0.5, color="white", linewidth=3)
        start += n
    bar = figure.colorbar(image, ax=ax, shrink=0.5, pad=0.02)
    bar.set_label("area under the ROC curve, faulty against clean videos", fontsize=8)
    figure.supxlabel(
        "bold: distinct from chance in pairs with the clean video; red frame: better than the clean video", fontsize=8
    )
    return figure


def _column(kind: AnomalyKind) -> str:
    return f"{kind.value.replace('_', ' ')}\n[{unit_of(kind)}]"
