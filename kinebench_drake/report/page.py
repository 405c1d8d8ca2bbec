"""What the report shows, gathered from an output folder and put into the template."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from kinebench_drake.aggregate import Aggregate, Estimate, aggregate, by_key
from kinebench_drake.errors import InputError
from kinebench_drake.report.plot import Band, Curve, draw_plot
from kinebench_drake.results import RESULTS, part_path, read_rows
from kinebench_drake.row import Json, SampleRow, Status
from kinebench_drake.trackfile import TrackFile, read_track


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """How a metric is shown."""

    name: str
    label: str
    pattern: str
    """Format of its values."""
    meaning: str
    """One clause for the reader."""


METRICS = tuple(
    Metric(name=name, label=label, pattern=pattern, meaning=meaning)
    for name, label, pattern, meaning in (
        (
            "tracked_fraction",
            "Frames tracked",
            "{:.0%}",
            "share of frames in which the gripper's pose can be relied upon",
        ),
        (
            "camera_motion_px",
            "Camera motion [px]",
            "{:.2f}",
            "how far the background moves; a fixed camera gives about 0",
        ),
        ("ik_success_rate", "IK success", "{:.0%}", "share of tracked frames reached within joint limits"),
        ("ik_position_error_max_m", "IK error, worst [m]", "{:.2g}", "largest distance left to the wanted pose"),
        (
            "joint_limit_margin_min",
            "Joint margin, least",
            "{:.3f}",
            "distance to the limit over half the range; negative is outside",
        ),
        ("manipulability_mean", "Manipulability, mean", "{:.4f}", "volume of the 6x7 Jacobian; 0 is singular"),
        ("manipulability_min", "Manipulability, least", "{:.4f}", "volume of the 6x7 Jacobian at its worst frame"),
        ("manipulability_integral", "Manipulability, integral", "{:.4f}", "over task time"),
        ("manipulability_cost_mean", "Manipulability cost", "{:.2f}", "1 / (translational volume); lower is better"),
        ("sparc", "SPARC", "{:.2f}", "smoothness of the position; nearer 0 is smoother"),
        ("sparc_rotation", "SPARC, rotation", "{:.2f}", "smoothness of the turning; nearer 0 is smoother"),
        ("ldlj", "Log dimensionless jerk", "{:.2f}", "nearer 0 is smoother"),
        ("velocity_ratio_max", "Joint speed / limit", "{:.2f}", "above 1 breaks the limit"),
        ("acceleration_ratio_max", "Joint acceleration / limit", "{:.2f}", "above 1 breaks the limit"),
        ("jerk_ratio_max", "Joint jerk / limit", "{:.2f}", "above 1 breaks the limit"),
        ("torque_ratio_max", "Joint torque / limit", "{:.2f}", "above 1 breaks the limit"),
        ("slowdown_min", "Slow-down needed", "{:.2f}", "1 or less can be played at its own speed"),
        ("time_scale", "Fastest / own duration", "{:.2f}", "how much faster the path could be run"),
        ("trajopt_feasible", "Trajectory optimised", "{:.0%}", "share for which a feasible trajectory was found"),
        ("trajopt_position_tube_m", "Trajectory tube [m]", "{:.4f}", "how far the feasible trajectory strays"),
        ("self_distance_min_m", "Clearance to itself [m]", "{:.3f}", "negative is a collision"),
        ("table_distance_min_m", "Clearance to the table [m]", "{:.3f}", "negative is a collision"),
        ("success", "Success", "{:.0%}", "share of episodes that reach the task's goal"),
        ("progress", "Progress", "{:.0%}", "share of the task's steps done"),
    )
)
HEADLINES = ("tracked_fraction", "ik_success_rate", "manipulability_mean", "sparc")
COLUMNS = ("tracked_fraction", "ik_success_rate", "joint_limit_margin_min", "manipulability_min", "sparc")
_BY_NAME = {metric.name: metric for metric in METRICS}
_RANK = {"error": 0, "infeasible": 1, "unmeasurable": 2, "unjudged": 3, "feasible": 4}


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleView:
    """One sample as the page shows it."""

    row: SampleRow
    verdict: str
    """feasible, infeasible, unjudged, unmeasurable or error."""
    anomalies: Sequence[Mapping[str, Json]]
    thumbnail: str | None
    """Picture as a data URI."""
    plots: Sequence[Markup]

    def value(self, name: str) -> float | None:
        """A metric as a number; None where it has none."""
        value = self.row.metrics.get(name)
        return float(value) if isinstance(value, bool | int | float) else None

    @property
    def badness(self) -> tuple[float | str, ...]:
        """Sorts the worst first."""
        tracked = self.value("tracked_fraction")
        faults = len(self.row.violations) + len(self.anomalies)
        return _RANK[self.verdict], -faults, 1.0 if tracked is None else tracked, self.row.id


def build_page(out: Path) -> str:
    """The html text of an output folder's report.

    Raises:
        InputError: the folder's files are broken.
    """
    rows = sorted(read_rows(out).values(), key=lambda row: row.id)
    results = read_results(out)
    seeds = results.get("seeds")
    seed = seeds.get("bootstrap", 0) if isinstance(seeds, Mapping) else 0
    total = aggregate(rows, int(seed) if isinstance(seed, int) else 0)
    samples = sorted((_view(out, row) for row in rows), key=lambda sample: sample.badness)
    environment = Environment(
        loader=PackageLoader("kinebench_drake.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["shown"] = shown
    return environment.get_template("page.html.j2").render(
        results=results,
        total=total,
        headlines=[(_BY_NAME[n], total.estimates[n]) for n in HEADLINES if _measured(total, n)],
        metrics=[(m, total.estimates[m.name]) for m in METRICS if _measured(total, m.name)],
        groups=[
            (title, [(name, aggregate(group)) for name, group in groups.items()])
            for title, key in (("task", "task"), ("model", "model"))
            if (groups := by_key(rows, key))
        ],
        columns=[_BY_NAME[n] for n in COLUMNS if _measured(total, n)],
        samples=samples,
        verdicts=[v for v in _RANK if any(s.verdict == v for s in samples)],
        Status=Status,
    )


def shown(value: float | None, pattern: str) -> str:
    """A number in its format; a dash where there is none."""
    return "–" if value is None else pattern.format(value)


def _measured(total: Aggregate, name: str) -> bool:
    found: Estimate | None = total.estimates.get(name)
    return found is not None and found.n > 0


def read_results(out: Path) -> Mapping[str, Json]:
    """What `results.json` holds; nothing for a run that was interrupted.

    Raises:
        InputError: the file is damaged.
    """
    try:
        data = json.loads((out / RESULTS).read_text())
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise InputError(f"{out / RESULTS}: not JSON ({error})") from None
    return data if isinstance(data, dict) else {}


def _view(out: Path, row: SampleRow) -> SampleView:
    verdict = row.status.value
    if row.status is Status.OK:
        verdict = {True: "feasible", False: "infeasible", None: "unjudged"}[row.feasible]
    found = row.metrics.get("anomalies")
    anomalies = [a for a in found if isinstance(a, Mapping)] if isinstance(found, list | tuple) else []
    picture = part_path(out, "thumbnails", row.id)
    uri = f"data:image/jpeg;base64,{base64.b64encode(picture.read_bytes()).decode()}" if picture.is_file() else None
    file = part_path(out, "tracks", row.id)
    plots = _plots(read_track(file), row, anomalies) if row.status is Status.OK and file.is_file() else []
    return SampleView(row=row, verdict=verdict, anomalies=anomalies, thumbnail=uri, plots=plots)


def _plots(file: TrackFile, row: SampleRow, anomalies: Sequence[Mapping[str, Json]]) -> list[Markup]:
    track = file.track
    marks = [(a, "anomaly") for a in anomalies] + [(v, "violation") for v in row.violations]
    bands = [
        Band(label=f"{m['kind']}, frames {start} to {end}", start=start, end=end, css=css)
        for m, css in marks
        if isinstance(start := m.get("frame_start"), int) and isinstance(end := m.get("frame_end"), int)
    ]
    axes = [Curve(label=a, values=track.X_BG[:, k, 3], css=f"c{k}") for k, a in enumerate("xyz")]
    sure = Curve(label="confidence", values=track.confidence, css="c0")
    gap = Curve(label="gap", values=track.finger_width_m * 1000.0, css="c0")
    nothing = np.full(len(track.t_s), np.nan)
    able = Curve(label="manipulability", values=file.curves.get("manipulability", nothing), css="c0")
    margin = Curve(label="margin", values=file.curves.get("joint_margin", nothing), css="c0")
    plots = [
        draw_plot("TCP position in the base frame [m]", track.t_s, axes, bands),
        draw_plot("Confidence of the pose", track.t_s, [sure], bands, limits=(0.0, 1.0)),
        draw_plot("Gap between the finger pads [mm]", track.t_s, [gap], bands, limits=(0.0, 85.0)),
        draw_plot("Manipulability", track.t_s, [able], bands, line=0.0),
        draw_plot("Joint-limit margin", track.t_s, [margin], bands, line=0.0),
    ]
    judged = row.feasible is not None or "ik_success_rate" in row.metrics
    return plots if judged else plots[:3]
