"""The robot in the frame that a video begins with, as manifests tell it."""

from typing import Any

from kinebench_drake.geometry import Array

_DECIMALS = 9


def first_facts(X_BG: Array, finger_width_m: float) -> dict[str, Any]:
    """Keys of a manifest's line.

    Args:
        X_BG: pose (4, 4) of panda_hand_tcp in the robot base frame [m].
        finger_width_m: gap between the finger pads [m].
    """
    pose = X_BG.round(_DECIMALS) + 0.0  # no -0.0
    return {"first_base_from_tcp": pose.tolist(), "first_finger_width_m": round(finger_width_m, _DECIMALS) + 0.0}
