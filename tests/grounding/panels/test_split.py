"""Division of tiled frames into panels, their kinds and names."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.grounding.panels.content import list_panels
from kinebench_drake.grounding.panels.panel import Panel, PanelKind, Rectangle, choose_panel, name_places, sort_panels
from kinebench_drake.grounding.panels.split import split_frames
from kinebench_drake.io.reader import read_video
from tests.fakes.resources import FakeEstimator

EXAMPLES = sorted((Path(__file__).parents[3] / "examples" / "videos").glob("*.mp4"))
LAYOUTS = {
    "three beside each other": (960, 192, [(0, 0, 320, 192), (320, 0, 320, 192), (640, 0, 320, 192)]),
    "real row above generated row": (960, 384, [(x, y, 320, 192) for y in (0, 192) for x in (0, 320, 640)]),
    "one above two": (640, 352, [(0, 0, 640, 176), (0, 176, 320, 176), (320, 176, 320, 176)]),
    "one above two small ones": (640, 540, [(0, 0, 640, 360), (0, 360, 320, 180), (320, 360, 320, 180)]),
    "three of four": (768, 432, [(0, 0, 384, 216), (384, 0, 384, 216), (0, 216, 384, 216)]),
    "two beside each other": (640, 256, [(0, 0, 320, 256), (320, 0, 320, 256)]),
    "with bars": (648, 400, [(0, 0, 320, 196), (328, 0, 320, 196), (0, 204, 320, 196), (328, 204, 320, 196)]),
}


def example(path, size=None):
    frames = np.asarray(read_video(path).frames)[::7]
    return frames if size is None else np.stack([cv2.resize(f, size, interpolation=cv2.INTER_AREA) for f in frames])


def texture(seed, size, speed=0, frames=7):
    """A film of smooth noise (T, h, w, 3) that shifts by `speed` px a frame."""
    noise = np.random.default_rng(seed).normal(size=(size[1] + 40, size[0] + speed * frames))
    image = cv2.GaussianBlur(noise, (0, 0), 4.0)
    image = (60 + 25 * seed + 120 * image / np.abs(image).max()).clip(0, 255).astype(np.uint8)
    return np.stack([np.repeat(image[: size[1], speed * k :][:, : size[0], None], 3, 2) for k in range(frames)])


def tile(width, height, boxes, pictures, ground=0):
    film = np.full((7, height, width, 3), ground, np.uint8)
    for (x, y, w, h), picture in zip(boxes, pictures, strict=True):
        film[:, y : y + h, x : x + w] = picture
    return film


def boxes_of(tiles):
    ordered = sort_panels([t.rectangle for t in tiles])
    kinds = {t.rectangle: t.kind for t in tiles}
    return [((r.left, r.top, r.width, r.height), kinds[r]) for r in ordered]


@pytest.mark.parametrize("source", ["examples", "textures"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_tiles_are_split_to_the_pixel_and_their_frames_are_those_of_the_pictures(layout, source):
    width, height, boxes = LAYOUTS[layout]
    if source == "examples":
        paths = EXAMPLES[::2]
        pictures = [example(paths[k % 4], box[2:]) for k, box in enumerate(boxes)]
    else:
        pictures = [texture(k, box[2:]) for k, box in enumerate(boxes)]
    film = tile(width, height, boxes, pictures)
    tiles = split_frames(film)
    panels = [(box, kind) for box, kind in boxes_of(tiles) if kind is None]
    assert [box for box, _ in panels] == boxes
    for box, picture in zip(boxes, pictures, strict=True):
        assert np.array_equal(Rectangle(left=box[0], top=box[1], width=box[2], height=box[3]).crop(film), picture)
    assert (PanelKind.EMPTY in [t.kind for t in tiles]) == (layout == "three of four")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_a_single_view_is_one_tile_also_between_bars(path):
    film = example(path)
    barred = np.pad(film, ((0, 0), (48, 48), (0, 0), (0, 0)))
    assert boxes_of(split_frames(film)) == [((0, 0, 384, 384), None)]
    assert boxes_of(split_frames(barred)) == [((0, 0, 384, 480), None)]


def test_a_straight_edge_that_a_body_crosses_is_no_seam():
    film = np.concatenate([texture(1, (320, 120)), texture(4, (320, 120))], axis=1)
    assert len(split_frames(film)) == 2
    for k, frame in enumerate(film):
        frame[40:200, 20 + 30 * k : 60 + 30 * k] = 255
    assert len(split_frames(film)) == 1


def test_a_generated_picture_beside_the_real_one_begins_alike_and_is_split_where_no_step_shows():
    half = texture(1, (100, 150))
    real = np.concatenate([half, half[:, :, ::-1]], axis=2)  # its last column is like its first one
    film = np.concatenate([real, real], axis=2)
    assert [box for box, _ in boxes_of(split_frames(film))] == [(0, 0, 200, 150), (200, 0, 200, 150)]


def test_a_caption_is_text_and_what_moves_as_a_whole_is_the_view_of_the_hand():
    boxes = [(0, 40, 200, 160), (200, 40, 200, 160)]
    film = tile(400, 200, boxes, [texture(1, (200, 160)), texture(2, (200, 160), speed=9)], ground=255)
    for frame in film:
        cv2.putText(frame, "Real  Generated", (10, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0))
    film[3, 100:120, 50:90] = 255
    panels = list_panels(film, split_frames(film), FakeEstimator())
    assert [(p.number, p.name, p.kind) for p in panels] == [
        (None, None, PanelKind.TEXT),
        (1, "left", PanelKind.EXTERIOR),
        (2, "right", PanelKind.WRIST),
    ]


def panel(number, name, kind=PanelKind.EXTERIOR, robot_px=0.0):
    rectangle = Rectangle(left=0, top=0, width=64, height=64)
    return Panel(rectangle=rectangle, kind=kind, number=number, name=name, robot_px=robot_px)


def test_names_are_places_and_unique():
    row = [Rectangle(left=100 * k, top=0, width=100, height=80) for k in range(3)]
    below = [Rectangle(left=0, top=80, width=150, height=80), Rectangle(left=150, top=80, width=150, height=80)]
    assert name_places(row) == ["left", "middle", "right"]
    assert name_places(row + below) == ["top-left", "top-middle", "top-right", "bottom-left", "bottom-right"]
    assert name_places([Rectangle(left=80 * k, top=0, width=80, height=80) for k in range(4)]) == [None] * 4
    assert sort_panels([*below, *row[::-1]]) == [*row, *below]


def test_auto_takes_the_exterior_panel_with_most_of_the_robot_and_a_name_takes_any():
    panels = [
        panel(1, "left", robot_px=5.0),
        panel(2, "middle", robot_px=9.0),
        panel(3, "right", PanelKind.WRIST, 50.0),
    ]
    assert choose_panel(panels, "auto").number == 2
    assert choose_panel(panels, "3") is choose_panel(panels, "right") is panels[2]
    with pytest.raises(InputError, match=r"4: the frames have 3 panels, 1 or left \(exterior\), 2 or middle"):
        choose_panel(panels, "4")
    with pytest.raises(UnmeasurableError, match="none of which shows a robot from outside"):
        choose_panel(panels[2:], "auto")
