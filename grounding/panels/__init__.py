"""Panels of tiled frames: the views that a frame shows beside and above one another, and the one that is measured."""
