"""How metrics are shown, and which of them stand first on the page of each kind of run."""

from collections.abc import Mapping
from dataclasses import dataclass

from kinebench_drake.types import Json


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
class MetricLayout:
    """What the page of a kind of run shows first."""

    headlines: tuple[str, ...]
    """Metrics with a tile of their own."""
    columns: tuple[str, ...]
    """Metrics in the table of samples."""
    shares: tuple[str, ...] = ()
    """Metrics, one truth value a sample, that groups are told by besides."""


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
    "suite": MetricLayout(
        headlines=("success", "progress", "rounds", "tracked_fraction", "sparc"),
        columns=("progress", "rounds", "tracked_fraction", "gap_robot_iou", "gap_gripper_m", "slowdown_min", "sparc"),
        shares=("success",),
    ),
}
"""By kind of run; the others are of videos."""
BY_NAME = {metric.name: metric for metric in METRICS}


def layout_of(results: Mapping[str, Json]) -> MetricLayout:
    """What the page of a run shows first, by the kind that its results tell."""
    return _LAYOUTS.get(str(results.get("kind")), _VIDEOS)
