"""Control and time of the benchmark: control steps, frames, clips."""

from enum import Enum

CONTROL_PERIOD_S = 0.05
"""Time between two control steps (ManiSkill's 20 Hz)."""
STEPS_PER_FRAME = 4
"""Control steps between two frames."""
FRAME_PERIOD_S = STEPS_PER_FRAME * CONTROL_PERIOD_S
"""Task time between two frames."""
MIN_FRAME_PERIOD_S = 0.01
MAX_FRAME_PERIOD_S = 2.0
"""Range of the task time between two frames of an executed video."""
CLIP_FRAMES = 48
"""Frames of a clip after its first one, which is the last of the clip before."""
CLIP_S = CLIP_FRAMES * FRAME_PERIOD_S
"""Task time of a clip."""


class Control(Enum):
    """Command of the robot at each control step."""

    JOINTS = "pd_joint_pos"
    """Joint angles."""
    POSE = "pd_ee_pose"
    """Pose of the TCP; ManiSkill's inverse kinematics takes one step towards it from the current posture."""
