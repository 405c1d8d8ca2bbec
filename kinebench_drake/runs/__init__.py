"""Runs: samples evaluated one by one into an output folder."""
