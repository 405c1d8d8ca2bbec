"""Cubes and pegs: PullCube, StackCube, LiftPegUpright."""
