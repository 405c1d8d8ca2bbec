"""Contours of the robot in the images of a video, as observations of a bundle adjustment.

Links 1 to 7 look the same if the base turns one way and joint 1 the other: they give the axis and the shoulder on it.
Only the contours of the base link say how the base stands.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, Observations
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.correspondences import MIN_POINTS
from kinebench_drake.grounding.registration.edges import (
    INDEPENDENT,
    LEAST_GRADIENT,
    RIGID,
    ROBOT,
    SIGMA_PX,
    EdgeMatcher,
)
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS
from kinebench_drake.models.panda.cad import open_fingers
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.segments import evenly

DIFFERENT_TURN_RAD = np.deg2rad(20.0)
"""Least angle between turns that count as different."""
_WITH_FINGERS_PX = 6.0
"""Reach beyond which fingers count, too [px]: grippers have fingers of many forms."""
_RIGHT_RAD = np.deg2rad(15.0)
"""Tolerance of a right angle between two turns [rad]."""
_FRAMES = 6
_STEP_RAD = np.deg2rad(5.0)
_TOPS = 6
_FINE_STEPS_RAD = np.deg2rad([-3.75, -2.5, -1.25, 1.25, 2.5, 3.75])


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseTurn:
    """Turn of the base that its contours show."""

    angle_rad: float
    """Angle by which joint 1 has to turn for it [rad]."""
    share: float
    """Share of the contours of the base link on image edges; 0 if the base is not seen."""

    def is_right_angle_from(self, other: "BaseTurn") -> bool:
        """Return whether the two differ by a right angle or two, so that a base stands square to the same lines."""
        angle = abs(self.angle_rad - other.angle_rad)
        return bool(angle > _RIGHT_RAD and abs((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4) <= _RIGHT_RAD)


@dataclass(frozen=True, slots=True, kw_only=True)
class ContourImages:
    """Images of T frames in which the contours of the robot are searched."""

    images: tuple[GradientImage, ...]
    model: ArmModel
    matcher: EdgeMatcher
    left_out: tuple[RobotPart, ...] = ()
    """Parts without contours, which still hide others."""

    def take(self, rows: Sequence[int] | NDArray[np.intp]) -> "ContourImages":
        """Select frames."""
        return replace(self, images=tuple(self.images[row] for row in rows))

    def without(self, *parts: RobotPart) -> "ContourImages":
        """Return the images without the contours of some parts."""
        return replace(self, left_out=parts)

    def _project(
        self, scene: ArmScene, parts: Sequence[RobotPart]
    ) -> Iterator[tuple[GradientImage, EdgePoints | None]]:
        """Yield each image with the visible contour points of some parts, in its pixels; None without any."""
        used = tuple(part for part in parts if part not in self.left_out)
        X_CP = open_fingers(scene.lens.X_CB @ self.model.poses(scene.q), scene.finger_m)
        for image, own in zip(self.images, X_CP, strict=True):
            camera = scene.lens.camera.resized(image.camera.width, image.camera.height)
            yield image, self.matcher.project(own, camera, used)

    def observe(self, scene: ArmScene, reach_px: float) -> Observations | None:
        """Return the visible contour points of a scene with the image edges nearby; None if there are too few.

        Edges are up to `reach_px` away in an image of at most 640 px.
        """
        observed = []
        parts = ROBOT if reach_px > _WITH_FINGERS_PX else RIGID
        for t, (image, points) in enumerate(self._project(scene, parts)):
            if points is None:
                continue
            move, strength = image.find_edges(points, reach_px)
            strong = np.flatnonzero(strength > LEAST_GRADIENT)
            n = len(strong)
            if n < MIN_POINTS:
                continue
            zoom = scene.lens.camera.width / image.camera.width
            normal = points.normal[strong]
            whitening = np.zeros((n, 2, 2))
            whitening[:, 0] = normal / (SIGMA_PX * zoom)
            observed.append(
                Observations(
                    frame=np.full(n, t, dtype=np.intp),
                    part=points.part[strong],
                    p_P=points.p_P[strong],
                    opening_sign=OPENING_SIGNS[points.part[strong]],
                    uv_px=(points.pixel[strong] + move[strong, None] * normal) * zoom,
                    whitening=whitening,
                    weight=np.full(n, min(1.0, INDEPENDENT / n)),
                )
            )
        return Observations.join(observed) if observed else None

    def agreement(self, scene: ArmScene) -> Array:
        """Return the share (T,) of the contours of hand and arm that lies on image edges, frame by frame.

        Mean of the share of all contours and of the mean over the parts: the base is short of contours, but decides.
        """
        return np.array([self._agreement(image, points) for image, points in self._project(scene, RIGID)])

    def _agreement(self, image: GradientImage, points: EdgePoints | None) -> float:
        if points is None:
            return 0.0
        on_edge = self.matcher.edge_shares(image, points)
        count = np.bincount(points.part, minlength=len(RobotPart))
        shares = np.bincount(points.part, weights=on_edge, minlength=len(RobotPart)) / np.maximum(count, 1)
        enough = count >= MIN_POINTS
        return float(on_edge.mean() + shares[enough].mean()) / 2 if enough.any() else float(on_edge.mean())

    def base_share(self, scene: ArmScene) -> float:
        """Return the share of the visible contours of the base link that lies on image edges; 0 if too few are seen."""
        on_edges = 0.0
        points_visible = 0
        for image, points in self._project(scene, (RobotPart.LINK0,)):
            if points is not None and len(points.part) >= MIN_POINTS:
                on_edges += float(self.matcher.edge_shares(image, points).sum())
                points_visible += len(points.part)
        return on_edges / points_visible if points_visible else 0.0

    def find_turns(self, scene: ArmScene) -> list[BaseTurn]:
        """Find the turns, each different from all better ones, at which contours of the base link lie on image edges.

        At least one, the best first; only that of the scene itself where no other is within the limits of joint 1.
        """
        rows = evenly(len(scene.q), _FRAMES)
        few = scene.take(rows)
        images = self.take(rows)

        def shares(angles: Array) -> Array:
            return np.array([images.base_share(few.turned(angle)) for angle in angles])

        lower = self.model.lower[0] - scene.q[:, 0].min()
        upper = self.model.upper[0] - scene.q[:, 0].max()
        angles = np.arange(lower, upper, _STEP_RAD)
        if not len(angles):
            return [BaseTurn(angle_rad=0.0, share=images.base_share(few))]
        share = shares(angles)
        # Contours are narrower than a step: the best steps are searched closely.
        tops = angles[np.argsort(-share, kind="stable")[:_TOPS]]
        fine = np.unique(np.clip((tops[:, None] + _FINE_STEPS_RAD).ravel(), angles[0], angles[-1]))
        angles = np.concatenate([angles, fine])
        share = np.concatenate([share, shares(fine)])
        turns: list[BaseTurn] = []
        for k in np.argsort(-share, kind="stable"):
            if all(abs(angles[k] - turn.angle_rad) > DIFFERENT_TURN_RAD for turn in turns):
                turns.append(BaseTurn(angle_rad=float(angles[k]), share=float(share[k])))
        return turns if turns[0].share else [BaseTurn(angle_rad=0.0, share=0.0)]
