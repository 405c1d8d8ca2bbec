"""Estimation of the gripper's track from video: segmentation, metric depth, CAD registration, tracking, anomalies."""
