"""The grounding inside of other programs."""
