"""Numbers of a trajectory file."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array


def require_numbers(name: str, array: NDArray[np.generic]) -> Array:
    """Return the array in double precision.

    Raises:
        InputError: it does not hold real numbers.
    """
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} holds {array.dtype}, expected real numbers")
    return np.asarray(array, dtype=np.float64)


def others_text(bad: NDArray[np.bool_]) -> str:
    """Return " (and at N more places)" for a mask of faults of which one is reported."""
    count = int(bad.sum()) - 1
    return f" (and at {count} more places)" if count else ""
