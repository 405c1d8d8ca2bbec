"""Cabinets with a drawer."""
