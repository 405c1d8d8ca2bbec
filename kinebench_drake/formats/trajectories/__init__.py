"""Trajectories in files: formats, conversion and validation."""
