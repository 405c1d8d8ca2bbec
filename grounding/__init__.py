"""Frames to gripper track: masks, metric depth, CAD registration, tracking."""
