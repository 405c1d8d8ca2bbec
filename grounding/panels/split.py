"""Division of the frames of a video into panels, by the picture alone: cuts from edge to edge, one within another."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from kinebench_drake.grounding.panels.bands import BAND_PX, Luma, cut_bands, is_flat, shows_text
from kinebench_drake.grounding.panels.panel import PanelKind, Rectangle
from kinebench_drake.grounding.panels.seams import find_repetition, find_seam
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.video import MIN_SIDE_PX
from kinebench_drake.segments import evenly

_FRAMES = 8
"""Number of frames that are compared; the first one included."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """Part of a frame that holds no seam."""

    rectangle: Rectangle
    kind: PanelKind | None
    """`EMPTY` or `TEXT`; None for a picture."""


def split_frames(frames: Frames) -> tuple[Tile, ...]:
    """Return the tiles of which frames (T, H, W, 3) consist; a single view is one tile of the whole frame.

    Bars of one colour that are narrower than the smallest picture are left out. One picture between such bars counts as
    a single view: a letter-box is part of its framing (`camera.framing`).
    """
    luma = np.stack([cv2.cvtColor(f, cv2.COLOR_RGB2GRAY) for f in np.asarray(frames[evenly(len(frames), _FRAMES)])])
    height, width = luma.shape[1:]
    whole = Rectangle(left=0, top=0, width=width, height=height)
    tiles = tuple(_split(luma.astype(np.float32), whole, height))
    pictures = [tile for tile in tiles if tile.kind is None]
    has_text = any(tile.kind is PanelKind.TEXT for tile in tiles)
    if len(pictures) < 2 and not (pictures and has_text):
        return (Tile(rectangle=whole, kind=None),)
    return tiles


def _split(luma: Luma, region: Rectangle, frame_height: int) -> Iterator[Tile]:
    """Yield the tiles of a region of the frame."""
    if min(region.width, region.height) < BAND_PX:
        return
    if is_flat(luma) or shows_text(luma, frame_height):
        kind = PanelKind.EMPTY if is_flat(luma) else PanelKind.TEXT
        if kind is PanelKind.TEXT or min(region.width, region.height) >= MIN_SIDE_PX:
            yield Tile(rectangle=region, kind=kind)
        return
    upright, cuts = _find_cuts(luma, frame_height)
    if not cuts:
        yield Tile(rectangle=region, kind=None)
        return
    for start, stop in _stretches(cuts, region.height if upright else region.width):
        part = Rectangle(
            left=0 if upright else start,
            top=start if upright else 0,
            width=region.width if upright else stop - start,
            height=stop - start if upright else region.height,
        )
        inside = luma[:, part.top : part.top + part.height, part.left : part.left + part.width]
        yield from _split(inside, part.within(region), frame_height)


def _stretches(cuts: list[int], length: int) -> Iterator[tuple[int, int]]:
    return zip((0, *cuts), (*cuts, length), strict=True)


def _find_cuts(luma: Luma, frame_height: int) -> tuple[bool, list[int]]:
    """Return whether a region is cut between rows, and where: along bands, else at its clearest seam, else none."""
    turned = np.swapaxes(luma, 1, 2)
    axes = ((True, turned), (False, luma))
    for upright, image in axes:
        cuts = cut_bands(image)
        parts = [image[:, :, start:stop] for start, stop in _stretches(cuts, image.shape[2])]
        if not all(_is_whole(part, upright, frame_height) for part in parts):
            cuts = _cut_captions(luma, cuts, frame_height) if upright else []
        if cuts:
            return upright, cuts
    seams = [(*seam, upright) for upright, image in axes if (seam := find_seam(image)) is not None]
    if seams:
        _, places, upright = max(seams)
        return upright, places
    for upright, image in axes:
        place = find_repetition(image)
        if place is not None:
            return upright, [place]
    return False, []


def _is_whole(part: Luma, upright: bool, frame_height: int) -> bool:
    """Return whether what lies between two cuts is a band, or large enough for a picture."""
    if part.shape[2] >= MIN_SIDE_PX or is_flat(part):
        return True
    return shows_text(np.swapaxes(part, 1, 2) if upright else part, frame_height)


def _cut_captions(luma: Luma, rows: list[int], frame_height: int) -> list[int]:
    """Return those of the rows that divide a region from the text above and below; none without text."""
    above = [row for row in rows if shows_text(luma[:, :row], frame_height)]
    below = [row for row in rows if shows_text(luma[:, row:], frame_height)]
    return above[-1:] + below[:1]
