"""Overrides of grounding stages: masks, depth and poses from files or from a plug-in class."""
