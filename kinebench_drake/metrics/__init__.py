"""Numbers computed from tracks."""
