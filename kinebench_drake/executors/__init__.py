"""Executors of samples: local processes and Ray clusters."""
