"""Judge robot videos by geometry: gripper tracks from pixels, Drake kinematics, closed-loop success."""

__version__ = "0.1.0"
