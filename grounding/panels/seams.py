"""Seams between two pictures in one frame: straight, one pixel wide, and crossed by nothing."""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.grounding.panels.bands import BAR_PX, Luma
from kinebench_drake.io.video import MIN_SIDE_PX

_JUMP_LEVELS = 4.0
"""Least step of the grey level across a seam, where there is one."""
_JUMP_FACTOR = 2.0
"""Least ratio of that step to those before and after it."""
_USUAL = ((1, 2), (1, 3), (2, 3), (1, 4), (3, 4))
"""Places of seams in usual layouts, as fractions of the side."""
_RATIO = 5.0
"""Least ratio of the squared step across a seam at a usual place to the squared steps beside it."""
_FAINT = 0.12
_CLEAR = 0.35
"""Least shares of a seam with a step at a usual place: where nothing seems to cross it, and else. Between views of one
scene the share is as low as 0.14; single views have at most 0.3 at any line that little crosses."""
_OTHER_CLEAR = 0.7
_OTHER_RATIO = 25.0
"""The same bounds at any other place."""
_NOT_CROSSED = 0.35
_CROSSED = 0.6
"""Largest correlations of the outlines on both sides of a faint and of a clear seam: at edges of tables and floors 0.72
to 0.88, at seams at most 0.54, except between clips of one scene."""
_MOVING = 0.5
"""Largest correlation of what moves on both sides: 0.6 to 0.94 in single views, at most 0.47 at seams."""
_LEAST_MOTION = 3.0
"""Least motion on both sides of a line that can be compared, as the deviation in time [grey levels]."""
_STRONG_LEVELS = 60.0
"""Step between neighbours above which all outlines count alike."""
_DETAIL_PX = 10.0
"""Scale of the high-pass filter by which parts of a frame are compared [px]."""
_ALIKE = 0.8
"""Least correlation of parts of the first frame that show the same picture."""
_LEAST_DETAIL = 2.0
"""Least deviation of the detail of a picture that can be compared [grey levels]."""
_TRIED = 3
"""Number of lines that are tried along an axis."""
_ALIKE_LINES = 8
_ALIKE_SHARE = 0.7
"""Largest number of lines with steps in this share of what the seam has: in a picture that was enlarged without
smoothing every other line has them."""
_PARTS = 8
_STEPPED_PARTS = 5
_PART_SHARE = 0.1
"""Equal parts of a line, and least number of them in which this share has a step: the edge of one body has it in a
stretch, a seam along its whole length, but for where both pictures are dark or bright."""
_BAR_LEVELS = 8.0
"""Largest mean deviation along such a bar, into which both pictures bleed [grey levels]."""


def find_seam(luma: Luma) -> tuple[float, list[int]] | None:
    """Return the clearest seam between columns of a region: the share of it that has a step, and its column.

    If it is one edge of a narrow bar there are two columns.
    """
    width = luma.shape[2]
    if width < 2 * MIN_SIDE_PX:
        return None
    step = np.abs(np.diff(luma, axis=2))
    here = step[:, :, 1:-1]
    beside = np.maximum(step[:, :, :-2], step[:, :, 2:])
    has_step = (here > _JUMP_LEVELS) & (here > _JUMP_FACTOR * beside)
    shares = np.median(has_step.mean(axis=1), axis=0)
    power = (step**2).mean(axis=(0, 1))
    ratios = power[1:-1] / (0.5 * (power[:-2] + power[2:]) + 1.0)

    def is_seam(k: int) -> bool:
        is_usual = _is_usual(k + 2, width)
        is_clear = shares[k] >= (_CLEAR if is_usual else _OTHER_CLEAR)
        if (shares >= max(_ALIKE_SHARE * shares[k], _FAINT)).sum() > _ALIKE_LINES:
            return False
        if not (is_clear or (is_usual and shares[k] >= _FAINT)) or ratios[k] < (_RATIO if is_usual else _OTHER_RATIO):
            return False
        parts = [part.mean() >= _PART_SHARE for part in np.array_split(has_step[:, :, k], _PARTS, axis=1)]
        return sum(parts) >= _STEPPED_PARTS and not _is_crossed(luma, k + 2, _CROSSED if is_clear else _NOT_CROSSED)

    columns = np.arange(2, width - 1)
    fits = (columns >= MIN_SIDE_PX) & (columns <= width - MIN_SIDE_PX)
    order = [int(k) for k in np.argsort(-shares, kind="stable") if fits[k]]
    best = next((k for k in order[:_TRIED] if is_seam(k)), None)
    if best is None:
        return None
    near = [k for k in order if 1 < abs(k - best) <= BAR_PX and shares[k] >= _CLEAR and ratios[k] >= _RATIO]
    bar = [k for k in near if _is_bar(luma[:, :, min(k, best) + 2 : max(k, best) + 2])]
    return float(shares[best]), sorted(k + 2 for k in (best, *bar[:1]))


def _is_bar(strip: Luma) -> bool:
    return float(np.abs(strip - strip.mean(axis=(0, 1))).mean()) <= _BAR_LEVELS


def find_repetition(luma: Luma) -> int | None:
    """Return the column at which the picture of the first frame of a region begins anew, as real beside generated."""
    for count in (2, 3):
        width = int(luma.shape[2]) // count
        if luma.shape[2] % count == 0 and width >= MIN_SIDE_PX and _are_alike(*_parts(luma[0], width)):
            return width
    return None


def _parts(image: NDArray[np.float32], width: int) -> Iterator[NDArray[np.float32]]:
    """Yield the detail of the first two parts of an image that are `width` wide."""
    for part in (image[:, :width], image[:, width : 2 * width]):
        part = np.ascontiguousarray(part)
        yield part - cv2.GaussianBlur(part, (0, 0), _DETAIL_PX)


def _are_alike(a: NDArray[np.float32], b: NDArray[np.float32]) -> bool:
    deviations = float(a.std()), float(b.std())
    return min(deviations) >= _LEAST_DETAIL and _correlation(a, b) >= _ALIKE


def _is_usual(column: int, width: int) -> bool:
    return any(abs(column - width * n / d) <= 1.0 for n, d in _USUAL)


def _is_crossed(luma: Luma, column: int, most: float) -> bool:
    """Return whether outlines, by more than this correlation, or bodies that move go on across a line."""
    sides = luma[:, :, [column - 1, column]]
    outlines = np.minimum(np.abs(np.diff(sides, axis=1)), _STRONG_LEVELS)
    wide = np.maximum(np.maximum(outlines[:, :-2], outlines[:, 1:-1]), outlines[:, 2:])
    if _correlation(wide[..., 0], wide[..., 1]) > most:
        return True
    apart = luma[:, :, [column - 2, column + 1]]
    motion = np.abs(apart - np.median(apart, axis=0))
    size = np.sqrt((motion**2).mean(axis=(0, 1)))
    return bool(size.min() >= _LEAST_MOTION) and _correlation(motion[..., 0], motion[..., 1]) > _MOVING


def _correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Return the correlation of two arrays of numbers; 0 if one of them is constant."""
    a = a - a.mean()
    b = b - b.mean()
    norm = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / norm if norm > 0.0 else 0.0
