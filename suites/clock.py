"""Time constants of the benchmark: control steps, frames, clips."""

CONTROL_PERIOD_S = 0.05
"""Time between two control steps (ManiSkill's 20 Hz)."""
STEPS_PER_FRAME = 4
"""Control steps between two frames."""
FRAME_PERIOD_S = STEPS_PER_FRAME * CONTROL_PERIOD_S
"""Task time between two frames."""
MIN_FRAME_PERIOD_S, MAX_FRAME_PERIOD_S = 0.01, 2.0
"""Range of the task time between two frames of an executed video."""
CLIP_FRAMES = 48
"""Frames of a clip after its first one, which is the last of the clip before."""
