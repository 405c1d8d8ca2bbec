"""Camera calibration from videos of the robot."""
