"""Judge trajectories in NumPy arrays: poses of the TCP, and joint angles.

    python examples/audit_arrays.py

The gripper points down and moves 30 cm to the left, once in 2 s and once in 0.5 s, which is too fast for a Panda.
"""

import numpy as np

from kinebench_drake import audit_trajectory
from kinebench_drake.geometry import make_pose
from kinebench_drake.metrics.kinematic_result import KinematicResult

DOWN = np.diag([1.0, -1.0, -1.0])
"""Rotation of panda_hand_tcp in the base frame: its z axis, along the fingers, points to the table."""


def minimum_jerk(frames: int) -> np.ndarray:
    """From 0 to 1 at rest at both ends."""
    s = np.linspace(0.0, 1.0, frames)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def print_result(name: str, result: KinematicResult) -> None:
    print(f"{name}: {'feasible' if result.feasible else 'infeasible'}")
    for v in result.violations:
        print(f"  {v.kind.value} of {v.joint} in frames {v.frame_start} to {v.frame_end}: {v.value:.3g}")
    for metric in ("slowdown_min", "manipulability_min", "joint_limit_margin_min", "sparc"):
        value = result.metrics[metric]
        print(f"  {metric}: {result.reasons[metric] if value is None else f'{value:.3g}'}")


def main() -> None:
    way = minimum_jerk(41)
    p_BG = np.stack([np.full(41, 0.5), -0.15 + 0.3 * way, np.full(41, 0.25)], axis=1)
    X_BG = make_pose(DOWN, p_BG)  # (41, 4, 4), metres
    slow = audit_trajectory(X_BG, rate_hz=20)
    print_result("poses, 2 s", slow)
    print_result("poses, 0.5 s", audit_trajectory(X_BG, t_s=np.linspace(0.0, 0.5, 41)))
    print_result("the solved joint path, as joint angles", audit_trajectory(slow.joints.q, rate_hz=20))


if __name__ == "__main__":
    main()
