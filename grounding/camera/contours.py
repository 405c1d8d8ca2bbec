"""Contours of the robot in the images of a video, as observations of a bundle adjustment."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.bundle import ArmScene, Observations
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import (
    LEAST_GRADIENT,
    RIGID,
    ROBOT,
    SIGMA_PX,
    EdgeMatcher,
    GradientImage,
)
from kinebench_drake.grounding.tracking.view import Frames
from kinebench_drake.models.panda.cad import open_fingers
from kinebench_drake.models.panda.robot import OPENING_SIGN, RobotPart

_INDEPENDENT = 120.0  # independent measurements that the contours of an image count as at most
_WITH_FINGERS_PX = 6.0  # reach beyond which fingers count, too: grippers have fingers of many forms
_MIN_POINTS = 20
_SIGN = np.array([OPENING_SIGN.get(part, 0.0) for part in RobotPart])


class ContourImages:
    """Images of several frames in which the contours of the robot are searched."""

    def __init__(self, frames: Frames, camera: Camera, model: ArmModel, matcher: EdgeMatcher) -> None:
        """Compute the gradients of `frames` (T, H, W, 3); only the size of `camera` matters."""
        self._images = [GradientImage(frame, camera) for frame in frames]
        self._model, self._matcher = model, matcher
        self._left_out: tuple[RobotPart, ...] = ()

    def take(self, rows: Sequence[int] | NDArray[np.intp]) -> "ContourImages":
        """Select frames."""
        chosen = object.__new__(ContourImages)
        chosen._images = [self._images[row] for row in rows]
        chosen._model, chosen._matcher, chosen._left_out = self._model, self._matcher, self._left_out
        return chosen

    def without(self, *parts: RobotPart) -> "ContourImages":
        """Return the images without the contours of some parts, which still hide others."""
        rest = self.take(range(len(self._images)))
        rest._left_out = parts
        return rest

    def _poses(self, scene: ArmScene) -> list[Array]:
        """Return for each frame the poses (PARTS, 4, 4) of the parts in the camera frame [m]."""
        X_CP = scene.lens.X_CB @ self._model.poses(scene.q)
        return [open_fingers(X, finger_m) for X, finger_m in zip(X_CP, scene.finger_m, strict=True)]

    def observe(self, scene: ArmScene, reach_px: float) -> Observations | None:
        """Return the visible contour points of a scene with the image edges nearby; None if there are too few.

        Args:
            scene: camera and postures.
            reach_px: farthest edge in an image of at most 640 px.
        """
        parts = self._used(ROBOT if reach_px > _WITH_FINGERS_PX else RIGID)
        observed = []
        for t, (image, X_CP) in enumerate(zip(self._images, self._poses(scene), strict=True)):
            camera = scene.lens.camera.resized(image.camera.width, image.camera.height)
            points = self._matcher.project(X_CP, camera, parts)
            if points is None:
                continue
            move, strength = image.find_edges(points, reach_px)
            strong = np.flatnonzero(strength > LEAST_GRADIENT)
            n = len(strong)
            if n < _MIN_POINTS:
                continue
            zoom = scene.lens.camera.width / camera.width
            normal = points.normal[strong]
            whitening = np.zeros((n, 2, 2))
            whitening[:, 0] = normal / (SIGMA_PX * zoom)
            observed.append(
                Observations(
                    frame=np.full(n, t, dtype=np.intp),
                    part=points.part[strong],
                    p_P=points.p_P[strong],
                    opening_sign=_SIGN[points.part[strong]],
                    uv_px=(points.pixel[strong] + move[strong, None] * normal) * zoom,
                    whitening=whitening,
                    weight=np.full(n, min(1.0, _INDEPENDENT / n)),
                )
            )
        return Observations.join(observed) if observed else None

    def base_share(self, scene: ArmScene) -> float:
        """Return the share of the visible contours of the base link that lies on image edges; 0 if too few are seen."""
        on_edges, points_visible = 0.0, 0
        for image, X_CP in zip(self._images, self._poses(scene), strict=True):
            camera = scene.lens.camera.resized(image.camera.width, image.camera.height)
            points = self._matcher.project(X_CP, camera, (RobotPart.LINK0,))
            if points is not None and len(points.part) >= _MIN_POINTS:
                on_edges += float(self._matcher.edge_shares(image, points).sum())
                points_visible += len(points.part)
        return on_edges / points_visible if points_visible else 0.0

    def _used(self, parts: tuple[RobotPart, ...]) -> tuple[RobotPart, ...]:
        return tuple(part for part in parts if part not in self._left_out)

    def agreement(self, scene: ArmScene) -> Array:
        """Return the share (T,) of the contours of hand and arm that lies on image edges, frame by frame.

        Mean of the share of all contours and of the mean over the parts: the base is short of contours, but decides.
        """
        return np.array([self._agreement(*pair, scene) for pair in zip(self._images, self._poses(scene), strict=True)])

    def _agreement(self, image: GradientImage, X_CP: Array, scene: ArmScene) -> float:
        camera = scene.lens.camera.resized(image.camera.width, image.camera.height)
        points = self._matcher.project(X_CP, camera, self._used(RIGID))
        if points is None:
            return 0.0
        on_edge = self._matcher.edge_shares(image, points)
        count = np.bincount(points.part, minlength=len(RobotPart))
        shares = np.bincount(points.part, weights=on_edge, minlength=len(RobotPart)) / np.maximum(count, 1)
        enough = count >= _MIN_POINTS
        return float(on_edge.mean() + shares[enough].mean()) / 2 if enough.any() else float(on_edge.mean())
