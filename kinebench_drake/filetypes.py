"""Files and folders that are taken for videos, by the suffixes of their names."""

FILM_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".gif", ".webm", ".mkv"})
"""Films."""
FRAME_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
"""Pictures that make a folder of frames."""
