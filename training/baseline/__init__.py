"""Baseline: an inverse-dynamics network that maps pixels directly to poses, as in earlier benchmarks."""
