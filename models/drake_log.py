"""Drake's log."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def silent_drake() -> Iterator[None]:
    """Suppress Drake's log messages, where an infeasible program is a regular result."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
