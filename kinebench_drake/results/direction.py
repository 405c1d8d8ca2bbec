"""Which of two values of a metric is the better one, and the name of its worst case."""

from collections.abc import Iterable

BOUND = "_bound"
"""End of the name of a metric's worst case: the least favourable value whatever happens in lost frames."""
HIGHER_IS_BETTER = frozenset(
    {
        *(
            "feasible",
            "executable",
            "executability",
            "success",
            "progress",
            "tracked_fraction",
            "ik_success_rate",
            "trajopt_feasible",
        ),
        *("sparc", "sparc_rotation", "ldlj", "sparc_filtered", "sparc_rotation_filtered"),
        *("manipulability_mean", "manipulability_min", "manipulability_integral"),
        *("joint_limit_margin_min", "self_distance_min_m", "table_distance_min_m"),
        *("gap_robot_iou", "action_following", "follows", "follow_share"),
    }
)
LOWER_IS_BETTER = frozenset(
    {
        *("manipulability_cost_mean", "ik_position_error_max_m"),
        *("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "slowdown_min"),
        "feasible_from_period_s",
        *("time_scale", "trajopt_position_tube_m", "camera_motion_px", "arm_consistency_px", "rounds"),
        *("gap_gripper_m", "gap_gripper_rad"),
        *("action_error_m", "action_error_rad", "action_error_finger_m", "action_lag_s"),
        *("deviation_m", "deviation_rad", "deviation_finger_m", "deviation_px", "deviation_hands", "drift_m"),
    }
)


def worst_value(name: str, values: Iterable[float]) -> float | None:
    """Return the worst of the values of a metric; None without values or without a better side."""
    if name in HIGHER_IS_BETTER:
        return min(values, default=None)
    return max(values, default=None) if name in LOWER_IS_BETTER else None
