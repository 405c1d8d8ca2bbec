"""Tuned bounds of the metrics: value, unit, and what they were chosen on."""

import numpy as np

BRIDGE_M, BRIDGE_RAD = 0.010, float(np.deg2rad(5.0))
"""Errors within which a bridged pose is sound: those of a good pose."""
BRIDGE_SHARE = 0.95
"""Share of the gaps cut into a track that must be bridged within these errors."""
BRIDGE_FRAMES = 5
"""Longest gap that is bridged [frames]."""
BRIDGE_TRIALS = 10
"""Fewest gaps cut into a track from which the share is known."""
BRIDGE_CONFIDENCE = 0.5
"""Least confidence of the poses on both sides of a gap."""
