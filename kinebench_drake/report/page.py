"""What the report shows, gathered from an output folder and put into the template."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from kinebench_drake.aggregate import Aggregate, Estimate, aggregate, by_key
from kinebench_drake.errors import InputError
from kinebench_drake.report.sample import FAILURES, RANK, badness, view_sample
from kinebench_drake.results import RESULTS, read_rows
from kinebench_drake.row import Json, Status


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
        (
            "arm_consistency_px",
            "Arm consistency [px]",
            "{:.1f}",
            "how far the links are from where the arm that goes with the hand would have them",
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
        ("manipulability_translation_mean", "Manipulability, moving", "{:.4f}", "volume of the translational Jacobian"),
        ("manipulability_rotation_mean", "Manipulability, turning", "{:.4f}", "volume of the rotational Jacobian"),
        ("manipulability_limited_mean", "Manipulability within limits, mean", "{:.4f}", "weighed by joint limits"),
        ("manipulability_limited_min", "Manipulability within limits, least", "{:.4f}", "weighed by joint limits"),
        (
            "condition_number_max",
            "Condition number, greatest",
            "{:.1f}",
            "of the 6x7 Jacobian; great near a singularity",
        ),
        ("branch_jumps", "Branch jumps", "{:.2f}", "changes of posture that the joint path needs"),
        ("sparc", "SPARC", "{:.2f}", "smoothness of the position; nearer 0 is smoother"),
        ("sparc_rotation", "SPARC, rotation", "{:.2f}", "smoothness of the turning; nearer 0 is smoother"),
        ("sparc_filtered", "SPARC, filtered", "{:.2f}", "SPARC behind one fixed filter, to compare frame rates"),
        ("sparc_rotation_filtered", "SPARC, rotation, filtered", "{:.2f}", "behind one fixed filter"),
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
        ("rounds", "Rounds", "{:.2f}", "clips asked of the model in an episode"),
        ("gap_robot_iou", "Robot overlap", "{:.2f}", "of its pixels as imagined and as executed, over their union"),
        ("gap_gripper_m", "Gripper apart [m]", "{:.4f}", "between the imagined and the executed gripper"),
        ("gap_gripper_rad", "Gripper turned [rad]", "{:.3f}", "between the imagined and the executed gripper"),
        ("gap_psnr_db", "PSNR [dB]", "{:.1f}", "of imagined frames against executed ones"),
        ("gap_ssim", "SSIM", "{:.3f}", "of imagined frames against executed ones"),
    )
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What the page of a kind of run shows first."""

    headlines: tuple[str, ...]
    """Metrics with a tile of their own."""
    columns: tuple[str, ...]
    """Metrics in the table of samples."""
    shares: tuple[str, ...] = ()
    """Metrics, one truth value a sample, that groups are told by besides."""


_VIDEOS = Layout(
    headlines=("tracked_fraction", "ik_success_rate", "manipulability_mean", "sparc"),
    columns=(
        *("tracked_fraction", "ik_success_rate", "joint_limit_margin_min", "slowdown_min", "manipulability_min"),
        "sparc",
    ),
)
_LAYOUTS = {
    "audit": Layout(
        headlines=("slowdown_min", "trajopt_feasible", "manipulability_mean", "sparc"),
        columns=(
            *("slowdown_min", "velocity_ratio_max", "acceleration_ratio_max", "torque_ratio_max"),
            *("joint_limit_margin_min", "table_distance_min_m", "manipulability_min", "sparc"),
        ),
    ),
    "suite": Layout(
        headlines=("success", "progress", "rounds", "tracked_fraction", "sparc"),
        columns=("progress", "rounds", "tracked_fraction", "gap_robot_iou", "gap_gripper_m", "slowdown_min", "sparc"),
        shares=("success",),
    ),
}
"""By kind of run; the others are of videos."""
DRAWN = 200
"""Samples, the worst first, whose curves and findings stand on the page: the rest would make it slow to open."""
_BY_NAME = {metric.name: metric for metric in METRICS}


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
    samples = [view_sample(out, row, drawn=k < DRAWN) for k, row in enumerate(sorted(rows, key=badness))]
    layout = _LAYOUTS.get(str(results.get("kind")), _VIDEOS)
    environment = Environment(
        loader=PackageLoader("kinebench_drake.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(shown=shown, named=lambda verdict: FAILURES.get(verdict, verdict))
    return environment.get_template("page.html.j2").render(
        title=_title(results),
        results=results,
        total=total,
        headlines=[(_BY_NAME[n], total.estimates[n]) for n in layout.headlines if _measured(total, n)],
        metrics=[(m, total.estimates[m.name]) for m in (*METRICS, *_others(total)) if _measured(total, m.name)],
        groups=[
            (title, [(name, aggregate(group)) for name, group in groups.items()])
            for title, key in (("task", "task"), ("model", "model"))
            if (groups := by_key(rows, key))
        ],
        columns=[_BY_NAME[n] for n in layout.columns if _measured(total, n)],
        shares=[_BY_NAME[n] for n in layout.shares if _measured(total, n)],
        samples=samples,
        left_out=max(len(samples) - DRAWN, 0),
        normalization=_normalization(results),
        verdicts=[v for v in RANK if any(s.verdict == v for s in samples)],
        Status=Status,
    )


def _title(results: Mapping[str, Json]) -> str:
    """The run's input, or who did what."""
    config = results.get("config")
    config = config if isinstance(config, Mapping) else {}
    if "suite" in config:
        return f"{config.get('world_model')}, suite {config['suite']} ({config.get('split')})"
    return str(config.get("source") or "Report")


def shown(value: float | None, pattern: str) -> str:
    """A number in its format; a dash where there is none."""
    return "–" if value is None else pattern.format(value)


def _others(total: Aggregate) -> list[Metric]:
    """Metrics that the page knows nothing about but their names; noise floors mean nothing apart from their track."""
    known = {*_BY_NAME, "feasible"}
    names = [name for name in total.estimates if name not in known and "_floor_" not in name]
    return [Metric(name=name, label=name, pattern="{:.4g}", meaning="") for name in names]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Normalized:
    """A metric put on the scale that its own run spans."""

    metric: str
    low: float
    """Value that counts as 0: the run's 10th percentile."""
    high: float
    """Value that counts as 1: the run's 90th percentile."""
    mean: float
    """Mean over samples of (value - low) / (high - low), held within 0..1."""
    n: int


def _normalization(results: Mapping[str, Json]) -> list[Normalized]:
    found = results.get("normalization")
    told = []
    for name, entry in found.items() if isinstance(found, Mapping) else ():
        numbers = [entry.get(key) if isinstance(entry, Mapping) else None for key in ("low", "high", "mean", "n")]
        low, high, mean, n = (float(v) if isinstance(v, int | float) else None for v in numbers)
        if low is not None and high is not None and mean is not None and n is not None:
            told.append(Normalized(metric=name, low=low, high=high, mean=mean, n=int(n)))
    return told
