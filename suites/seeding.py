"""Random generators seeded by words, independent of the order of calls."""

import hashlib

import numpy as np


def generator(*words: str | int) -> np.random.Generator:
    """Return the random generator of these words, the same on every machine and in every version."""
    digest = hashlib.sha256("\0".join(map(str, words)).encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, dtype=np.uint32).astype(np.uint64))


def share(*words: str | int) -> float:
    """Return a pseudo-random number in [0, 1) that depends on these words only."""
    return int.from_bytes(hashlib.sha256("\0".join(map(str, words)).encode()).digest()[:8]) / 2.0**64
