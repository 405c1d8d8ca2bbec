"""Faucets with a turning handle."""
