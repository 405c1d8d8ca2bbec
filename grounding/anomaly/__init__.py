"""Detection of events that no real gripper shows: one detector per kind, each a pure function of the measurements."""
