"""Bands of one colour in the frames of a tile, with or without text, and the cuts along their edges."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.segments import segments

Luma = NDArray[np.float32]
"""(T, H, W) grey levels of a few frames of a video, 0 to 255."""
_LEVELS = 7.0
"""Grey levels by which the pixels of one colour may vary, over its area and in time (as of bars, `camera.framing`)."""
_OUTLIERS = 0.02
"""Largest share of a line's pixels that may vary by more."""
_MEAN_LEVELS = 1.8
"""Largest mean deviation of a line of one colour [grey levels]: along the grain of wood 2.1 to 2.6, drawn bars after
their coding at most 1.7."""
_BLUR_PX = 8
"""Width to which a codec blurs an edge [px]."""
_LEAST_LINES = 2
"""Least width of a band [px]."""
_EDGE_LEVELS = 15.0
"""Least difference of a picture from the band beside it [grey levels]: along the grain of wood up to 12."""
_EDGE_SHARE = 0.4
"""Least share of the pixels beside the edge of a band that differ so much from its colour: the outline of a body before
a flat background has less."""
_PAPER_LEVELS = 12.0
"""Grey levels by which the ground of text may vary."""
_PAPER_SHARE = 0.6
"""Least share of it."""
_INK_LEVELS = 60.0
_INK_SHARE = 0.005
"""Least contrast of ink with its ground, and least share of pixels that have it."""
_CHANGE_LEVELS = 25.0
"""Difference of grey levels in time that is a change."""
_CHANGED_SHARE = 0.05
"""Largest share of pixels of a band of text that change: those of a counter."""
BAR_PX = 16
"""Largest width of a bar between two pictures: of its edges one may be faint [px]."""
BAND_PX = 10
"""Least height of a band of text; what is narrower is a bar [px]."""
_TEXT_SIDE = 0.25
"""Largest height of a band of text over the side of the frame."""


def is_flat(luma: Luma) -> bool:
    """Return whether a region has one constant colour."""
    return bool(_flat_lines(luma).all()) and float(np.ptp(np.median(luma, axis=(0, 1)))) <= _LEVELS


def shows_text(luma: Luma, frame_height: int) -> bool:
    """Return whether a region is a band of text: static ink within a ground of one colour."""
    lines = _flat_lines(np.swapaxes(luma, 1, 2))
    if not BAND_PX <= luma.shape[1] <= _TEXT_SIDE * frame_height:
        return False
    if not (lines[:_BLUR_PX].any() and lines[-_BLUR_PX:].any()):
        return False
    contrast = np.abs(luma - np.median(luma))
    is_printed = (contrast <= _PAPER_LEVELS).mean() >= _PAPER_SHARE and (contrast > _INK_LEVELS).mean() >= _INK_SHARE
    changed = np.ptp(luma, axis=0) > _CHANGE_LEVELS
    return bool(is_printed and changed.mean() <= _CHANGED_SHARE)


def cut_bands(luma: Luma) -> list[int]:
    """Return the columns at which a region is cut along the straight edges of bands of one colour, in order."""
    width = luma.shape[2]
    colours = luma.mean(axis=(0, 1))
    changes = np.abs(np.diff(colours, append=colours[-1])) > _LEVELS
    cuts: set[int] = set()
    for stretch in segments(_flat_lines(luma)):
        ends = [*(k + 1 for k in range(stretch.start, stretch.stop - 1) if changes[k]), stretch.stop]
        for start, stop in zip([stretch.start, *ends], ends, strict=False):
            if stop - start >= _LEAST_LINES:
                colour = float(np.median(colours[start:stop]))
                before = [k + 1 for k in range(start - 1, max(start - _BLUR_PX, 0) - 1, -1)]
                after = list(range(stop, min(stop + _BLUR_PX, width)))
                edges = _first_edge(luma, before, colour, -1), _first_edge(luma, after, colour, 0)
                if any(edges) and stop - start <= BAR_PX:
                    edges = (
                        _first_edge(luma, before, colour, -1, _LEVELS),
                        _first_edge(luma, after, colour, 0, _LEVELS),
                    )
                cuts.update(*edges)
    return sorted(cuts)


def _flat_lines(luma: Luma) -> NDArray[np.bool_]:
    """Return the columns (W,) that have one constant colour."""
    off = np.abs(luma - luma.mean(axis=(0, 1)))
    is_even = off.mean(axis=(0, 1)) <= _MEAN_LEVELS
    return np.asarray(is_even & ((off > _LEVELS).mean(axis=(0, 1)) <= _OUTLIERS))


def _first_edge(luma: Luma, places: list[int], colour: float, side: int, levels: float = _EDGE_LEVELS) -> list[int]:
    """Return the first of the places beyond which lines differ from a colour by these grey levels; none if all do not.

    The line beyond a place is the one before it (`side` -1), or the one after it (0).
    """
    off = np.abs(luma[:, :, [place + side for place in places]] - colour) > levels
    differs = off.mean(axis=(0, 1)) >= _EDGE_SHARE
    return [place for place, is_beyond in zip(places, differs, strict=True) if is_beyond][:1]
