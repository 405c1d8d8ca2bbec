"""Letter-box bars that tell themselves: uniform, still, and with the picture's shape between them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.grounding.framing import Framing, Witness
from kinebench_drake.grounding.placement import letterboxes

_FRAMES = 8
_MARGIN_PX = 4  # what a codec smears over the edge
_EVEN = 6.0  # levels of 255 by which a bar may vary, over its area and in time
_STEP = 8.0  # levels by which the picture must differ from the bar beside it


def find_bars(frames: NDArray[np.uint8], picture: tuple[float, float]) -> Framing | None:
    """The framing in which a picture of (width, height) lies between bars of frames (T, H, W, 3); None without bars.

    Every strip beside the picture must be of one colour that stays, and must end where the picture begins.
    """
    chosen = frames[np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))].astype(np.float32)
    size = frames.shape[2], frames.shape[1]
    for framing in letterboxes(picture, size):
        rows, columns = framing.window
        across = columns.stop - columns.start < framing.width
        strips = np.swapaxes(chosen, 1, 2) if across else chosen  # bars as the first and last rows
        begin, end = (columns.start, columns.stop) if across else (rows.start, rows.stop)
        sides = [(strips[:, :begin], strips[:, begin:]), (strips[:, end:][:, ::-1], strips[:, :end][:, ::-1])]
        if all(_is_bar(bar, inside) for bar, inside in sides if bar.shape[1] > 1):
            return replace(framing, witness=Witness.BARS)
    return None


def _is_bar(bar: NDArray[np.float32], inside: NDArray[np.float32]) -> bool:
    """Whether rows (T, n, W, 3) are a bar that ends where the rows `inside` begin."""
    area = bar[:, : max(1, bar.shape[1] - _MARGIN_PX)]
    colour = np.median(area, axis=(0, 1, 2))
    edge = inside[:, _MARGIN_PX : 2 * _MARGIN_PX]
    even = float(np.percentile(np.abs(area - colour), 99)) <= _EVEN
    return even and float(np.abs(edge - colour).max(axis=-1).mean()) >= _STEP
