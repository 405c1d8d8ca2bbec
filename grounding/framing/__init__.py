"""Framing of generated videos: where the conditioning image is in the frames."""
