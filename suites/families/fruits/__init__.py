"""Fruits and their containers."""
