"""Cabinets with a sliding drawer."""

from kinebench_drake.suites.assets.model import Kind

KINDS: tuple[Kind, ...] = ()
"""Kinds of this family."""
