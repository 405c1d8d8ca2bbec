"""Executors: where samples are processed."""
