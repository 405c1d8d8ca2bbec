"""Steps that scripted experts share: waypoints from the ground-truth state, planned with Drake; nothing is learned."""
