"""Solution of the lens from views of the robot and its known postures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.camera.articulated import refine_articulated
from kinebench_drake.grounding.camera.correspondences import (
    MIN_CELLS,
    CalibrationCorrespondences,
    LensView,
    ViewEstimator,
    locate_points,
)
from kinebench_drake.grounding.camera.fit import CAUCHY, Lens, LensFit, find_consensus, focal_px, refine, with_focal
from kinebench_drake.grounding.camera.states import RobotStates
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.tracking.view import Frames

FOV_DEG = (35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
"""Horizontal fields of view at which the search for the focal length starts [degrees]."""
MIN_MOVING_FRAMES = 4
"""Least number of frames if postures are estimated too."""
_STARTS = 2  # initial lenses that are refined
_USUAL_FOV_DEG = 60.0  # of a camera of which nothing is known
_AGAIN_ZOOM, _AGAIN_M, _AGAIN_RAD = 0.03, 0.03, np.deg2rad(3.0)
_EVERY = 3  # one of so many cells is used if postures are estimated too


@dataclass(frozen=True, slots=True, kw_only=True)
class LensSolution:
    """Fitted lens with its data."""

    fit: LensFit
    cells: CalibrationCorrespondences
    p_B: Array
    """(N, 3) points of the cells [m]."""
    X_BP: Array
    """(T, PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; NaN where unknown."""
    finger_m: Array
    """(T,) opening of each finger [m]."""
    rows: NDArray[np.intp]
    """(T,) rows of the view that were used."""


def solve_with_reestimate(
    estimator: ViewEstimator,
    frames: Frames,
    view: LensView,
    states: RobotStates,
    guess: Camera,
    model: ArmModel,
    *,
    focal_free: bool,
) -> LensSolution:
    """Solve the lens with the views of a guess; if the solution differs much, again with views of the solution.

    Args:
        estimator: view estimator.
        frames: (T, H, W, 3) images.
        view: views estimated with the guess.
        states: robot states in the frames.
        guess: initial camera.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: too little of the robot is visible, or it contradicts the postures.
    """
    solved = solve(view, states, guess, model, focal_free=focal_free)
    camera = solved.fit.lens.to_camera()
    distance, angle = pose_difference(camera.X_BC, guess.X_BC)
    if abs(np.log(camera.fx / guess.fx)) > _AGAIN_ZOOM or distance > _AGAIN_M or angle > _AGAIN_RAD:
        return solve(estimator.estimate(frames, camera), states, camera, model, focal_free=focal_free)
    return solved


def solve(view: LensView, states: RobotStates, guess: Camera, model: ArmModel, *, focal_free: bool) -> LensSolution:
    """Solve the lens that projects the robot to where the frames show it, with all known postures.

    Args:
        view: views of the frames.
        states: robot states in the same frames.
        guess: initial camera.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: too little of the robot is visible, or it contradicts the postures.
    """
    rows = np.flatnonzero(states.has_hand)
    focal = [focal_px(guess.width, fov) for fov in FOV_DEG]
    cameras = [guess, *(with_focal(guess, fx) for fx in focal)] if focal_free else [guess]
    anchored = len(rows) == 1 and len(states.q) >= MIN_MOVING_FRAMES
    solved = solve_lens(view.of_frames(rows), states.take(rows), cameras, model, focal_free=focal_free and not anchored)
    if not anchored or np.isfinite(view.q).all(axis=1).sum() < MIN_MOVING_FRAMES:
        return replace(solved, rows=rows)
    return solve_lens_and_postures(view, states, solved.fit.lens, model, focal_free=focal_free)


def default_focal_px(width: int) -> float:
    """Return an initial focal length [px] of an image of this width."""
    return focal_px(width, _USUAL_FOV_DEG)


def solve_lens(
    view: LensView, states: RobotStates, cameras: Sequence[Camera], model: ArmModel, *, focal_free: bool
) -> LensSolution:
    """Solve the lens where the posture, or at least the hand pose, is known in every frame.

    Args:
        view: view of the frames.
        states: robot states in the same frames.
        cameras: initial intrinsics.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: too little of the robot is visible, or it contradicts the postures.
    """
    X_BP = states.part_poses(model)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, view.finger_m)
    cells = view.cells.count_repeats(X_BP)
    p_B = locate_points(cells, X_BP, finger_m)
    finite = np.asarray(np.isfinite(p_B).all(axis=1))
    cells, p_B = cells.take(finite), p_B[finite]
    require_enough_cells(cells)
    starts = find_consensus(cells, p_B, cameras)[:_STARTS]
    if not starts:
        raise UnmeasurableError(
            f"none of the {len(cells)} cells of the robot agree with {states.source}: do the angles belong to this "
            "video, in the order of its frames, in radians?"
        )
    fit = min((refine(cells, p_B, lens, focal_free=focal_free) for lens in starts), key=lambda f: f.cost)
    flip = _misread(cells, fit, X_BP, finger_m)
    if flip.any():
        cells = cells.flip(flip)
        p_B = locate_points(cells, X_BP, finger_m)
        fit = refine(cells, p_B, fit.lens, focal_free=focal_free)
    return LensSolution(fit=fit, cells=cells, p_B=p_B, X_BP=X_BP, finger_m=finger_m, rows=np.arange(len(X_BP)))


def solve_lens_and_postures(
    view: LensView, states: RobotStates, start: Lens, model: ArmModel, *, focal_free: bool
) -> LensSolution:
    """Solve lens and postures jointly, where postures are known in few frames.

    Args:
        view: view of the frames.
        states: robot states in the same frames.
        start: initial lens.
        model: link poses of the arm.
        focal_free: True to estimate the focal length.

    Raises:
        UnmeasurableError: the arm is visible in too few frames.
    """
    fixed = states.has_posture
    q = np.where(fixed[:, None], states.q, view.q)
    rows = np.flatnonzero(np.isfinite(q).all(axis=1))
    if len(rows) < MIN_MOVING_FRAMES:
        raise UnmeasurableError(
            f"the arm behind the gripper is visible in {len(rows)} of {len(q)} frames, at least {MIN_MOVING_FRAMES} "
            "are needed without joint angles; give $joints FILE"
        )
    cells = view.cells.of_frames(rows).thin(_EVERY)
    require_enough_cells(cells)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, view.finger_m)[rows]
    cells = cells.count_repeats(model.poses(q[rows]))
    fitted = refine_articulated(cells, start, q[rows], finger_m, model, fixed=fixed[rows], focal_free=focal_free)
    X_BP = model.poses(fitted.q)
    return LensSolution(
        fit=fitted.fit,
        cells=cells,
        p_B=locate_points(cells, X_BP, fitted.finger_m),
        X_BP=X_BP,
        finger_m=fitted.finger_m,
        rows=rows,
    )


def require_enough_cells(cells: CalibrationCorrespondences) -> None:
    """Check that enough of the robot is visible.

    Raises:
        UnmeasurableError: there are fewer than MIN_CELLS cells.
    """
    if len(cells) < MIN_CELLS:
        raise UnmeasurableError(
            f"{len(cells)} cells show a Panda over all frames, at least {MIN_CELLS} are needed: it is not in the "
            "images, or its appearance differs from that of the training data"
        )


def _misread(cells: CalibrationCorrespondences, fit: LensFit, X_BP: Array, finger_m: Array) -> NDArray[np.bool_]:
    """Return (T,) frames whose gripper cells fit better with the gripper rotated by 180 degrees about its axis."""
    everywhere = cells.flip(np.ones(len(X_BP), dtype=bool))
    uv, _ = fit.lens.project(locate_points(everywhere, X_BP, finger_m))
    other = (uv - cells.uv_px) / fit.sigma_px[:, None]
    gain = np.log1p((fit.residual / CAUCHY) ** 2).sum(axis=1) - np.log1p((other / CAUCHY) ** 2).sum(axis=1)
    better = np.bincount(cells.frame, weights=gain * cells.of_gripper, minlength=len(X_BP))
    return np.asarray(better > 0.0)
