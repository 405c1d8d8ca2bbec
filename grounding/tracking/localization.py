"""Localization of the robot in a video: the region of the image that shows it, however small it is.

The network recognizes a gripper whose apparent diameter is between a fifteenth and a half of its crop. Whole images
are tried first, on a few frames; where they show no gripper, or a smaller one, overlapping tiles of half and of a
quarter of the image are tried, and the region is enlarged around the cells that show the robot.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.tracking.view import GRIPPER_RADIUS_M, WIDE_SIZE, Crop, DenseEstimator, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.segments import evenly

PART_CELLS = 40
"""Cells from which a part counts as seen, or the robot in a tile."""
_SMALL_PX = 32.0
"""Diameter of a gripper in the crop of the whole image below which the region is enlarged [px]."""
_LEVELS = (2, 4)
"""Sizes of the image over that of a tile."""
_LEAST_TILE_PX = 128.0
"""Least size of a tile: in smaller ones a gripper that larger ones do not show is too small to be measured [px]."""
_MARGIN = 1.25
"""Size of the region over that of the box around the robot."""
_WRIST = (RobotPart.LINK6, RobotPart.LINK7)
_WRIST_BONUS = 4.0
_WHOLE_SHARE = 0.8
"""Size of the region over that of the image from which on the whole image is taken."""


def find_region(
    estimator: DenseEstimator,
    frames: Frames,
    camera: Camera,
    whole: Mapping[int, GripperView],
    hands: Mapping[int, Array] | None = None,
) -> Crop | None:
    """Return a crop for all frames (T, H, W, 3) that holds the visible robot; None if it is large enough in `whole`.

    Those are the views of the whole images by frame number; `hands` are poses (4, 4) of the grippers in them [m], which
    are fitted if None.
    """
    keys = evenly(len(frames), bounds.SAMPLED_FRAMES).tolist()
    if hands is None:
        hands = _fit_hands({key: whole[key] for key in keys})
    sizes = [_gripper_px(whole[key], hands.get(key)) for key in keys]
    if 2 * sum(size >= _SMALL_PX for size in sizes) > len(keys):
        return None
    boxes = [_robot_box(whole[key], camera) for key, size in zip(keys, sizes, strict=True) if size > 0]
    for level in _LEVELS:
        if 2 * len(boxes) > len(keys) or max(camera.width, camera.height) / level < _LEAST_TILE_PX:
            break
        for tile in tile_image(camera, level):
            views = [view for _, view in estimator.estimate(frames, camera, dict.fromkeys(keys, tile))]
            boxes += [_robot_box(views[k], camera) for k in _fit_hands(dict(enumerate(views)))]
    corners = [box for box in boxes if box is not None]
    return _region(np.array(corners), camera) if corners else None


def likeliest_gripper(view: GripperView) -> GripperView:
    """Return the view without the gripper cells outside the likeliest connected component of them.

    The largest wins; a component that touches the last two links, where a gripper sits, counts several times.
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats(view.gripper.astype(np.uint8), connectivity=8)
    if count <= 2:
        return view
    wrist = cv2.dilate(np.isin(view.part, _WRIST).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    touching = np.bincount(labels[wrist & view.gripper], minlength=count) > 0
    size = stats[:, cv2.CC_STAT_AREA] * np.where(touching, _WRIST_BONUS, 1.0)
    size[0] = 0.0
    return replace(view, part=np.where(view.gripper & (labels != size.argmax()), RobotPart.BACKGROUND, view.part))


def _fit_hands(views: Mapping[int, GripperView]) -> dict[int, Array]:
    """Return the poses X_CH (4, 4) of the grippers in views that show one [m]."""
    fits = {key: fit(likeliest_gripper(view)) for key, view in views.items()}
    return {key: hand.X_CH for key, hand in fits.items() if hand is not None}


def _gripper_px(view: GripperView, X_CH: Array | None) -> float:
    """Return the diameter of the gripper's bounding sphere in a crop [px]; 0 without a gripper."""
    return 0.0 if X_CH is None else 2 * GRIPPER_RADIUS_M / float(np.linalg.norm(X_CH[:3, 3])) * view.crop.focal


def _robot_box(view: GripperView, camera: Camera) -> Array | None:
    """Return the box (left, top, right, bottom) around the robot in the image [px]; None if the view shows none."""
    cells = view.part > 0
    v, u = np.nonzero(cells & view.in_image)
    if cells.sum() < PART_CELLS or not len(v):
        return None
    corners = np.column_stack([u + 0.5, v + 0.5, np.ones(len(v))]) @ view.crop.homography(camera, view.stride).T
    pixel = corners[:, :2] / corners[:, 2:]
    low, high = np.percentile(pixel, (2.0, 98.0), axis=0)  # a few cells elsewhere are errors
    return np.concatenate([low, high])


def tile_image(camera: Camera, level: int) -> Iterator[Crop]:
    """Yield crops of the size of the image over `level`, each overlapping its neighbours by half."""
    size = max(camera.width, camera.height) / level
    for v in _centres(camera.height, size):
        for u in _centres(camera.width, size):
            yield _crop_around(np.array([u, v]), size, camera)


def _centres(length: float, size: float) -> NDArray[np.float64]:
    count = max(1, int(np.ceil((length - size) / (size / 2))) + 1)
    return np.linspace(min(size, length) / 2, length - min(size, length) / 2, count)


def _region(boxes: Array, camera: Camera) -> Crop | None:
    low = boxes[:, :2].min(axis=0)
    high = boxes[:, 2:].max(axis=0)
    largest = max(camera.width, camera.height)
    size = _MARGIN * float((high - low).max())
    return None if size >= _WHOLE_SHARE * largest else _crop_around((low + high) / 2, size, camera)


def _crop_around(pixel: Array, size_px: float, camera: Camera) -> Crop:
    """Return the crop around a pixel (2,) that is at least `size_px` wide and high in the image."""
    x, y = (pixel - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    distance = float(np.linalg.norm([x, y, 1.0]))
    return Crop.towards([x, y, 1.0], size_px / 2 / min(camera.fx, camera.fy) / distance, WIDE_SIZE)
