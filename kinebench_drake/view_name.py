"""Names of the views of a tiled frame, as options and manifests state them."""

from itertools import product

AUTO_VIEW = "auto"
"""View by which the panel is chosen from the picture."""
_ROWS = ("top", "middle", "bottom")
_COLUMNS = ("left", "middle", "right")
_PLACES = (*dict.fromkeys((*_ROWS, *_COLUMNS)), *(f"{row}-{column}" for row, column in product(_ROWS, _COLUMNS)))


def check_view(view: str) -> str:
    """Return the name of a view: `auto`, a number from 1, or a place.

    Raises:
        ValueError: it is none.
    """
    is_number = view.isascii() and view.isdecimal() and int(view) >= 1
    if view != AUTO_VIEW and not is_number and view not in _PLACES:
        raise ValueError(f"expected {AUTO_VIEW}, a number from 1 in reading order, or one of {', '.join(_PLACES)}")
    return view
