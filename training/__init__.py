"""Training and calibration of the perception networks."""
