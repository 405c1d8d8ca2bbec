"""CameraCandidate cameras of a video, with the postures of some of its frames, and their fits to cells and contours."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, Observations, Prior, adjust
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate, describe
from kinebench_drake.grounding.camera.contours import ContourImages
from kinebench_drake.grounding.camera.detections import ArmDetections
from kinebench_drake.grounding.camera.hypotheses import Hypothesis
from kinebench_drake.grounding.camera.robot_points import (
    LINK_SIGMAS,
    MIN_FRAMES,
    PIXEL_SIGMA,
    CalibrationCorrespondences,
)
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.image import GradientImage
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import ARM
from kinebench_drake.segments import evenly

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


class CandidateFitter:
    """Fits of candidates to the cells of the networks' views, and to the contours of the robot.

    Images are those of the detections; passes are reaches of the search for edges, and weights of the cells.
    """

    def __init__(self, model: ArmModel, matcher: EdgeMatcher) -> None:
        """Set the arm and the search for edges."""
        self.model = model
        self.matcher = matcher

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
        scene = start.scene
        cost = 0.0
        for _ in range(2):
            observations = _cell_observations(start.cells, scene, self.model)
            bundle = adjust(observations, scene, prior, self.model)
            scene = bundle.scene
            cost = bundle.cost
        return replace(start, scene=scene, cost=cost)

    def compare(
        self, fit: CameraCandidate, images: ContourImages, prior: Prior, frames: int, passes: Passes
    ) -> CameraCandidate:
        """Return a candidate fitted to contours of the frames that it explains best, `frames` at most."""
        # Hands that the hypothesis explains badly are often none.
        likely = np.sort(np.argsort(fit.costs, kind="stable")[: max(MIN_FRAMES, len(fit.rows) // 2)])
        candidate = fit.take(likely[evenly(len(likely), frames)])
        images = images.take(candidate.rows)
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
    factor = np.where(np.isin(cells.part, ARM), _FACTOR / LINK_SIGMAS, 1.0)
    own = replace(cells, sigma_m=cells.sigma_m * factor)
    return Observations.of_cells(cells, own.sigma_px(scene.lens, p_B, _FACTOR * PIXEL_SIGMA))
