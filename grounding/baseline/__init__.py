"""The yardstick: an inverse-dynamics network that maps pixels to poses, as benchmarks before this one do."""
