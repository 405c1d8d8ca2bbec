"""Scenes: procedural meshes, looks and physics, and the ManiSkill environment that runs a task."""
