"""Labels and formats of metrics, and the metrics that the page of each kind of run shows first."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

from kinebench_drake.io.jsonl import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """Label and format of a metric."""

    name: str
    label: str
    pattern: str
    """Format of its values."""
    meaning: str
    """Explanation: one clause."""


_TABLE = files("kinebench_drake.report").joinpath("metrics.csv").read_text(encoding="utf-8")
BY_NAME = {line["name"]: Metric(**line) for line in csv.DictReader(_TABLE.splitlines())}


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricLayout:
    """Metrics that the page of a kind of run shows first."""

    headlines: tuple[str, ...]
    """Metrics with a tile."""
    columns: tuple[str, ...]
    """Metrics in the table of samples."""
    shares: tuple[str, ...] = ()
    """Truth values per sample that the tables by task and by model show, too."""


_VIDEOS = MetricLayout(
    headlines=("tracked_fraction", "ik_success_rate", "manipulability_mean", "sparc"),
    columns=(
        *("tracked_fraction", "ik_success_rate", "joint_limit_margin_min", "slowdown_min", "manipulability_min"),
        "sparc",
    ),
)
_LAYOUTS = {
    "audit": MetricLayout(
        headlines=("slowdown_min", "trajopt_feasible", "manipulability_mean", "sparc"),
        columns=(
            *("slowdown_min", "velocity_ratio_max", "acceleration_ratio_max", "torque_ratio_max"),
            *("joint_limit_margin_min", "table_distance_min_m", "manipulability_min", "sparc"),
        ),
    ),
    "follow": MetricLayout(
        headlines=("follows", "follow_share", "gain", "deviation_m", "deviation_px"),
        columns=(
            *("follow_share", "lag_frames", "gain", "deviation_m", "deviation_rad", "deviation_finger_m"),
            *("deviation_px", "deviation_hands", "drift_from_frame", "tracked_fraction"),
        ),
        shares=("follows",),
    ),
    "suite": MetricLayout(
        headlines=("success", "progress", "rounds", "tracked_fraction", "sparc"),
        columns=("progress", "rounds", "tracked_fraction", "gap_robot_iou", "gap_gripper_m", "slowdown_min", "sparc"),
        shares=("success",),
    ),
}
"""By kind of run; all others are of videos."""


def layout_of(results: Mapping[str, Json]) -> MetricLayout:
    """Return the layout for the kind of run that `results.json` names."""
    return _LAYOUTS.get(str(results.get("kind")), _VIDEOS)
