"""Scripted experts: waypoints from the scene's true state, planned with Drake, no learning."""
