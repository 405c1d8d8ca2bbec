"""Solution of the lens from cells of the robot and its known postures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, BundleAdjustment, Observations, Prior, adjust
from kinebench_drake.grounding.camera.detections import MIN_FRAMES, ArmDetections, CalibrationCorrespondences
from kinebench_drake.grounding.camera.lens import Lens, focal_px, solve_pnp, with_focal
from kinebench_drake.grounding.camera.states import RobotStates
from kinebench_drake.grounding.registration.arm_model import MIN_CELLS, ArmModel
from kinebench_drake.grounding.registration.solver import CAUCHY
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.segments import finite_rows

_FOV_DEG = (35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
"""Horizontal fields of view at which the search for the focal length starts [degrees]."""
_POSTURE_SIGMA_RAD = np.array([10.0, *[0.7] * 6])
"""Standard deviations of an initial posture [rad]; that of joint 1 is uninformative."""
_STARTS = 2
"""Initial lenses that are refined."""
_FIXED_SIGMA_RAD = 1e-3
"""Standard deviation of a posture that is known [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensSolution:
    """Lens fitted to cells of T frames."""

    bundle: BundleAdjustment
    """Fit; its joint angles are NaN where unknown."""
    cells: CalibrationCorrespondences
    X_BP: Array
    """(T, PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; NaN where unknown."""
    rows: NDArray[np.intp]
    """(T,) rows of the detections that were used."""

    @property
    def p_B(self) -> Array:
        """(N, 3) points of the cells [m]."""
        return self.cells.locate(self.X_BP, self.bundle.scene.finger_m)


def solve(
    robot: ArmDetections, states: RobotStates, guess: Camera, model: ArmModel, *, focal_free: bool
) -> LensSolution:
    """Solve the lens that projects the robot to where the frames show it, with all known postures.

    Args:
        robot: robot in some frames.
        states: robot states in the same frames.
        guess: initial camera.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: too little of the robot is visible, or it contradicts the postures.
    """
    rows = np.flatnonzero(states.has_hand)
    focal = [focal_px(guess.width, fov) for fov in _FOV_DEG]
    cameras = [guess, *(with_focal(guess, fx) for fx in focal)] if focal_free else [guess]
    anchored = len(rows) == 1 and len(states.q) >= MIN_FRAMES
    free = focal_free and not anchored
    cells = robot.cells.of_frames(rows)
    solved = _solve_lens(cells, robot.finger_m[rows], states.take(rows), cameras, model, focal_free=free)
    if not anchored or robot.q is None or finite_rows(robot.q).sum() < MIN_FRAMES:
        return replace(solved, rows=rows)
    q = np.where(states.has_posture[:, None], states.q, robot.q)
    return _solve_lens_and_postures(robot, q, states, solved.bundle.scene.lens, model, focal_free=focal_free)


def _solve_lens(
    cells: CalibrationCorrespondences,
    seen_m: Array,
    states: RobotStates,
    cameras: Sequence[Camera],
    model: ArmModel,
    *,
    focal_free: bool,
) -> LensSolution:
    """Solve the lens where the posture, or at least the hand pose, is known in every frame, from initial `cameras`."""
    X_BP = states.part_poses(model)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, seen_m)
    cells = cells.take(np.flatnonzero(finite_rows(cells.locate(X_BP, finger_m))))
    _require_enough(cells)
    starts = _find_consensus(cells, cells.locate(X_BP, finger_m), cameras)[:_STARTS]
    if not starts:
        raise UnmeasurableError(
            f"none of the {len(cells)} cells of the robot agree with {states.source}: do the angles belong to this "
            "video, in the order of its frames, in radians?"
        )
    fits = [fit_cells(cells, lens, model, X_BP, finger_m, focal_free=focal_free) for lens in starts]
    bundle = min(fits, key=lambda fit: fit.cost)
    flip = _misread(cells, bundle, X_BP, finger_m)
    if flip.any():
        cells = cells.flip(flip)
        bundle = fit_cells(cells, bundle.scene.lens, model, X_BP, finger_m, focal_free=focal_free)
    scene = ArmScene(lens=bundle.scene.lens, q=states.q, finger_m=finger_m)
    return LensSolution(bundle=replace(bundle, scene=scene), cells=cells, X_BP=X_BP, rows=np.arange(len(X_BP)))


def _solve_lens_and_postures(
    robot: ArmDetections, q: Array, states: RobotStates, start: Lens, model: ArmModel, *, focal_free: bool
) -> LensSolution:
    """Solve lens and postures jointly, where postures are known in few frames.

    A rotation of the camera about the axis of joint 1 is equivalent to other postures: only the base link, and known
    postures, determine it.
    """
    rows = np.flatnonzero(finite_rows(q))
    cells = robot.cells.of_frames(rows).thin()
    _require_enough(cells)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, robot.finger_m)[rows]
    q_sigma = np.where(states.has_posture[rows, None], _FIXED_SIGMA_RAD, _POSTURE_SIGMA_RAD)
    X_BP = model.poses(q[rows])
    q = q[rows]
    bundle = fit_cells(cells, start, model, X_BP, finger_m, focal_free=focal_free, q=q, q_sigma=q_sigma)
    return LensSolution(bundle=bundle, cells=cells, X_BP=model.poses(bundle.scene.q), rows=rows)


def fit_cells(
    cells: CalibrationCorrespondences,
    start: Lens,
    model: ArmModel,
    X_BP: Array,
    finger_m: Array,
    *,
    focal_free: bool,
    q: Array | None = None,
    q_sigma: Array | None = None,
    rounds: int = 2,
) -> BundleAdjustment:
    """Fit a lens to cells, with postures and openings or at known ones; parts at rest count once in its information.

    Args:
        cells: cells of T frames.
        start: initial lens.
        model: link poses of the arm.
        X_BP: (T, PARTS, 4, 4) poses of the parts in B [m].
        finger_m: (T,) opening of each finger [m].
        focal_free: True to estimate the focal length.
        q: (T, 7) initial joint angles to be estimated, too [rad]; None to keep all parts where they are.
        q_sigma: (T, 7) their standard deviations [rad].
        rounds: number of rounds, each with newly computed standard deviations of the cells.
    """
    prior = Prior(lens=start, log_focal_sigma=np.inf if focal_free else 0.0)
    p_B = cells.locate(X_BP, finger_m)
    repeats = cells.count_repeats(X_BP)

    def adjusted(scene: ArmScene, weight: Array, steps: int = 20) -> BundleAdjustment:
        points = p_B if q is None else cells.locate(model.poses(scene.q), scene.finger_m)
        observed = replace(Observations.of_cells(cells, cells.sigma_px(scene.lens, points)), weight=weight)
        if q is None:
            observed = observed.at_rest(p_B)
        return adjust(observed, scene, prior, model, q=q, q_sigma=q_sigma, iterations=steps)

    scene = ArmScene(lens=start, q=np.zeros((len(X_BP), N_JOINTS)) if q is None else q, finger_m=finger_m)
    for _ in range(rounds):
        scene = adjusted(scene, cells.weight).scene
    return adjusted(scene, cells.weight / repeats, 0)


def _find_consensus(cells: CalibrationCorrespondences, p_B: Array, cameras: Sequence[Camera]) -> list[Lens]:
    """Return initial lenses by RANSAC from the cells' points `p_B` (N, 3) [m], by decreasing number of inliers."""
    ranked = []
    for camera in cameras:
        solution = solve_pnp(p_B, cells.uv_px, camera)
        if solution is not None:
            X_CB, inliers = solution
            ranked.append((inliers, Lens(camera=camera, X_CB=X_CB)))
    return [lens for _, lens in sorted(ranked, key=lambda pair: -pair[0])]


def _require_enough(cells: CalibrationCorrespondences) -> None:
    """Check that enough of the robot is visible.

    Raises:
        UnmeasurableError: there are fewer than MIN_CELLS cells.
    """
    if len(cells) < MIN_CELLS:
        raise UnmeasurableError(
            f"{len(cells)} cells show a Panda over all frames, at least {MIN_CELLS} are needed: it is not in the "
            "images, or its appearance differs from that of the training data"
        )


def _misread(
    cells: CalibrationCorrespondences, bundle: BundleAdjustment, X_BP: Array, finger_m: Array
) -> NDArray[np.bool_]:
    """Return (T,) frames whose gripper cells fit better with the gripper rotated by 180 degrees about its axis."""
    lens = bundle.scene.lens
    turned = cells.flip(np.ones(len(X_BP), dtype=bool))
    other_px = np.linalg.norm(lens.project(turned.locate(X_BP, finger_m))[0] - cells.uv_px, axis=1)
    scale = CAUCHY * cells.sigma_px(lens, cells.locate(X_BP, finger_m))
    gain = np.log1p((bundle.error_px / scale) ** 2) - np.log1p((other_px / scale) ** 2)
    better = np.bincount(cells.frame, weights=gain * cells.of_gripper, minlength=len(X_BP))
    return np.asarray(better > 0.0)
