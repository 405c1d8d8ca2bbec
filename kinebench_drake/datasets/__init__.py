"""Input data sets: videos, trajectories and their metadata."""
