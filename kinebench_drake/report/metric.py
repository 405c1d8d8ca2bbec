"""Labels and formats of metrics, and the metrics that the page of each kind of run shows first."""

from collections.abc import Mapping
from dataclasses import dataclass

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


_METRICS = (
    ("tracked_fraction", "Frames tracked", "{:.0%}", "share of frames with a reliable gripper pose"),
    ("camera_motion_px", "Camera motion [px]", "{:.2f}", "motion of the background; about 0 for a fixed camera"),
    ("arm_consistency_px", "Arm consistency [px]", "{:.1f}", "distance of the links from the arm posed by the hand"),
    (
        "ik_success_rate",
        "IK success",
        "{:.0%}",
        "share of all frames reached within joint limits, without collision",
    ),
    ("ik_position_error_max_m", "IK position error, max [m]", "{:.2g}", "greatest distance from the wanted pose"),
    ("joint_limit_margin_min", "Joint margin, min", "{:.3f}", "distance to the limit / half the range; < 0 is outside"),
    ("manipulability_mean", "Manipulability, mean", "{:.4f}", "volume of the 6x7 Jacobian; 0 is singular"),
    ("manipulability_min", "Manipulability, min", "{:.4f}", "volume of the 6x7 Jacobian at its worst frame"),
    ("manipulability_integral", "Manipulability, integral", "{:.4f}", "over task time"),
    ("manipulability_cost_mean", "Manipulability cost", "{:.2f}", "1 / (translational volume); lower is better"),
    ("manipulability_translation_mean", "Manipulability, translation", "{:.4f}", "of the translational Jacobian"),
    ("manipulability_rotation_mean", "Manipulability, rotation", "{:.4f}", "of the rotational Jacobian"),
    ("manipulability_limited_mean", "Manipulability within limits, mean", "{:.4f}", "weighted by joint limits"),
    ("manipulability_limited_min", "Manipulability within limits, min", "{:.4f}", "weighted by joint limits"),
    ("condition_number_max", "Condition number, max", "{:.1f}", "of the 6x7 Jacobian; large near a singularity"),
    ("branch_jumps", "Branch jumps", "{:.2f}", "changes of arm configuration that the joint path needs"),
    ("sparc", "SPARC", "{:.2f}", "smoothness of the position; nearer 0 is smoother"),
    ("sparc_rotation", "SPARC, rotation", "{:.2f}", "smoothness of the rotation; nearer 0 is smoother"),
    ("sparc_filtered", "SPARC, filtered", "{:.2f}", "SPARC after one fixed filter, to compare frame rates"),
    ("sparc_rotation_filtered", "SPARC, rotation, filtered", "{:.2f}", "after one fixed filter"),
    ("ldlj", "Log dimensionless jerk", "{:.2f}", "nearer 0 is smoother"),
    ("velocity_ratio_max", "Joint speed / limit", "{:.2f}", "above 1 exceeds the limit"),
    ("acceleration_ratio_max", "Joint acceleration / limit", "{:.2f}", "above 1 exceeds the limit"),
    ("jerk_ratio_max", "Joint jerk / limit", "{:.2f}", "above 1 exceeds the limit"),
    ("torque_ratio_max", "Joint torque / limit", "{:.2f}", "above 1 exceeds the limit"),
    ("slowdown_min", "Slow-down needed", "{:.2f}", "1 or less is feasible at its own speed"),
    ("time_scale", "Fastest / own duration", "{:.2f}", "fastest feasible duration of the path over its own"),
    ("trajopt_feasible", "Trajectory optimised", "{:.0%}", "share with a feasible trajectory"),
    ("trajopt_position_tube_m", "Trajectory tube [m]", "{:.4f}", "distance of the feasible trajectory from the track"),
    ("self_distance_min_m", "Self-collision clearance [m]", "{:.3f}", "negative is a collision"),
    ("table_distance_min_m", "Table clearance [m]", "{:.3f}", "negative is a collision"),
    ("success", "Success", "{:.0%}", "share of episodes that reach the task's goal"),
    ("progress", "Progress", "{:.0%}", "share of the task's steps completed"),
    ("rounds", "Rounds", "{:.2f}", "clips requested from the model per episode"),
    ("gap_robot_iou", "Robot overlap", "{:.2f}", "intersection over union of the generated and the executed robot"),
    ("gap_gripper_m", "Gripper distance [m]", "{:.4f}", "between the generated and the executed gripper"),
    ("gap_gripper_rad", "Gripper angle [rad]", "{:.3f}", "between the generated and the executed gripper"),
    ("gap_psnr_db", "PSNR [dB]", "{:.1f}", "of generated against executed frames"),
    ("gap_ssim", "SSIM", "{:.3f}", "of generated against executed frames"),
    ("action_error_m", "Action error [m]", "{:.4f}", "distance of the generated from the commanded gripper, median"),
    ("action_error_rad", "Action error [rad]", "{:.3f}", "angle to the commanded gripper, median"),
    ("action_error_finger_m", "Action error, fingers [m]", "{:.4f}", "of the gap between the fingers, median"),
    ("action_shuffled_m", "Shuffled actions [m]", "{:.4f}", "distance from the commanded frames in random order"),
    ("action_shuffled_rad", "Shuffled actions [rad]", "{:.3f}", "angle to the commanded frames in random order"),
    ("action_shuffled_finger_m", "Shuffled actions, fingers [m]", "{:.4f}", "gap in the commanded frames, shuffled"),
    ("action_following", "Action following", "{:.2f}", "1 - error / shuffled error; 1 obeys, 0 does not"),
    ("action_lag_s", "Action delay [s]", "{:.2f}", "delay with the least action error"),
)
BY_NAME = {
    name: Metric(name=name, label=label, pattern=pattern, meaning=meaning) for name, label, pattern, meaning in _METRICS
}


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
