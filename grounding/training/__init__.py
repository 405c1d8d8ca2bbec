"""Training and measuring of the perception networks."""
