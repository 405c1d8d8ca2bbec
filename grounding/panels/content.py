"""Content of panels: whether one shows a robot from outside, or what the hand sees."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.grounding.camera.estimate import usual_camera
from kinebench_drake.grounding.panels.bands import Luma
from kinebench_drake.grounding.panels.panel import Panel, PanelKind, Rectangle, name_places, sort_panels
from kinebench_drake.grounding.panels.split import Tile
from kinebench_drake.grounding.tracking.view import Crop, DenseEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.segments import evenly

_FRAMES = 8
"""Number of frames in which motion and robot are looked for."""
_MOTION_SIZE = (160, 96)
"""Width and height at which motion is measured [px]."""
_PATCH_PX = 9
"""Side of the patches that are compared between two frames [px]."""
_TEXTURE_LEVELS = 5.0
"""Least deviation of a patch that can be compared [grey levels]."""
_SAME = 0.7
"""Correlation from which on a patch shows the same in two frames."""
_MOVING_LEVELS = 8.0
"""Deviation in time from which on a pixel changes [grey levels]."""
_WRIST_CHANGED = 0.5
_WRIST_SAME = 0.4
"""Least share of pixels that change, and largest share of patches that stay, in the view of a camera on the hand. In
11 real episodes (`docs/footage.md`) such views have 0.84 to 0.98 and 0.05 to 0.32, views from outside 0.14 to 0.61 and
0.49 to 0.91."""
_LEAST_ROBOT = 0.01
"""Least share of the picture that shows the arm, in the frame that shows most of it: from outside 0.018 or more."""


def list_panels(frames: Frames, tiles: Sequence[Tile], estimator: DenseEstimator) -> tuple[Panel, ...]:
    """Return the panels of frames (T, H, W, 3) in reading order, with what each shows.

    Args:
        estimator: estimates of the arm whatever its gripper.
    """
    kinds = {tile.rectangle: tile.kind for tile in tiles}
    counted = sort_panels([r for r, kind in kinds.items() if kind is not PanelKind.TEXT])
    names = dict(zip(counted, name_places(counted), strict=True))
    panels = []
    for r in sort_panels(list(kinds)):
        kind = kinds[r]
        robot_px = 0.0
        if kind is None:
            kind, robot_px = _look(r, frames, estimator)
        number = counted.index(r) + 1 if r in names else None
        panels.append(Panel(rectangle=r, kind=kind, number=number, name=names.get(r), robot_px=robot_px))
    return tuple(panels)


def _look(rectangle: Rectangle, frames: Frames, estimator: DenseEstimator) -> tuple[PanelKind, float]:
    """Return what a picture in frames (T, H, W, 3) shows, and the mean number of pixels of the arm."""
    pictures = np.asarray(rectangle.crop(frames)[evenly(len(frames), _FRAMES)])
    shares = _robot_shares(pictures, estimator)
    robot_px = float(shares.mean()) * rectangle.width * rectangle.height
    if _is_from_hand(pictures):
        return PanelKind.WRIST, robot_px
    return (PanelKind.EXTERIOR if shares.max() >= _LEAST_ROBOT else PanelKind.NO_ROBOT), robot_px


def _robot_shares(pictures: NDArray[np.uint8], estimator: DenseEstimator) -> NDArray[np.float64]:
    """Return the share of each picture (T, h, w, 3) that shows links of the arm."""
    camera = usual_camera(pictures.shape[2], pictures.shape[1])
    crops = {k: Crop.of_frame(camera) for k in range(len(pictures))}
    views = dict(estimator.estimate(pictures, camera, crops))
    return np.array([(views[k].arm & views[k].in_image).sum() / views[k].in_image.sum() for k in sorted(views)])


def _is_from_hand(pictures: NDArray[np.uint8]) -> bool:
    """Return whether most of the pictures (T, h, w, 3) moves, as the background does for a camera on the hand.

    A body that passes, a change of the light, or of the exposure leaves most outlines where they are.
    """
    small = [cv2.resize(p, _MOTION_SIZE, interpolation=cv2.INTER_AREA) for p in pictures]
    luma: Luma = np.stack([cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in small]).astype(np.float32)
    if float((luma.std(axis=0) > _MOVING_LEVELS).mean()) < _WRIST_CHANGED:
        return False
    means = [_smooth(image) for image in luma]
    variances = [np.maximum(_smooth(image**2) - mean**2, 0.0) for image, mean in zip(luma, means, strict=True)]
    shares = []
    for i, j in zip(*np.triu_indices(len(luma), 1), strict=True):
        has_texture = np.minimum(variances[i], variances[j]) > _TEXTURE_LEVELS**2
        covariance = _smooth(luma[i] * luma[j]) - means[i] * means[j]
        same = covariance > _SAME * np.sqrt(variances[i] * variances[j] + 1.0)
        if has_texture.any():
            shares.append(float(same[has_texture].mean()))
    return bool(shares) and float(np.median(shares)) <= _WRIST_SAME


def _smooth(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.blur(image, (_PATCH_PX, _PATCH_PX)), np.float32)
