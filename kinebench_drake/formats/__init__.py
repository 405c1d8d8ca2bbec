"""Input data sets: formats of videos and trajectories, and their metadata."""
