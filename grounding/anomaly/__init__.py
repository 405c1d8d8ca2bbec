"""What a video shows that no real gripper does: one detector a kind, each a pure function of what the tracker saw."""
