"""Evaluation of the grounding against ground truth."""
