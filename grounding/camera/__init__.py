"""The camera of a video: its framing, its estimation from the robot, its check by the arm, and its calibration."""
