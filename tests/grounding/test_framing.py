"""Framing of a video: detected for all usual framings, and undone by a changed camera."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.grounding.camera.framing import (
    Framing,
    FramingChange,
    FramingSource,
    find_framing,
    letterboxes,
    placements,
    undo_framing,
)
from kinebench_drake.grounding.priors import ExternalDepth, Priors

SIZES = [(832, 480), (720, 480), (512, 512), (480, 832)]
CAMERA = benchmark_camera()


def scene(seed):
    """Blurred coloured shapes."""
    rng = np.random.default_rng(seed)
    image = np.full((384, 384, 3), rng.integers(60, 180, 3), np.uint8)
    for _ in range(25):
        centre = rng.integers(0, 384, 2).tolist()
        radius = int(rng.integers(8, 60))
        cv2.circle(image, centre, radius, rng.integers(0, 255, 3).tolist(), -1, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


IMAGE = scene(0)


def shown(framing, picture=IMAGE, frames=3):
    """Frames that show the image in this framing, with a moving object, noise and changed brightness."""
    (sx, _, ox), (_, sy, oy) = framing.map
    M = np.array([[sx, 0.0, ox + 0.5 * sx - 0.5], [0.0, sy, oy + 0.5 * sy - 0.5]])
    inside = cv2.warpAffine(np.ones_like(picture), M, (framing.width, framing.height), flags=cv2.INTER_NEAREST)
    image = cv2.warpAffine(
        picture, M, (framing.width, framing.height), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE
    )
    noise = np.random.default_rng(1).normal(0.0, 3.0, image.shape)
    dimmed = np.clip(0.9 * image + 8.0 + noise, 0, 255) * inside
    video = np.stack([dimmed.astype(np.uint8)] * frames)
    for k, frame in enumerate(video):
        x = framing.width // 2 + 4 * k
        y = framing.height // 2
        frame[y : y + 20, x : x + 20] = 255
    return video


def all_framings():
    return [(size, framing) for size in SIZES for framing in placements((384, 384), size)]


@pytest.mark.parametrize(("size", "framing"), all_framings())
def test_the_framed_camera_projects_points_where_the_framing_moves_them(size, framing):
    camera = framing.camera(CAMERA)
    rows, columns = framing.window
    assert (camera.width, camera.height) == framing.crop(np.zeros((1, *size[::-1], 3), np.uint8)).shape[2:0:-1]
    p_C = np.random.default_rng(0).normal([0.0, 0.0, 0.7], 0.1, (20, 3))
    moved = CAMERA.project(p_C) * np.diag(framing.map) + framing.map[:, 2] - [columns.start, rows.start]
    np.testing.assert_allclose(camera.project(p_C), moved, atol=1e-9)
    np.testing.assert_allclose(framing.camera(CAMERA.resized(256, 256)).K, camera.K, atol=1e-9)


@pytest.mark.parametrize(("size", "framing"), [f for f in all_framings() if f[0] != (480, 832)])
def test_a_usual_framing_is_identified_exactly_from_the_first_frames_image(size, framing):
    result = find_framing(shown(framing), CAMERA, IMAGE)
    np.testing.assert_allclose(result.map, framing.map)  # exactly: it is a usual one
    assert result.changes == framing.changes
    assert (result.source, result.correlation > 0.9) == (FramingSource.FIRST_FRAME, True)


@pytest.mark.parametrize("framing", [framing for _, framing in all_framings()])
def test_undoing_a_framing_restores_the_image(framing):
    frames = framing.crop(shown(framing, frames=1))
    restored = undo_framing(framing, frames)[0]
    inside = undo_framing(framing, np.ones(frames.shape[:3], bool))[0]
    picture = cv2.resize(IMAGE, restored.shape[1::-1], interpolation=cv2.INTER_AREA)
    assert (inside.mean() < 0.98) == (FramingChange.CROP in framing.changes)
    inside = cv2.erode(inside.astype(np.uint8), np.ones((5, 5))) > 0
    inside[:, restored.shape[1] // 2 - 40 : restored.shape[1] // 2 + 60] = False  # something moves there
    assert abs(restored.shape[0] / restored.shape[1] - 1.0) < 0.01
    assert inside.sum() > 2000
    assert np.abs(0.9 * picture[inside] + 8.0 - restored[inside]).mean() < 8.0


def test_an_unusual_crop_is_estimated_within_a_pixel():
    framing = replace(
        Framing.filling((384, 384), (720, 480)), scale_x=2.3, scale_y=2.3, offset_x=-61.0, offset_y=-230.0
    )
    result = find_framing(shown(framing), CAMERA, IMAGE)
    assert result.changes == (FramingChange.CROP,)
    assert np.abs(result.corners - framing.corners).max() < 0.6


def test_another_image_does_not_determine_the_framing():
    video = shown(Framing.filling((384, 384), (512, 512)))
    assert find_framing(video, CAMERA, scene(9)).source is FramingSource.SIZE
    wide = shown(placements((384, 384), (720, 480))[-1])
    with pytest.raises(UnmeasurableError, match=r"384 x 384, the video 720 x 480.*first frame's image"):
        find_framing(wide, CAMERA, scene(9))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(384, 384), (1, 1), (9, 9)])
def test_an_image_of_one_colour_does_not_determine_the_framing(size):
    video = shown(Framing.filling((384, 384), (512, 512)))
    assert find_framing(video, CAMERA, np.full((*size, 3), 90, np.uint8)).source is FramingSource.SIZE


@pytest.mark.parametrize("framing", letterboxes((384, 384), (832, 480)))
def test_letterbox_bars_are_identified_without_a_first_frames_image(framing):
    result = find_framing(shown(framing), CAMERA, None)
    assert (result.changes, result.source) == ((FramingChange.LETTERBOX,), FramingSource.BARS)
    np.testing.assert_allclose(result.map, framing.map)


def test_dark_image_sides_are_not_mistaken_for_letterbox_bars():
    video = shown(Framing.filling((384, 384), (832, 480)))
    with pytest.raises(UnmeasurableError, match="no bars of one colour"):
        find_framing(video, CAMERA, None)
    video[:, :, :300] = 0  # the dark reaches into what would be the picture
    with pytest.raises(UnmeasurableError, match="no bars of one colour"):
        find_framing(video, CAMERA, None)


def test_a_camera_of_the_videos_size_is_left_unchanged():
    framing = placements((384, 384), (832, 480))[-1]
    own = framing.camera(CAMERA)
    assert find_framing(shown(framing), own, IMAGE).camera(own).to_json() == own.to_json()


def test_mask_and_depth_priors_are_cropped_with_the_framing():
    framing = letterboxes((384, 384), (832, 480))[0]
    rows, columns = framing.window
    mask = np.zeros((2, 480, 832), bool)
    mask[:, rows, columns] = True
    priors = Priors(mask=mask, depth=ExternalDepth(depth_m=mask.astype(float))).crop(rows, columns)
    assert priors.mask.all()
    assert priors.depth.depth_m.shape == (2, 480, 480)
