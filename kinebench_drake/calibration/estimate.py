"""Estimation of the camera of a video from the arm that it shows: neither camera nor joint angles are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.calibration.bundle import (
    POSTURE_SIGMA_RAD,
    UNKNOWNS,
    ArmScene,
    Bundle,
    Observations,
    Prior,
    adjust,
)
from kinebench_drake.calibration.contours import ContourImages
from kinebench_drake.calibration.correspondences import LINK_SIGMAS, CalibrationCorrespondences, locate_points
from kinebench_drake.calibration.detections import ArmDetections, find_robot
from kinebench_drake.calibration.fit import PIXEL_SIGMA, Lens, with_focal
from kinebench_drake.calibration.hypotheses import ChainSearch, Hypothesis
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference, rotation_z
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.view import DenseEstimator, Frames
from kinebench_drake.models.panda.robot import ARM, HAND_TO_TCP_M, RobotPart, hand_from_tcp
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.types import Json

_Ranked = TypeVar("_Ranked")

FOV_DEG = (30.0, 42.0, 55.0, 72.0)
"""Fields of view along the longer side at which the search starts [degrees]."""
JOINT_SIGMA_RAD = 0.01
"""Standard deviation of known joint angles [rad]: offsets of the joints, and clocks."""
MIN_FRAMES = 3
"""Least number of frames that must show hand and arm."""
_FRAMES = 12
_CHECKED, _CHECK_SEARCHED = 5, 8  # frames that check a camera, and those that they are chosen from
_CANDIDATES, _FITTED, _TURNED, _COMPARED = 16, 6, 3, 16
"""Numbers of hypotheses, of those fitted to the cells, of these also turned about joint 1, and of all compared."""
_LEAST_BASE_CELLS, _BASE_SIGMA_M = 10, 0.04
_TURN_STEP_RAD, _TURN_WEIGHT = np.deg2rad(10.0), 0.1
_LOG_FOCAL_SIGMA = 0.5
_LINK_FACTOR = 1.5  # of the networks' standard deviations for links
_THIN = 3
_COARSE = ((14.0, 1.0), (14.0, 1.0), (10.0, 0.6), (6.0, 0.3), (4.0, 0.1))
_MIDDLE = ((8.0, 0.3), (5.0, 0.2), (4.0, 0.1), (3.0, 0.0))
_FINE = ((8.0, 0.3), (5.0, 0.1), (4.0, 0.0), (3.0, 0.0), (3.0, 0.0), (2.0, 0.0), (2.0, 0.0))
"""Successive reaches of the search for edges [px of an image of at most 640 px], and weights of the cells."""
_SUFFICIENT = 0.6  # agreement, after a fit of the postures, of a camera that is not in doubt
_ZOOMS, _ZOOMS_FITTED = (0.63, 0.72, 0.85, 1.0, 1.2, 1.4, 1.6), 3  # focal lengths over that of a camera in doubt
CONTRADICTING, CLEARLY = 0.5, 0.1
"""Least agreement with another camera that contradicts the assumed one, and how much better it has to be."""
_ROUNDS = ((4, _COARSE, 4), (6, _MIDDLE, 2))
"""Successive comparisons of candidates: frames, passes, candidates kept."""
_PASS_SIGMA_RAD = 0.5  # of joint angles about those of the pass before
_SAME_RAD, _SAME_ZOOM = np.deg2rad(8.0), 0.1
_PART_INDEPENDENT = 6.0  # independent measurements of the contours of a part, whose errors correlate
_SIGMA_FACTOR, _JOINTS_SIGMA_FACTOR = 1.2, 1.5  # errors over those of independent contours; at known joint angles
_LEAST_SHARE = 0.6  # of the median agreement, below which a frame is left out
_LEAST_EXPLAINED = 0.75  # of the frames that show the robot: a camera that explains fewer agrees less
_FLOOR, _NEAREST_M = 1.5, 0.05
_MOVE, _TURN = slice(0, 3), slice(3, 6)
_ALIKE_M, _ALIKE_RAD = 0.01, np.deg2rad(2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraEstimate:
    """Camera estimated from the arm, with its uncertainty."""

    camera: Camera
    covariance: Array
    """(9, 9) of the base's rotation about the camera's axes [rad], its position in the camera frame [m], the logarithm
    of the focal length and the principal point [px]."""
    gripper_sigma_m: float
    """Standard deviation of the TCP's position in the base frame due to the camera: root of the sum over axes [m]."""
    gripper_sigma_rad: float
    """Likewise of its rotation [rad]."""
    agreement: float
    """Share of the contours of hand and arm on image edges, median over the frames; less where few frames fit."""
    runner_up: float
    """Likewise with the next best camera that differs from it; 0 if there is none."""
    residual_px: float
    """Median distance between contours and image edges [px]."""
    rows: NDArray[np.intp]
    """(T,) numbers of the frames used."""
    scene: ArmScene
    """Camera and postures in these frames."""
    contour_part: NDArray[np.uint8]
    """(N,) values of `RobotPart` of the contour points used."""
    contour_error_px: Array
    """(N,) their distances from the image edges [px]."""

    def to_json(self) -> dict[str, Json]:
        """Serialize into `camera_estimate` of samples.jsonl."""
        return {
            "camera": self.camera.to_json(),
            "agreement": self.agreement,
            "runner_up": self.runner_up,
            "residual_px": self.residual_px,
            "position_sigma_m": self.position_sigma_m,
            "rotation_sigma_rad": self.rotation_sigma_rad,
            "focal_sigma": self.focal_sigma,
            "gripper_sigma_m": self.gripper_sigma_m,
            "gripper_sigma_rad": self.gripper_sigma_rad,
            "frames": self.rows.tolist(),
        }

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation of the camera's position in the base frame: root of the sum over axes [m]."""
        x, y, z = self.scene.lens.X_CB[:3, 3]
        by_turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # the camera's position is -R^T t
        J = np.concatenate([by_turn, np.eye(3)], axis=1)
        return float(np.trace(J @ self.covariance[:6, :6] @ J.T) ** 0.5)

    @property
    def rotation_sigma_rad(self) -> float:
        """Standard deviation of the camera's rotation [rad]."""
        return float(np.trace(self.covariance[:3, :3]) ** 0.5)

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length; 0 if it was fixed."""
        return float(self.covariance[6, 6] ** 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraContradiction:
    """Camera that explains the arm clearly better than the assumed one."""

    agreement: float
    """Share of the contours of hand and arm on image edges with the assumed camera."""
    better: float
    """The same with the other one."""
    focal_ratio: float
    """Focal length of the assumed camera over that of the other one."""
    gripper_m: float
    """Distance between the TCPs that the two give in the base frame, median over the frames [m]."""
    gripper_rad: float
    """Angle between them [rad]."""

    def to_json(self) -> dict[str, Json]:
        """Serialize into `camera_contradiction` of samples.jsonl."""
        return {name: round(getattr(self, name), 4) for name in self.__slots__}


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

    def with_postures(self, q: Array, q_sigma: Array | float) -> Prior:
        """Return the prior with joint angles (T, 7) [rad] and their standard deviations."""
        return Prior(
            q=q,
            q_sigma=np.broadcast_to(np.asarray(q_sigma, dtype=np.float64), q.shape),
            lens=self.lens,
            log_focal_sigma=self.log_focal_sigma,
            centre_sigma_px=self.centre_sigma_px,
            place_free=self.place_free,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """Camera and postures of some of the frames that show the robot."""

    scene: ArmScene
    rows: NDArray[np.intp]
    """(T,) rows of the detections."""
    cells: CalibrationCorrespondences
    """Cells in these frames."""
    cost: float
    """Weighted mean loss of the cells."""
    agreement: float = 0.0
    """Median share of the contours on image edges."""

    def take(self, chosen: NDArray[np.intp]) -> "Candidate":
        """Select frames."""
        return replace(self, scene=self.scene.take(chosen), rows=self.rows[chosen], cells=self.cells.of_frames(chosen))


class CameraEstimator:
    """Estimator of cameras; one instance serves any number of videos."""

    def __init__(
        self, estimator: DenseEstimator, model: ArmModel | None = None, matcher: EdgeMatcher | None = None
    ) -> None:
        """Estimate with the dense estimates of `estimator`.

        Raises:
            SetupError: meshes, native libraries or the robot description are missing.
        """
        self._estimator = estimator
        self._model, self._matcher = model or ArmModel(), matcher or EdgeMatcher()

    @classmethod
    def create(cls, weights: Path | None = None) -> "CameraEstimator":
        """Create the estimator, with `weights` in place of those shipped.

        Raises:
            SetupError: weights, meshes or native libraries are missing.
        """
        from kinebench_drake.grounding.estimator import NetworkEstimator
        from kinebench_drake.models.perception.network import WEIGHTS, load_network

        return cls(NetworkEstimator(load_network(weights or WEIGHTS)))

    def measure_agreement(self, frames: Frames, camera: Camera) -> float | None:
        """Return the share of the arm's contours that lies on image edges if the camera is as given.

        The postures are fitted, the camera is kept; median over the frames. None if hand and arm are seen in fewer than
        `MIN_FRAMES` of the frames searched.

        Args:
            frames: (T, H, W, 3) RGB.
            camera: camera of the frames.
        """
        detections = find_robot(self._estimator, frames, camera, _CHECKED, searched=_CHECK_SEARCHED)
        if detections is None or len(detections.rows) < MIN_FRAMES:
            return None
        fixed = self._fit_postures(detections, frames[detections.rows], camera)
        return 0.0 if fixed is None else fixed.agreement

    def posture_agreement(self, frames: Frames, camera: Camera, q: Array, finger_m: Array) -> float:
        """Return the share of the arm's contours on image edges at postures already fitted, median over frames.

        Args:
            frames: (T, H, W, 3) RGB.
            camera: camera of the frames.
            q: (T, 7) joint angles [rad].
            finger_m: (T,) opening of each finger [m].
        """
        scene = ArmScene(lens=Lens(camera=camera, X_CB=invert(camera.X_BC)), q=q, finger_m=finger_m)
        return float(np.median(ContourImages(frames, camera, self._model, self._matcher).agreement(scene)))

    def find_contradiction(self, frames: Frames, camera: Camera) -> CameraContradiction | None:
        """Return another camera under which the arm agrees clearly better with the images; None if there is none.

        Focal lengths within a factor of 1.6 are tried at the place of the camera, and both are then fitted. The arm has
        to agree with the result, in all frames that show it.

        Args:
            frames: (T, H, W, 3) RGB.
            camera: camera of the frames.
        """
        detections = find_robot(self._estimator, frames, camera, _CHECKED + 1, searched=2 * _CHECK_SEARCHED)
        if detections is None or len(detections.rows) < MIN_FRAMES:
            return None
        frames = frames[detections.rows]
        fixed = self._fit_postures(detections, frames, camera)
        # Where no posture explains the hand, its detection is wrong, which says nothing about the camera.
        if fixed is None or fixed.agreement >= _SUFFICIENT:
            return None
        images = ContourImages(frames, camera, self._model, self._matcher)
        prior = LensPrior(lens=Lens(camera=camera, X_CB=np.eye(4)), log_focal_sigma=_LOG_FOCAL_SIGMA)
        search = ChainSearch(detections.cells, detections.finger_m, self._model)
        X_CB = invert(camera.X_BC)
        lenses = [Lens(camera=with_focal(camera, zoom * camera.fx), X_CB=X_CB) for zoom in _ZOOMS]
        starts = [self._start(detections, search.explain(lens, search.hands(lens.camera))) for lens in lenses]
        enough = _LEAST_EXPLAINED * len(detections.rows)
        likely = sorted((s for s in starts if s is not None and len(s.rows) >= enough), key=lambda start: start.cost)
        passes = (*_COARSE, *_MIDDLE[1:])
        fitted = [self._compare(start, images, prior, len(start.rows), passes) for start in likely[:_ZOOMS_FITTED]]
        best = max(fitted, key=lambda candidate: candidate.agreement, default=None)
        if best is None or best.agreement < max(CONTRADICTING, fixed.agreement + CLEARLY):
            return None
        X_CB = best.scene.lens.X_CB
        X_CG = X_CB @ self._model.poses(best.scene.q)[:, RobotPart.HAND] @ hand_from_tcp()
        # What the assumed camera makes of the pose of the gripper that its focal length gives.
        zoom = camera.fx / best.scene.lens.camera.fx
        X_assumed = X_CG.copy()
        X_assumed[:, :3, 3] *= zoom
        moved_m, turned_rad = pose_difference(camera.X_BC @ X_assumed, invert(X_CB) @ X_CG)
        return CameraContradiction(
            agreement=fixed.agreement,
            better=best.agreement,
            focal_ratio=zoom,
            gripper_m=float(np.median(moved_m)),
            gripper_rad=float(np.median(turned_rad)),
        )

    def _fit_postures(self, detections: ArmDetections, frames: Frames, camera: Camera) -> Candidate | None:
        """Return the postures that explain the robot with a camera, and their agreement; None if they explain too few.

        Args:
            detections: robot in T frames.
            frames: (T, H, W, 3) these frames.
            camera: camera, which is kept.
        """
        lens = Lens(camera=camera, X_CB=invert(camera.X_BC))
        search = ChainSearch(detections.cells, detections.finger_m, self._model)
        start = self._start(detections, search.explain(lens, search.hands(camera)))
        if start is None:
            return None
        images = ContourImages(frames[start.rows], camera, self._model, self._matcher)
        prior = LensPrior(lens=lens, log_focal_sigma=0.0, place_free=False)
        passes = (*_COARSE, *_MIDDLE[1:])
        scene, _ = self._fit_contours(start.scene, start.cells, images, prior, passes, _PASS_SIGMA_RAD)
        return replace(start, scene=scene, agreement=float(np.median(images.agreement(scene))))

    def estimate(self, frames: Frames, camera: Camera | None = None, *, focal_free: bool = True) -> CameraEstimate:
        """Estimate place and focal length of the static camera of a video.

        Args:
            frames: (T, H, W, 3) RGB.
            camera: initial intrinsics; None for a centred lens with a usual field of view.
            focal_free: True to estimate the focal length.

        Raises:
            UnmeasurableError: hand and arm are seen in too few frames.
        """
        camera = camera or usual_camera(frames.shape[2], frames.shape[1])
        detections = find_robot(self._estimator, frames, camera, _FRAMES)
        if detections is None or len(detections.rows) < MIN_FRAMES:
            count = 0 if detections is None else len(detections.rows)
            raise UnmeasurableError(
                f"no camera can be estimated: a gripper is seen in {count} of the frames searched, at least "
                f"{MIN_FRAMES} are needed"
            )
        return self.solve(detections, frames[detections.rows], camera, focal_free=focal_free)

    def solve(self, detections: ArmDetections, frames: Frames, camera: Camera, *, focal_free: bool) -> CameraEstimate:
        """Estimate the camera from detections of the robot.

        Args:
            detections: robot in T frames.
            frames: (T, H, W, 3) these frames.
            camera: initial intrinsics.
            focal_free: True to estimate the focal length.

        Raises:
            UnmeasurableError: too little of the arm is seen.
        """
        images = ContourImages(frames, camera, self._model, self._matcher)
        prior = LensPrior(
            lens=Lens(camera=camera, X_CB=np.eye(4)), log_focal_sigma=_LOG_FOCAL_SIGMA if focal_free else 0.0
        )
        search = ChainSearch(detections.cells, detections.finger_m, self._model)
        focals = [focal_px(camera, fov) for fov in FOV_DEG] if focal_free else [camera.fx]
        candidates = self._candidates(detections, search.run(camera, focals), prior)
        if not candidates:
            raise UnmeasurableError(
                f"no camera can be estimated: the arm behind the gripper is seen in fewer than {MIN_FRAMES} frames"
            )
        for frames_used, passes, kept in _ROUNDS:
            compared = [self._compare(candidate, images, prior, frames_used, passes) for candidate in candidates]
            compared.sort(key=lambda candidate: -candidate.agreement)
            candidates = [
                self._extend(candidate, detections, search)
                for candidate in _distinct([(c.scene.lens, c) for c in compared])[:kept]
            ]
        estimates = [self.finish(candidate, images, prior, rows=detections.rows) for candidate in candidates]
        estimates.sort(key=lambda estimate: -estimate.agreement)
        best, *others = _distinct([(estimate.scene.lens, estimate) for estimate in estimates])
        return replace(best, runner_up=max((other.agreement for other in others), default=0.0))

    def _candidates(
        self, detections: ArmDetections, hypotheses: Sequence[Hypothesis], prior: LensPrior
    ) -> list[Candidate]:
        """Return different cameras that explain the cells, as hypothesized and fitted to the cells."""
        starts = _distinct([(h.lens, h) for h in hypotheses])[:_CANDIDATES]
        raw = [start for h in starts if (start := self._start(detections, h)) is not None]
        fits = [self._fit_cells(candidate, prior) for candidate in raw[:_FITTED]]
        fits.sort(key=lambda fit: fit.cost)
        turned = [turn for fit in _distinct([(f.scene.lens, f) for f in fits])[:_TURNED] for turn in self._turn(fit)]
        return _distinct([(c.scene.lens, c) for c in (*turned, *raw)])[:_COMPARED]

    def _start(self, detections: ArmDetections, hypothesis: Hypothesis) -> Candidate | None:
        """Return a hypothesis as a candidate; None if it explains too few frames."""
        rows = np.flatnonzero(np.isfinite(hypothesis.q).all(axis=1))
        if len(rows) < MIN_FRAMES:
            return None
        return Candidate(
            scene=ArmScene(lens=hypothesis.lens, q=hypothesis.q[rows], finger_m=detections.finger_m[rows]),
            rows=rows,
            cells=detections.cells.flip(hypothesis.flipped).of_frames(rows).thin(_THIN),
            cost=hypothesis.cost,
        )

    def refine(
        self, frames: Frames, camera: Camera, start: Candidate, *, focal_free: bool, centre_sigma_px: float = 0.0
    ) -> CameraEstimate:
        """Fit a camera to the contours of the robot at known joint angles.

        Args:
            frames: (T, H, W, 3) frames.
            camera: expected intrinsics.
            start: camera and joint angles in some of the frames.
            focal_free: True to estimate the focal length.
            centre_sigma_px: standard deviation of the principal point [px]; 0 for a fixed one.

        Raises:
            UnmeasurableError: the images show no edges where the arm should be.
        """
        prior = LensPrior(
            lens=Lens(camera=camera, X_CB=np.eye(4)),
            log_focal_sigma=_LOG_FOCAL_SIGMA if focal_free else 0.0,
            centre_sigma_px=centre_sigma_px,
        )
        images = ContourImages(frames, camera, self._model, self._matcher)
        own = images.take(start.rows)
        scene, _ = self._fit_contours(start.scene, start.cells, own, prior, _COARSE, JOINT_SIGMA_RAD, start.scene.q)
        candidate = replace(start, scene=replace(scene, q=start.scene.q))
        return self.finish(candidate, images, prior, rows=np.arange(len(frames)), q_sigma=JOINT_SIGMA_RAD)

    def _fit_cells(self, start: Candidate, prior: LensPrior) -> Candidate:
        """Return a candidate fitted to its cells."""
        scene, cost = start.scene, 0.0
        for _ in range(2):
            observations = cell_observations(start.cells, scene, self._model)
            bundle = adjust(observations, scene, prior.with_postures(scene.q, POSTURE_SIGMA_RAD), self._model)
            scene, cost = bundle.scene, bundle.cost
        return replace(start, scene=scene, cost=cost)

    def _turn(self, fit: Candidate) -> list[Candidate]:
        """Return a candidate, and the same with the base turned about joint 1 to where its cells agree best.

        The links look the same if base and joint 1 turn against each other, so that a wrong turn is a local minimum.
        """
        scene = fit.scene
        base = fit.cells.take(fit.cells.part == RobotPart.LINK0)
        if len(base) < _LEAST_BASE_CELLS:
            return [fit]
        lower, upper = self._model.lower[0] - scene.q[:, 0].min(), self._model.upper[0] - scene.q[:, 0].max()
        angles = np.arange(lower, upper, _TURN_STEP_RAD)
        angles = np.concatenate([angles[np.abs(angles) > _TURN_STEP_RAD], [0.0]])
        costs = np.array([self._base_cost(_turned(scene, angle), base) for angle in angles])
        best = float(angles[costs.argmin()])
        change = (costs.min() - costs[-1]) * _TURN_WEIGHT
        return [fit] if best == 0.0 else [fit, replace(fit, scene=_turned(scene, best), cost=fit.cost + change)]

    def _base_cost(self, scene: ArmScene, base: CalibrationCorrespondences) -> float:
        """Return the mean loss of the cells of the base link."""
        lens = scene.lens
        uv, z = lens.project(base.p_P)
        sigma = _BASE_SIGMA_M * lens.camera.fx / np.maximum(z, _NEAREST_M)
        return float(np.log1p(((uv - base.uv_px) ** 2).sum(axis=1) / sigma**2).mean())

    def _compare(
        self,
        fit: Candidate,
        images: ContourImages,
        prior: LensPrior,
        frames: int,
        passes: Sequence[tuple[float, float]],
    ) -> Candidate:
        """Return a candidate fitted to the contours of some of its frames, with its agreement."""
        candidate = fit.take(np.unique(np.linspace(0, len(fit.rows) - 1, frames).round().astype(int)))
        images = images.take(candidate.rows)
        scene, _ = self._fit_contours(candidate.scene, candidate.cells, images, prior, passes, _PASS_SIGMA_RAD)
        return replace(candidate, scene=scene, agreement=float(np.median(images.agreement(scene))))

    def _extend(self, candidate: Candidate, detections: ArmDetections, search: ChainSearch) -> Candidate:
        """Return a candidate with all frames that its camera explains."""
        scene = candidate.scene
        hypothesis = search.explain(scene.lens, search.hands(scene.lens.camera))
        q, finger_m = hypothesis.q.copy(), detections.finger_m.copy()
        q[candidate.rows], finger_m[candidate.rows] = scene.q, scene.finger_m
        rows = np.flatnonzero(np.isfinite(q).all(axis=1))
        return Candidate(
            scene=ArmScene(lens=scene.lens, q=q[rows], finger_m=finger_m[rows]),
            rows=rows,
            cells=detections.cells.flip(hypothesis.flipped).of_frames(rows).thin(_THIN),
            cost=candidate.cost,
        )

    def _fit_contours(
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
                observed = cell_observations(cells, scene, self._model)
                observations = Observations.join([replace(observed, weight=weight * observed.weight), edges])
            own = prior.with_postures(scene.q if q is None else q, q_sigma)
            scene = adjust(observations, scene, own, self._model, iterations=4).scene
        return scene, edges

    def finish(
        self,
        candidate: Candidate,
        images: ContourImages,
        prior: LensPrior,
        *,
        rows: NDArray[np.intp],
        q_sigma: float | None = None,
    ) -> CameraEstimate:
        """Fit a candidate to the contours of all its frames; leave out frames that disagree, and compute sigmas.

        Args:
            candidate: camera and postures that are right within some pixels.
            images: images of the detections.
            prior: prior of the lens.
            rows: numbers of the frames of the detections.
            q_sigma: standard deviation of known joint angles [rad]; None if they are unknown.
        """
        sigma = _PASS_SIGMA_RAD if q_sigma is None else q_sigma
        edges, agreement = None, np.zeros(0)
        rounds: tuple[Sequence[tuple[float, float]], ...] = (_FINE, _FINE[-3:])
        for number, passes in enumerate(rounds):
            own = images.take(candidate.rows)
            q = None if q_sigma is None else candidate.scene.q
            scene, edges = self._fit_contours(candidate.scene, candidate.cells, own, prior, passes, sigma, q)
            candidate = replace(candidate, scene=scene)
            agreement = own.agreement(scene)
            good = np.flatnonzero(agreement >= _LEAST_SHARE * np.median(agreement))
            if number + 1 == len(rounds) or len(good) == len(agreement) or len(good) < MIN_FRAMES:
                break
            candidate = candidate.take(good)
        if edges is None:
            raise UnmeasurableError("no camera can be estimated: the images show no edges where the arm should be")
        bundle = self._uncertainty(candidate.scene, edges, prior, q_sigma)
        share = float(np.median(agreement)) * min(1.0, len(candidate.rows) / (_LEAST_EXPLAINED * len(rows)))
        return _describe(bundle, edges.part, self._model, share, rows[candidate.rows])

    def _uncertainty(self, scene: ArmScene, edges: Observations, prior: LensPrior, q_sigma: float | None) -> Bundle:
        """Return the information of a scene, contours of one part in one frame and parts at rest counted once."""
        X_BP = self._model.poses(scene.q)
        near = np.linalg.norm(X_BP[:, None, :, :3, 3] - X_BP[None, ..., :3, 3], axis=-1) <= _ALIKE_M
        cosine = (np.einsum("spij,tpij->stp", X_BP[..., :3, :3], X_BP[..., :3, :3]) - 1.0) / 2.0
        alike = np.maximum(1, (near & (cosine >= np.cos(_ALIKE_RAD))).sum(axis=1))
        count = np.zeros(X_BP.shape[:2])
        np.add.at(count, (edges.frame, edges.part), 1.0)
        weight = np.minimum(1.0, _PART_INDEPENDENT / count[edges.frame, edges.part]) / alike[edges.frame, edges.part]
        posture_sigma = POSTURE_SIGMA_RAD if q_sigma is None else q_sigma
        factor = _SIGMA_FACTOR if q_sigma is None else _JOINTS_SIGMA_FACTOR
        honest = replace(edges, weight=weight / factor**2)
        return adjust(honest, scene, prior.with_postures(scene.q, posture_sigma), self._model, iterations=0)


def _turned(scene: ArmScene, angle: float) -> ArmScene:
    """Return a scene with the base turned by -`angle` [rad] about joint 1, and joint 1 by `angle`: same links."""
    X_CB = scene.lens.X_CB @ make_pose(rotation_z(-angle), np.zeros(3))
    return replace(scene, lens=replace(scene.lens, X_CB=X_CB), q=scene.q + angle * (np.arange(N_JOINTS) == 0))


def usual_camera(width: int, height: int, fov_deg: float = 55.0) -> Camera:
    """Return a centred camera of unknown place with a usual field of view along the longer side [degrees]."""
    focal = max(width, height) / 2 / float(np.tan(np.deg2rad(fov_deg) / 2))
    return replace(benchmark_camera(), width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)


def focal_px(camera: Camera, fov_deg: float) -> float:
    """Return the focal length [px] of a field of view along the longer side [degrees]."""
    return max(camera.width, camera.height) / 2 / float(np.tan(np.deg2rad(fov_deg) / 2))


def cell_observations(cells: CalibrationCorrespondences, scene: ArmScene, model: ArmModel) -> Observations:
    """Return the cells of the networks' views as observations, with standard deviations at a scene."""
    lens = scene.lens
    p_B = locate_points(cells, model.poses(scene.q), scene.finger_m)
    _, z = lens.project(p_B)
    spread_m = cells.sigma_m * np.where(np.isin(cells.part, ARM), _LINK_FACTOR / LINK_SIGMAS, 1.0)
    floor = _FLOOR * PIXEL_SIGMA * lens.camera.unit_px
    sigma = np.hypot(floor, lens.camera.fx * spread_m / np.maximum(np.abs(z), _NEAREST_M))
    return Observations(
        frame=cells.frame,
        part=cells.part,
        p_P=cells.p_P,
        opening_sign=cells.opening_sign,
        uv_px=cells.uv_px,
        whitening=np.eye(2) / sigma[:, None, None],
        weight=cells.weight,
    )


def _distinct(ranked: Sequence[tuple[Lens, _Ranked]]) -> list[_Ranked]:
    """Return what belongs to lenses that differ from all before them."""
    kept: list[tuple[Lens, _Ranked]] = []
    for lens, item in ranked:
        if not any(_alike(lens, other) for other, _ in kept):
            kept.append((lens, item))
    return [item for _, item in kept]


def _alike(one: Lens, other: Lens) -> bool:
    zoom = abs(float(np.log(one.camera.fx / other.camera.fx)))
    return zoom <= _SAME_ZOOM and float(pose_difference(one.X_CB, other.X_CB)[1]) <= _SAME_RAD


def _describe(
    bundle: Bundle, part: NDArray[np.uint8], model: ArmModel, agreement: float, rows: NDArray[np.intp]
) -> CameraEstimate:
    """Return the estimate of a bundle adjustment."""
    scene, H = bundle.scene, bundle.information
    free = np.flatnonzero(np.diag(H) > 0)
    scale = np.sqrt(np.diag(H)[free])
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    inverse = np.linalg.pinv(H[np.ix_(free, free)] / np.outer(scale, scale) + 1e-9 * np.eye(len(free)))
    covariance[np.ix_(free, free)] = inverse / np.outer(scale, scale)
    spread = []
    for q, response in zip(scene.q, bundle.response, strict=True):
        X_BP, axis, point = model.poses_and_axes(q)
        X_BH = X_BP[RobotPart.HAND]
        tcp = X_BH[:3, 3] + HAND_TO_TCP_M * X_BH[:3, 2]
        J = np.concatenate([np.cross(axis, tcp - point).T, axis.T]) @ response
        spread.append(J @ covariance @ J.T)
    position, rotation = (float(np.median([np.trace(V[k, k]) for V in spread])) ** 0.5 for k in (_MOVE, _TURN))
    return CameraEstimate(
        camera=scene.lens.to_camera(),
        covariance=covariance,
        gripper_sigma_m=position,
        gripper_sigma_rad=rotation,
        agreement=agreement,
        runner_up=0.0,
        residual_px=float(np.median(bundle.error_px)),
        rows=rows,
        scene=scene,
        contour_part=part,
        contour_error_px=bundle.error_px,
    )
