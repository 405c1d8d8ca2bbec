"""Quality of anomaly detection: detection rates, areas under the ROC curve, false alarms, with intervals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import norm, rankdata

from benchmarks.faults.fault import GRADES
from benchmarks.perception.anomalies import ClipAnomalies
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.io.figure import FAINT, POSITION, ROTATION, new_figure
from kinebench_drake.stats import IntervalEstimate, wilson

if TYPE_CHECKING:
    from matplotlib.figure import Figure


GOALS = {kind: 0.95 for kind in AnomalyKind} | dict.fromkeys(
    (AnomalyKind.VANISH, AnomalyKind.DUPLICATE, AnomalyKind.TELEPORT), 0.99
)
"""Area under the ROC curve required of each kind, for sizes from its gate on."""


def unit_of(kind: AnomalyKind) -> str:
    """Return the unit in which sizes of a kind are shown."""
    unit = GRADES[kind].unit
    return {"f": "frames", "pc": "%"}.get(unit, unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Share of clips with its 95 % interval."""

    hits: int
    n: int

    @property
    def value(self) -> float:
        """Share; NaN for n = 0."""
        return self.hits / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the Wilson interval; (0, 1) for n = 0."""
        return wilson(self.hits, self.n)


def area(faulty: ArrayLike, clean: ArrayLike) -> IntervalEstimate:
    """Return the area under the ROC curve: P(score of a faulty video > score of a clean one) + P(equal) / 2.

    This is the Mann-Whitney statistic (1947). The interval is Newcombe's method 5 (Statistics in Medicine 25, 2006,
    part 2): the values t that differ from it by no more than 1.96 standard errors V(t)^(1/2), with V(t) =
    t (1 - t) / (m n) (1 + (N - 1) ((1 - t) / (2 - t) + t / (1 + t))), N = (m + n) / 2. Its width stays positive where
    the scores separate all videos.
    """
    faulty = np.asarray(faulty, dtype=np.float64)
    clean = np.asarray(clean, dtype=np.float64)
    m = len(faulty)
    n = len(clean)
    if not m or not n:
        return IntervalEstimate(value=float("nan"), low=0.0, high=1.0)
    ranks = rankdata(np.concatenate([faulty, clean]))
    value = float((ranks[:m].sum() - m * (m + 1) / 2) / (m * n))
    z = float(norm.ppf(0.975))
    more = (m + n) / 2 - 1

    def error(t: float) -> float:
        return z * float(np.sqrt(t * (1 - t) / (m * n) * (1 + more * ((1 - t) / (2 - t) + t / (1 + t)))))

    low = 0.0 if value == 0.0 else float(brentq(lambda t: value - t - error(t), 0.0, value - 1e-12 * (value == 1.0)))
    high = 1.0 if value == 1.0 else float(brentq(lambda t: t - value - error(t), value + 1e-12 * (value == 0.0), 1.0))
    return IntervalEstimate(value=value, low=low, high=high)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnomalyRow:
    """Detection of one kind in one size and form, or in all gated sizes together."""

    kind: AnomalyKind
    form: str
    """Form of the anomaly; empty if the kind has a single form, and for all gated sizes together."""
    size: float | None
    """Size in the unit of the kind; None for all gated sizes together."""
    located: Share
    """Clips in which it is detected in the right frames."""
    named: Share
    """Clips in which it is detected in any frame."""
    area: IntervalEstimate

    @property
    def gated(self) -> bool:
        """True if it must be detected."""
        return self.size is None or self.size >= GRADES[self.kind].gate - 1e-9

    @property
    def label(self) -> str:
        """Size with its unit."""
        return "all gated" if self.size is None else f"{self.size * GRADES[self.kind].factor:g} {unit_of(self.kind)}"


def clean_clips(findings: Sequence[ClipAnomalies]) -> list[ClipAnomalies]:
    """Return the clips without a planted anomaly."""
    return [f for f in findings if f.planted is None]


def rows(findings: Sequence[ClipAnomalies]) -> list[AnomalyRow]:
    """Return a row for each kind, form and size, and after those of a kind a row for its gated sizes together."""
    table = []
    for kind in AnomalyKind:
        members = [f for f in findings if f.planted is not None and f.planted.kind is kind]
        clean = [f.scores[kind] for f in clean_clips(findings)]
        grades = sorted({(f.planted.form, f.planted.size) for f in members if f.planted})
        for form, size in grades:
            group = [f for f in members if f.planted and (f.planted.form, f.planted.size) == (form, size)]
            table.append(_row(kind, form, size, group, clean))
        gated = [f for f in members if f.planted and f.planted.size >= GRADES[kind].gate - 1e-9]
        if gated:
            table.append(_row(kind, "", None, gated, clean))
    return table


def _row(
    kind: AnomalyKind, form: str, size: float | None, group: Sequence[ClipAnomalies], clean: Sequence[float]
) -> AnomalyRow:
    return AnomalyRow(
        kind=kind,
        form=form,
        size=size,
        located=Share(hits=sum(f.is_located for f in group), n=len(group)),
        named=Share(hits=sum(f.is_named for f in group), n=len(group)),
        area=area([f.scores[kind] for f in group], clean),
    )


def alarms(findings: Sequence[ClipAnomalies]) -> dict[str, Share]:
    """Return the share of clean videos with a false alarm: of any kind, and of each."""
    clean = clean_clips(findings)
    shares = {"any": Share(hits=sum(bool(f.detected) for f in clean), n=len(clean))}
    for kind in AnomalyKind:
        hits = sum(any(a.kind is kind for a in f.detected) for f in clean)
        shares[kind.value] = Share(hits=hits, n=len(clean))
    return shares


def table_lines(findings: Sequence[ClipAnomalies]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield f"{'kind':18s} {'form':9s} {'size':>12s} {'videos':>6s}  frames right  detected   area under the curve"
    for row in rows(findings):
        goal = ""
        if row.size is None:
            goal = f"  {'reaches' if row.area.value >= GOALS[row.kind] else 'MISSES'} {GOALS[row.kind]:g}"
        elif not row.gated:
            goal = "  below the gate"
        yield (
            f"{row.kind.value:18s} {row.form:9s} {row.label:>12s} {row.located.n:6d}  {row.located.value:12.1%} "
            f"{row.named.value:9.1%}   {row.area.value:.3f} ({row.area.low:.3f} to {row.area.high:.3f}){goal}"
        )
    yield ""
    yield "clean videos with a false alarm, with 95 % Wilson interval"
    for name, share in alarms(findings).items():
        low, high = share.interval
        yield f"{name:18s} {share.hits:4d} of {share.n}  {share.value:6.1%} ({low:.1%} to {high:.1%})"
    for f in clean_clips(findings):
        for a in f.detected:
            yield f"  {f.id}: {a.kind.value} {a.frame_start}-{a.frame_end}, severity {a.severity:.3g}"


def table_json(findings: Sequence[ClipAnomalies]) -> dict[str, Any]:
    """Return the table as a JSON object."""
    return {
        "rows": [
            {
                "kind": row.kind.value,
                "form": row.form or None,
                "size": row.size,
                "gated": row.gated,
                "videos": row.located.n,
                "frames_right": row.located.value,
                "found": row.named.value,
                "auroc": row.area.value if np.isfinite(row.area.value) else None,
                "auroc_interval": [row.area.low, row.area.high],
            }
            for row in rows(findings)
        ],
        "clean_videos": len(clean_clips(findings)),
        "false_alarms": {
            name: {"videos": share.hits, "interval": list(share.interval)} for name, share in alarms(findings).items()
        },
    }


_STYLES = ("-", "--")


def draw_anomalies(findings: Sequence[ClipAnomalies]) -> "Figure":
    """Plot area under the curve and share detected in the right frames over size, with gates and goals."""
    figure, axes = new_figure(15.0, 7.6, 2, 4, sharey=True)
    table = [row for row in rows(findings) if row.size is not None]
    for ax, kind in zip(axes.flat, AnomalyKind, strict=False):
        _panel(ax, kind, [row for row in table if row.kind is kind])
    for ax in axes.flat[len(AnomalyKind) :]:
        figure.delaxes(ax)
    for ax in axes[:, 0]:
        ax.set_ylabel("share, area under the curve")
    share = alarms(findings)["any"]
    low, high = share.interval
    figure.suptitle(
        f"Planted anomalies by size, against {share.n} clean videos "
        f"(false alarms in {share.value:.1%} of these, 95 % interval {low:.1%} to {high:.1%})"
    )
    return figure


def _panel(ax: Any, kind: AnomalyKind, table: Sequence[AnomalyRow]) -> None:
    gate = GRADES[kind].gate
    factor = GRADES[kind].factor
    ax.set_title(kind.value.replace("_", " "))
    ax.set_xlabel(f"size [{unit_of(kind)}]")
    ax.axhline(GOALS[kind], color=FAINT, linewidth=1.0, linestyle=":", zorder=1)
    ax.axvspan(0, gate * factor * 0.93, color="#f1f2f4", zorder=0, label="below the gate")
    for form, style in zip(sorted({row.form for row in table}), _STYLES, strict=False):
        group = [row for row in table if row.form == form]
        x = np.array([(row.size or 0.0) * factor for row in group])
        value = np.array([row.area.value for row in group])
        bounds = np.array([[row.area.value - row.area.low, row.area.high - row.area.value] for row in group]).T
        name = f", {form}" if form else ""
        ax.errorbar(x, value, bounds, color=POSITION, linestyle=style, marker="o", markersize=4, capsize=3,
                    label=f"area under the curve{name}")  # fmt: skip
        ax.plot(x, [row.located.value for row in group], color=ROTATION, linestyle=style, marker="s", markersize=4,
                label=f"detected, frames right{name}")  # fmt: skip
    if table:
        ax.set_xlim(0, max((row.size or 0.0) for row in table) * factor * 1.08)
    ax.set_ylim(-0.03, 1.05)
    ax.legend(fontsize=7, loc="lower right", framealpha=0.9)
