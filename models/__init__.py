"""The robot model and the perception networks."""
