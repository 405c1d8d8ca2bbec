"""Closed loop: a gripper track becomes commands, commands are executed, what came of it is attributed."""
