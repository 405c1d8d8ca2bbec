"""Tables and figures of the validity study, as sections of docs/validity.md."""

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.faults.fault import unit_of
from benchmarks.markdown import section, table
from benchmarks.validity import SPLIT, SUITE, ValidityTrial
from benchmarks.validity_response import (
    FALSE_DISCOVERIES,
    NUMBERS,
    SEPARATION,
    Response,
    Study,
    SuccessCorrelation,
    Verdict,
    correlate,
)
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.figure import POSITION, ROTATION, new_figure, save
from kinebench_drake.io.jsonl import Json
from kinebench_drake.stats import IntervalEstimate, sign_test, wilson

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES = (
    *("executable", "feasible", "tracked_fraction", "ik_success_rate", "sparc", "sparc_rotation", "ldlj"),
    *("manipulability_mean", "manipulability_min", "manipulability_cost_mean", "joint_limit_margin_min"),
    *("slowdown_min", "arm_consistency_px", "camera_motion_px"),
)
"""Numbers whose dose-response curves are drawn."""
_LEAST_RANGE = 1e-9  # of an axis
_GREATEST = 3
"""Number of coefficients in the table; the figure has all."""
FIGURES = ("validity_separation.png", "validity_response.png", "validity_success.png")
"""Figures beside the page."""
RESPONSES = "validity_responses.csv"
"""Changes of each number with each fault and size, beside the page."""


def write_report(trials: Sequence[ValidityTrial], source: Mapping[str, Json], folder: Path) -> list[str]:
    """Write the figures and the table of responses into a folder, and return the sections of the page."""
    study = Study(trials)
    correlations = {name: correlate(study, name) for name in NUMBERS}
    drawings: Sequence[Callable[[], Figure]] = (
        lambda: draw_separation(study),
        lambda: draw_responses(study),
        lambda: draw_success(study, correlations),
    )
    for name, draw in zip(FIGURES, drawings, strict=True):
        save(draw(), folder / name)
    write_atomically(folder / RESPONSES, _responses(study).encode())
    return [
        section("Episodes and faults", _fault_lines(study, source)),
        section("Which number responds to which fault", _verdict_lines(study)),
        section(
            "Dose and response",
            f"![Change of the numbers with the size of each fault]({FIGURES[1]})",
            f"[{RESPONSES}]({RESPONSES}) has each mean change against the clean video of the same episode, where both "
            "have the number, with its bootstrap interval over episodes. It counts the episodes in which the number "
            "gets worse, better and null (null is the worst value). `distinct`: distinct from chance (sign test, 5 % "
            "false discoveries among all rows).",
        ),
        section("Success in closed loop", _success_lines(correlations)),
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
    yield f"![Area under the ROC curve of every number, fault and size]({FIGURES[0]})"
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


def _estimate(x: IntervalEstimate) -> str:
    return f"{x.value:.2f} [{x.low:.2f}, {x.high:.2f}]" if np.isfinite(x.low) else f"{x.value:.2f}"


def _success_lines(correlations: Mapping[str, SuccessCorrelation]) -> Iterator[str]:
    yield f"![Success by fault, and rank correlation of each number with success]({FIGURES[2]})"
    yield ""
    yield (
        "Spearman's coefficient of each number with success, of the ranks without the differences between episodes. "
        "Positive: better values go with success. The greatest, with bootstrap intervals over episodes:"
    )
    yield ""
    ordered = sorted(correlations.items(), key=lambda item: -np.nan_to_num(item[1].within.value, nan=-2.0))
    rows = [[f"`{name}`", _estimate(c.within)] for name, c in ordered[:_GREATEST]]
    yield from table(("number", "coefficient"), rows)


def draw_separation(study: Study) -> "Figure":
    """Draw the area under the ROC curve of every number (rows) at every grade (columns); a frame: improves."""
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
                frame = {"fill": False, "edgecolor": "#c00000", "linewidth": 2.0}
                ax.add_patch(_rectangle(j, i, frame))
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


def _rectangle(column: int, row: int, style: Mapping[str, object]) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((column - 0.46, row - 0.46), 0.92, 0.92, **style)  # type: ignore[arg-type]


def draw_responses(study: Study) -> "Figure":
    """Draw the mean change of numbers (rows) with the size of each fault (columns), with intervals."""
    kinds = study.kinds
    figure, axes = new_figure(1.75 * len(kinds) + 1.2, 1.25 * len(CURVES), len(CURVES), len(kinds), sharey="row")
    for row, name in zip(axes, CURVES, strict=True):
        for ax, kind in zip(row, kinds, strict=True):
            grades = study.grades(kind)
            responses = [study.responses[name, grade] for grade in grades]
            color = ROTATION if study.verdict(name, kind) is Verdict.IMPROVES else POSITION
            _draw_curve(ax, responses, color)
            ax.set_xticks(range(len(grades) + 1), ["0", *(grade.number for grade in grades)], fontsize=6)
            ax.set_xlim(-0.3, len(grades) + 0.5)
            ax.tick_params(axis="y", labelsize=6)
            if name == CURVES[0]:
                ax.set_title(_column(kind), fontsize=8)
        if np.ptp(row[0].get_ylim()) < _LEAST_RANGE:  # no change at all
            row[0].set_ylim(-0.05, 0.05)
        row[0].set_ylabel(name.replace("_", "\n", 1), fontsize=7)
    figure.supxlabel(
        "size of the fault; mean change against the clean video, 95 % interval; N null: episodes in which the number "
        "becomes null, not in the mean; orange: better than in the clean video",
        fontsize=8,
    )
    return figure


def _draw_curve(ax: Any, responses: Sequence[Response], color: str) -> None:
    x = [0.0]
    value = [0.0]
    low = [0.0]
    high = [0.0]
    for i, r in enumerate(responses, 1):
        if r.change is not None:
            ends = (r.change.low, r.change.high) if np.isfinite(r.change.low) else (r.change.value, r.change.value)
            x.append(float(i))
            for side, number in zip((value, low, high), (r.change.value, *ends), strict=True):
                side.append(number)
        if r.nulls:
            ax.annotate(
                f"{r.nulls} null", (i, 0.97), xycoords=("data", "axes fraction"), ha="center", va="top", fontsize=5.5
            )
    ax.axhline(0.0, color="#80868c", linewidth=0.6)
    ax.fill_between(x, low, high, color=color, alpha=0.2, linewidth=0)
    ax.plot(x, value, color=color, marker="o", markersize=2.5, linewidth=1.0)


def draw_success(study: Study, correlations: Mapping[str, SuccessCorrelation]) -> "Figure":
    """Draw success by fault and size, and the rank correlation of each number with success, with intervals."""
    figure, axes = new_figure(13.0, 6.4, 1, 2)
    left, right = axes[0]
    labels = list[str]()
    x = 0
    for grade, trials in [(None, study.clean), *((g, study.faulty[g]) for k in study.kinds for g in study.grades(k))]:
        n = len(trials)
        hits = _successes(list(trials.values()))
        low, high = wilson(hits, n)
        color = "#5a9a4a" if grade is None else POSITION
        left.plot([low, high], [x, x], color=color, linewidth=1.6)
        left.plot(hits / n, x, marker="o", color=color, markersize=4)
        labels.append("no fault" if grade is None else f"{grade.kind.value.replace('_', ' ')} {grade.label}")
        x += 1
    left.set_yticks(range(x), labels, fontsize=8)
    left.invert_yaxis()
    left.set_xlim(0.0, 1.02)
    left.set_xlabel("success in closed loop, 95 % interval", fontsize=8)
    ordered = sorted(NUMBERS, key=lambda name: -np.nan_to_num(correlations[name].within.value, nan=-2.0))
    for i, name in enumerate(ordered):
        for estimate, shift, color in (
            (correlations[name].within, -0.15, POSITION),
            (correlations[name].pooled, 0.15, ROTATION),
        ):
            right.plot([estimate.low, estimate.high], [i + shift, i + shift], color=color, linewidth=1.6)
            right.plot(estimate.value, i + shift, marker="o", color=color, markersize=4)
    right.axvline(0.0, color="#80868c", linewidth=0.8)
    right.set_yticks(range(len(ordered)), ordered, fontsize=8)
    right.invert_yaxis()
    right.set_xlabel("rank correlation with success: blue within episodes, orange over all videos", fontsize=8)
    return figure
