"""Drake's log."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def silent_drake() -> Iterator[None]:
    """Keep Drake from logging that a program has no solution, where that is an answer like any other."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
