"""The usual ways to fit a picture into a video of another size."""

from dataclasses import replace

from kinebench_drake.grounding.framing import SQUARE, Framing

_PLACES = (0.5, 0.0, 1.0)  # centred, at the beginning, at the end
_ZOOMS = (1.15, 1.35)  # crops that are deeper than they need to be


def placements(picture: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """What resizing programs do: scale, stretch, letter-box and crop, the last two centred or at an edge.

    Args:
        picture: width and height of the picture [px].
        video: width and height of the video [px].
    """
    filled = Framing.filling(picture, video)
    if abs(filled.scale_x / filled.scale_y - 1.0) <= SQUARE:
        return [filled]
    least, most = sorted((filled.scale_x, filled.scale_y))
    return [filled, *(_placed(filled, scale, place) for scale in (least, most) for place in _PLACES)]


def letterboxes(picture: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """The picture inside the video with bars, centred or at an edge; none where it fills the video."""
    filled = Framing.filling(picture, video)
    if abs(filled.scale_x / filled.scale_y - 1.0) <= SQUARE:
        return []
    return [_placed(filled, min(filled.scale_x, filled.scale_y), place) for place in _PLACES]


def deeper_crops(picture: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """Centred crops that show less than would fill the video; where a search for a free one may begin."""
    filled = Framing.filling(picture, video)
    return [_placed(filled, zoom * max(filled.scale_x, filled.scale_y), 0.5) for zoom in _ZOOMS]


def _placed(filled: Framing, scale: float, place: float) -> Framing:
    return replace(
        filled,
        scale_x=scale,
        scale_y=scale,
        offset_x=place * (filled.width - scale * filled.picture_width),
        offset_y=place * (filled.height - scale * filled.picture_height),
    )
