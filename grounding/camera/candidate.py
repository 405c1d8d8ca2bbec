"""Candidate cameras of a video, with the postures of some of its frames, and their fits to cells and contours."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.bundle import POSTURE_SIGMA_RAD, ArmScene, Observations, Prior, adjust
from kinebench_drake.grounding.camera.contours import ContourImages
from kinebench_drake.grounding.camera.correspondences import LINK_SIGMAS, CalibrationCorrespondences, locate_points
from kinebench_drake.grounding.camera.detections import ArmDetections
from kinebench_drake.grounding.camera.fit import PIXEL_SIGMA, Lens
from kinebench_drake.grounding.camera.hypotheses import Hypothesis
from kinebench_drake.grounding.camera.surroundings import Surroundings
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.tracking.view import Frames
from kinebench_drake.models.panda.robot import ARM

MIN_FRAMES = 3
"""Least number of frames that must show hand and arm."""
LOG_FOCAL_SIGMA = 0.5
"""Standard deviation of the logarithm of an unknown focal length."""
PASS_SIGMA_RAD = 0.5
"""Standard deviation of joint angles about those of the pass before [rad]."""
LEAST_EXPLAINED = 0.75
"""Share of the frames with the robot below which a camera that explains no more is unlikely."""
THIN = 3
"""Of so many cells one is used."""
COARSE = ((14.0, 1.0), (14.0, 1.0), (10.0, 0.6), (6.0, 0.3), (4.0, 0.1))
MIDDLE = ((8.0, 0.3), (5.0, 0.2), (4.0, 0.1), (3.0, 0.0))
"""Successive reaches of the search for edges [px of an image of at most 640 px], and weights of the cells."""
NEAREST_M = 0.05
"""Least depth of a point [m]."""
_LINK_FACTOR = 1.5  # of the networks' standard deviations for links
_FLOOR = 1.5
_LEAST_COMPARED = 4  # frames


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPrior:
    """What is known about the lens, and about the postures."""

    lens: Lens
    """Expected focal length and principal point."""
    log_focal_sigma: float
    """Standard deviation of the logarithm of the focal length; 0 for a fixed one."""
    centre_sigma_px: float = 0.0
    """Standard deviation of the principal point [px]; 0 for a fixed one."""
    place_free: bool = True
    """False to keep the place of the camera."""
    offset_sigma: float = 0.0
    """Standard deviation of the offset of a part's contours, in those of one of their points; 0 for none."""
    surroundings: Surroundings | None = None
    """Lines along the axes of the base."""

    def with_postures(self, q: Array, q_sigma: Array | float) -> Prior:
        """Return the prior with joint angles (T, 7) [rad] and their standard deviations."""
        return Prior(
            q=q,
            q_sigma=np.broadcast_to(np.asarray(q_sigma, dtype=np.float64), q.shape),
            lens=self.lens,
            log_focal_sigma=self.log_focal_sigma,
            centre_sigma_px=self.centre_sigma_px,
            place_free=self.place_free,
            offset_sigma=self.offset_sigma,
            surroundings=self.surroundings,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
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

    def take(self, chosen: NDArray[np.intp]) -> "Candidate":
        """Select frames."""
        return replace(
            self,
            scene=self.scene.take(chosen),
            rows=self.rows[chosen],
            cells=self.cells.of_frames(chosen),
            costs=self.costs[chosen],
        )


class CandidateFitter:
    """Fits of candidates to the cells of the networks' views, and to the contours of the robot."""

    def __init__(self, model: ArmModel, matcher: EdgeMatcher) -> None:
        """Set the arm and the search for edges."""
        self.model, self.matcher = model, matcher

    def images(self, frames: Frames, camera: Camera) -> ContourImages:
        """Return the images of `frames` (T, H, W, 3); only the size of `camera` matters."""
        return ContourImages(frames, camera, self.model, self.matcher)

    def start(self, detections: ArmDetections, hypothesis: Hypothesis) -> Candidate | None:
        """Return a hypothesis as a candidate; None if it explains too few frames."""
        rows = np.flatnonzero(np.isfinite(hypothesis.q).all(axis=1))
        if len(rows) < MIN_FRAMES:
            return None
        return Candidate(
            scene=ArmScene(lens=hypothesis.lens, q=hypothesis.q[rows], finger_m=detections.finger_m[rows]),
            rows=rows,
            cells=detections.cells.flip(hypothesis.flipped).of_frames(rows).thin(THIN),
            costs=hypothesis.costs[rows],
            cost=hypothesis.cost,
        )

    def fit_cells(self, start: Candidate, prior: LensPrior) -> Candidate:
        """Return a candidate fitted to its cells."""
        scene, cost = start.scene, 0.0
        for _ in range(2):
            observations = cell_observations(start.cells, scene, self.model)
            bundle = adjust(observations, scene, prior.with_postures(scene.q, POSTURE_SIGMA_RAD), self.model)
            scene, cost = bundle.scene, bundle.cost
        return replace(start, scene=scene, cost=cost)

    def compare(
        self,
        fit: Candidate,
        images: ContourImages,
        prior: LensPrior,
        frames: int,
        passes: Sequence[tuple[float, float]],
    ) -> Candidate:
        """Return a candidate fitted to the contours of the frames that it explains best, with its agreement.

        Args:
            fit: the candidate.
            images: images of the detections.
            prior: prior of the lens.
            frames: greatest number of frames.
            passes: reaches of the search for edges, and weights of the cells.
        """
        # Hands that the hypothesis explains badly are often none.
        likely = np.sort(np.argsort(fit.costs, kind="stable")[: max(_LEAST_COMPARED, len(fit.rows) // 2)])
        candidate = fit.take(likely[np.unique(np.linspace(0, len(likely) - 1, frames).round().astype(int))])
        images = images.take(candidate.rows)
        scene, _ = self.fit_contours(candidate.scene, candidate.cells, images, prior, passes, PASS_SIGMA_RAD)
        return replace(candidate, scene=scene, agreement=float(np.median(images.agreement(scene))))

    def fit_contours(
        self,
        scene: ArmScene,
        cells: CalibrationCorrespondences,
        images: ContourImages,
        prior: LensPrior,
        passes: Sequence[tuple[float, float]],
        q_sigma: float,
        q: Array | None = None,
    ) -> tuple[ArmScene, Observations | None]:
        """Fit camera and postures to the image edges in passes; `q` (T, 7) are known joint angles [rad]."""
        edges = None
        for reach_px, weight in passes:
            edges = images.observe(scene, reach_px)
            if edges is None:
                break
            observations = edges
            if weight > 0:
                observed = cell_observations(cells, scene, self.model)
                observations = Observations.join([replace(observed, weight=weight * observed.weight), edges])
            own = prior.with_postures(scene.q if q is None else q, q_sigma)
            scene = adjust(observations, scene, own, self.model, iterations=4).scene
        return scene, edges


def cell_observations(cells: CalibrationCorrespondences, scene: ArmScene, model: ArmModel) -> Observations:
    """Return the cells of the networks' views as observations, with standard deviations at a scene."""
    lens = scene.lens
    p_B = locate_points(cells, model.poses(scene.q), scene.finger_m)
    _, z = lens.project(p_B)
    spread_m = cells.sigma_m * np.where(np.isin(cells.part, ARM), _LINK_FACTOR / LINK_SIGMAS, 1.0)
    floor = _FLOOR * PIXEL_SIGMA * lens.camera.unit_px
    sigma = np.hypot(floor, lens.camera.fx * spread_m / np.maximum(np.abs(z), NEAREST_M))
    return Observations(
        frame=cells.frame,
        part=cells.part,
        p_P=cells.p_P,
        opening_sign=cells.opening_sign,
        uv_px=cells.uv_px,
        whitening=np.eye(2) / sigma[:, None, None],
        weight=cells.weight,
    )
