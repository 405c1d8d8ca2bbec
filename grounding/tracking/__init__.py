"""Tracking of gripper and flange: crops, detection, poses frame by frame, confidence, smoothing, moving cameras."""
