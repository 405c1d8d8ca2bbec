"""Robot models and perception networks."""
