"""Framing of generated videos: where the conditioning image lies in the frames."""
