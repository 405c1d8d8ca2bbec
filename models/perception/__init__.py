"""Perception network, its weights and training frames."""
