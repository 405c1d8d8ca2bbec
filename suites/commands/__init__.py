"""Commands of `suite`."""
