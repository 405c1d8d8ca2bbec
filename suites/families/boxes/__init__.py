"""Boxes with a hinged lid."""
