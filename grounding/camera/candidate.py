"""Candidate cameras of a video, with the postures of some of its frames, and their fits to cells and contours.

Links 1 to 7 look the same if the base turns one way and joint 1 the other: they give the axis and the shoulder on it.
Only the contours of the base link say how the base stands.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, Observations, Prior, adjust
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate, describe
from kinebench_drake.grounding.camera.detections import (
    LINK_SIGMAS,
    MIN_FRAMES,
    PIXEL_SIGMA,
    ArmDetections,
    CalibrationCorrespondences,
)
from kinebench_drake.grounding.camera.hypotheses import Hypothesis
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import (
    INDEPENDENT,
    LEAST_GRADIENT,
    MAX_POINTS,
    RIGID,
    ROBOT,
    SIGMA_PX,
    EdgeMatcher,
)
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage
from kinebench_drake.grounding.registration.solver import MIN_POINTS
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import ARM, RobotPart
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
_FRAME_SHARE = 0.75
"""Least share of the agreement of the better frames, of a frame that a camera is fitted to."""
_EXPLAINED_SHARE = 0.5
"""Share of the frames with the robot below which the agreement of those that a camera explains is reduced."""
Passes = Sequence[tuple[float, float]]
LOG_FOCAL_SIGMA = 0.5
"""Standard deviation of the logarithm of an unknown focal length."""
COARSE = ((14.0, 1.0), (14.0, 1.0), (10.0, 0.6), (6.0, 0.3), (4.0, 0.1))
MIDDLE = ((8.0, 0.3), (5.0, 0.2), (4.0, 0.1), (3.0, 0.0))
"""Successive reaches of the search for edges [px of an image of at most 640 px], and weights of the cells."""
_PASS_SIGMA_RAD = 0.5
"""Standard deviation of joint angles about those of the pass before [rad]."""
_FACTOR = 1.5
"""Factor of the networks' standard deviations for links, and of their least one."""
_FINE = ((8.0, 0.3), (5.0, 0.1), (4.0, 0.0), (3.0, 0.0), (3.0, 0.0), (2.0, 0.0), (2.0, 0.0))
"""The same for a candidate that is right within some pixels."""
_PART_INDEPENDENT = 4.0
"""Independent measurements of the contours of a part in an image, whose errors correlate."""
_JOINTS_INDEPENDENT = 2.0
"""The same at known joint angles, whose errors the contours have in common."""
_OFFSET_SIGMA = 0.4
"""Standard deviation of the offset of a part's contours: 0.3 px, twice those of own renders."""


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
    points: int = MAX_POINTS
    """Greatest number of contour points in an image."""

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
        X_CP = self.model.gripper.open(scene.lens.X_CB @ self.model.poses(scene.q), scene.finger_m)
        for image, own in zip(self.images, X_CP, strict=True):
            camera = scene.lens.intrinsics.resized(image.camera.width, image.camera.height)
            yield image, self.matcher.project(own, camera, used, self.points)

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
            zoom = scene.lens.intrinsics.width / image.camera.width
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

        q_1 = scene.q[:, 0]
        angles = np.arange(self.model.lower[0] - q_1.min(), self.model.upper[0] - q_1.max(), _STEP_RAD)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCandidate:
    """Camera and postures of some of the frames that show the robot."""

    scene: ArmScene
    rows: NDArray[np.intp]
    """(T,) rows of the detections."""
    cells: CalibrationCorrespondences
    """Cells in these frames."""
    costs: Array
    """(T,) how badly the hypothesis explains the cells of each frame (`Hypothesis.costs`)."""
    cost: float
    """Weighted mean loss of the cells."""
    agreement: float = 0.0
    """Median share of the contours on image edges."""

    def take(self, chosen: NDArray[np.intp]) -> "CameraCandidate":
        """Select frames."""
        return replace(
            self,
            scene=self.scene.take(chosen),
            rows=self.rows[chosen],
            cells=self.cells.of_frames(chosen),
            costs=self.costs[chosen],
        )


@dataclass(frozen=True, slots=True)
class CandidateFitter:
    """Fits of candidates to the cells of the networks' views, and to the contours of the robot.

    Images are those of the detections; passes are reaches of the search for edges, and weights of the cells.
    """

    model: ArmModel
    matcher: EdgeMatcher

    def images(self, frames: Frames, camera: Camera) -> ContourImages:
        """Return the images of `frames` (T, H, W, 3); only the size of `camera` matters."""
        images = tuple(GradientImage(frame, camera) for frame in frames)
        return ContourImages(images=images, model=self.model, matcher=self.matcher)

    def start(self, detections: ArmDetections, hypothesis: Hypothesis) -> CameraCandidate | None:
        """Return a hypothesis as a candidate; None if it explains too few frames."""
        rows = np.flatnonzero(np.isfinite(hypothesis.q).all(axis=1))
        if len(rows) < MIN_FRAMES:
            return None
        return CameraCandidate(
            scene=ArmScene(lens=hypothesis.lens, q=hypothesis.q[rows], finger_m=detections.finger_m[rows]),
            rows=rows,
            cells=detections.cells.flip(hypothesis.flipped).of_frames(rows).thin(),
            costs=hypothesis.costs[rows],
            cost=hypothesis.cost,
        )

    def extend(self, candidate: CameraCandidate, detections: ArmDetections, hypothesis: Hypothesis) -> CameraCandidate:
        """Return a candidate with all frames that its camera explains by a hypothesis, itself included."""
        q = hypothesis.q.copy()
        finger_m = detections.finger_m.copy()
        q[candidate.rows] = candidate.scene.q
        finger_m[candidate.rows] = candidate.scene.finger_m
        extended = self.start(replace(detections, finger_m=finger_m), replace(hypothesis, q=q))
        return candidate if extended is None else extended

    def fit_cells(self, start: CameraCandidate, prior: Prior) -> CameraCandidate:
        """Return a candidate fitted to its cells."""
        fitted = start
        for _ in range(2):
            observations = _cell_observations(start.cells, fitted.scene, self.model)
            bundle = adjust(observations, fitted.scene, prior, self.model)
            fitted = replace(start, scene=bundle.scene, cost=bundle.cost)
        return fitted

    def compare(
        self, fit: CameraCandidate, images: ContourImages, prior: Prior, frames: int, passes: Passes
    ) -> CameraCandidate:
        """Return a candidate fitted to contours of the frames that it explains best, `frames` at most."""
        # Hands that the hypothesis explains badly are often none.
        likely = np.sort(np.argsort(fit.costs, kind="stable")[: max(MIN_FRAMES, len(fit.rows) // 2)])
        candidate = fit.take(likely[evenly(len(likely), frames)])
        return self.fit(candidate, images.take(candidate.rows), prior, passes)

    def fit(self, candidate: CameraCandidate, images: ContourImages, prior: Prior, passes: Passes) -> CameraCandidate:
        """Return a candidate fitted to the contours of images of its own frames, with its agreement."""
        scene, _ = self.fit_contours(candidate, images, prior, passes)
        return replace(candidate, scene=scene, agreement=float(np.median(images.agreement(scene))))

    def fit_contours(
        self, fit: CameraCandidate, images: ContourImages, prior: Prior, passes: Passes
    ) -> tuple[ArmScene, Observations | None]:
        """Fit a candidate to the edges of images of its own frames, in passes; return scene and contours."""
        scene = fit.scene
        edges = None
        q, q_sigma = (None, _PASS_SIGMA_RAD) if prior.joint_sigma_rad is None else (fit.scene.q, None)
        for reach_px, weight in passes:
            edges = images.observe(scene, reach_px)
            if edges is None:
                break
            observations = edges
            if weight > 0:
                observed = _cell_observations(fit.cells, scene, self.model)
                observations = Observations.join([replace(observed, weight=weight * observed.weight), edges])
            scene = adjust(observations, scene, prior, self.model, q=q, q_sigma=q_sigma, iterations=4).scene
        return scene, edges

    def settle(
        self, candidate: CameraCandidate, images: ContourImages, prior: Prior, total: int
    ) -> tuple[CameraCandidate, Observations | None]:
        """Fit a candidate to the contours of its frames without those that disagree; return it and the contours.

        Its agreement is less where it explains few of the `total` frames that show the robot.
        """
        edges = None
        rounds: tuple[Passes, ...] = (_FINE, _FINE[1:], _FINE[-3:])
        for number, passes in enumerate(rounds):
            own = images.take(candidate.rows)
            scene, edges = self.fit_contours(candidate, own, prior, passes)
            agreement = own.agreement(scene)
            candidate = replace(candidate, scene=scene, agreement=explained(agreement, total))
            good = np.flatnonzero(agreement >= _FRAME_SHARE * np.quantile(agreement, bounds.BEST_QUANTILE))
            if number + 1 == len(rounds) or len(good) == len(agreement) or len(good) < MIN_FRAMES:
                break
            candidate = candidate.take(good)
        return candidate, edges

    def finish(self, candidate: CameraCandidate, images: ContourImages, prior: Prior, total: int) -> CameraEstimate:
        """Settle a candidate that is right within some pixels, of `total` frames with the robot; compute its sigmas.

        Raises:
            UnmeasurableError: the images show no edges where the arm should be.
        """
        has_joints = prior.joint_sigma_rad is not None
        prior = replace(prior, offset_sigma=0.0 if has_joints else _OFFSET_SIGMA)
        candidate, edges = self.settle(candidate, images, prior, total)
        if edges is None:
            raise UnmeasurableError("no camera can be estimated: the images show no edges where the arm should be")
        # Contours of one part in one image, and those of parts at rest, count once.
        X_BP = self.model.poses(candidate.scene.q)
        count = np.zeros(X_BP.shape[:2])
        np.add.at(count, (edges.frame, edges.part), 1.0)
        independent = _JOINTS_INDEPENDENT if has_joints else _PART_INDEPENDENT
        weight = np.minimum(1.0, independent / count[edges.frame, edges.part]) / edges.count_repeats(X_BP)
        bundle = adjust(replace(edges, weight=weight), candidate.scene, prior, self.model)
        return describe(bundle, edges.part, self.model, candidate.rows, candidate.agreement)


def explained(agreement: Array, total: int) -> float:
    """Return the median of the agreements (T,) of frames, less if they are few of the `total` with the robot."""
    return float(np.median(agreement)) * min(1.0, len(agreement) / (_EXPLAINED_SHARE * total))


def _cell_observations(cells: CalibrationCorrespondences, scene: ArmScene, model: ArmModel) -> Observations:
    """Return the cells of the networks' views as observations, with standard deviations at a scene."""
    p_B = cells.locate(model.poses(scene.q), scene.finger_m)
    own = replace(cells, sigma_m=cells.sigma_m * np.where(np.isin(cells.part, ARM), _FACTOR / LINK_SIGMAS, 1.0))
    return Observations.of_cells(cells, own.sigma_px(scene.lens, p_B, _FACTOR * PIXEL_SIGMA))
