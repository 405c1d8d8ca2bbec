"""Random generators that depend on words, not on the order of calls."""

import hashlib

import numpy as np


def generator(*words: str | int) -> np.random.Generator:
    """A random generator of its own for these words: the same on every machine, today and later."""
    digest = hashlib.sha256("\0".join(map(str, words)).encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, dtype=np.uint32).astype(np.uint64))


def share(*words: str | int) -> float:
    """A fixed number in [0, 1) for these words, as good as drawn at random."""
    return int.from_bytes(hashlib.sha256("\0".join(map(str, words)).encode()).digest()[:8]) / 2.0**64
