"""Formats of demonstrations: a folder of videos, LeRobot v3, ManiSkill's trajectories."""
