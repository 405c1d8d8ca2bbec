"""Runs over the episodes of a suite."""
