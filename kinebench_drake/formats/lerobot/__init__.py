"""LeRobot datasets: description, reader of v2.x and v3, and writer of v3.0."""
