"""Trajectories from files: what formats hold, and the checks that stand between a file and a verdict."""
