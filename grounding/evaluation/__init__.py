"""Measuring the grounding against ground truth."""
