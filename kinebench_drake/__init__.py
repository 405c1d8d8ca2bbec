"""Judge robot videos by geometry: gripper tracks from pixels, kinematics in Drake."""

__version__ = "0.1.0"
