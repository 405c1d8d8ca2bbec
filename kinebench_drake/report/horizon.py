"""Deviation over the frames of the clips of a `follow` run, by model, and the frame from which each has drifted."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import new_figure, plain
from kinebench_drake.report.figures import add_legend, inline_figure, style
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.segments import spread
from kinebench_drake.stats import PERCENTILES, resampled_indices

_CURVES = {"deviation_m": ("deviation [mm]", 1e3), "deviation_px": ("deviation [px]", 1.0)}
"""Labels and factors of the curves that may be drawn, the first that a clip has."""


def horizon_lines(rows: Sequence[SampleRow], seed: int) -> list[str]:
    """State of each model the median deviation, how many clips drift, and the frame by which half of them do."""
    lines = []
    for model, own in _by_model(rows).items():
        onset = _column(own, "drift_from_frame")
        columns = {label: factor * _column(own, name) for name, (label, factor) in _CURVES.items()}
        stated = [f"{model}: {int(np.isfinite(onset).sum())} of {len(own)} clips drift"]
        stated.append(f"half drift by frame {_format_median(onset, '{:.0f}', seed)}")
        stated += [
            f"median {label} {_format_median(values, '{:.1f}', seed)}"
            for label, values in columns.items()
            if np.isfinite(values).any()
        ]
        lines.append("; ".join(stated))
    return lines


def _column(rows: Sequence[SampleRow], name: str) -> Array:
    """Return a number of each row (N,), infinite where it has none."""
    return np.array([np.inf if (value := getattr(row, name)) is None else value for row in rows])


def _format_median(values: Array, pattern: str, seed: int) -> str:
    """Format a median with its 95 % bootstrap interval; infinite values are those that are worse than any."""
    drawn = resampled_indices(len(values), np.random.default_rng(seed))
    medians = np.concatenate([np.quantile(values[part], 0.5, axis=1, method="higher") for part in drawn])
    ends = np.percentile(medians, PERCENTILES, method="nearest")
    middle, low, high = (
        pattern.format(value) if np.isfinite(value) else "none"
        for value in (np.quantile(values, 0.5, method="higher"), *ends)
    )
    return f"{middle} ({low} to {high})"


def draw_horizon(out: Path, rows: Sequence[SampleRow]) -> Markup | None:
    """Draw the median deviation over the clips of each model, frame by frame, above the share that has not drifted."""
    models = _by_model(rows)
    curves = {model: [_read_curves(out, row) for row in own] for model, own in models.items()}
    names = [name for name in _CURVES if any(name in one for own in curves.values() for one in own)]
    if not names:
        return None
    label, factor = _CURVES[names[0]]
    figure, axes = new_figure(7.2, 4.2, 2, sharex=True)
    for k, (model, own) in enumerate(models.items()):
        measured = [factor * one[names[0]] for one in curves[model] if names[0] in one]
        frames = np.arange(max(map(len, measured), default=0))
        table = np.array([spread(values, np.arange(len(values)), len(frames)) for values in measured])
        options = {"color": style(k)[0], "linewidth": 1.2, "label": plain(model)}
        if len(table):
            drawn = np.flatnonzero(np.isfinite(table).any(axis=0))
            low, middle, high = np.nanpercentile(table[:, drawn], [25, 50, 75], axis=0)
            axes[0, 0].plot(drawn, middle, **options)
            axes[0, 0].fill_between(drawn, low, high, color=style(k)[0], alpha=0.15, linewidth=0)
        kept = _column(own, "drift_from_frame")[:, None] > frames
        axes[1, 0].step(frames, kept.mean(axis=0), where="post", **options)
    axes[0, 0].set_ylabel(label)
    axes[1, 0].set(xlabel="frame", ylabel="not drifted", ylim=(-0.03, 1.03))
    add_legend(figure, list(models))
    return inline_figure(figure, "horizon", "Deviation over the frames by model")


def _by_model(rows: Sequence[SampleRow]) -> dict[str, list[SampleRow]]:
    compared = [row for row in rows if row.status is Status.OK and row.has("follows")]
    return group_by(sorted(compared, key=lambda row: (row.model or "", row.id)), lambda row: row.model or "all clips")


def _read_curves(out: Path, row: SampleRow) -> Mapping[str, Array]:
    """Read the curves of a clip that have a number; none where its file is damaged."""
    try:
        curves = read_track(artifact_path(out, "tracks", row.id)).curves
    except InputError:
        return {}
    return {name: values for name, values in curves.items() if name in _CURVES and np.isfinite(values).any()}
