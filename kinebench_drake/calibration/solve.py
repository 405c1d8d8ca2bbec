"""From what is seen of the robot, and what is known of its posture, to the lens."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.calibration.articulated import refine_articulated
from kinebench_drake.calibration.correspondences import CalibrationCorrespondences, LensView, points
from kinebench_drake.calibration.fit import CAUCHY, Lens, LensFit, consensus, refine
from kinebench_drake.calibration.result import MIN_CELLS
from kinebench_drake.calibration.states import RobotStates
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.arm_model import ArmModel

MIN_MOVING_FRAMES = 4
"""Frames needed where postures are looked for as well."""
_STARTS = 2  # lenses of the consensus that are refined
_EVERY = 3  # of the cells are enough where postures are looked for as well


@dataclass(frozen=True, slots=True, kw_only=True)
class LensSolution:
    """A lens, and what it was fitted to."""

    fit: LensFit
    cells: CalibrationCorrespondences
    p_B: Array
    """(N, 3) points of the cells [m]."""
    X_BP: Array
    """(T, PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; NaN where not known."""
    finger_m: Array
    """(T,) opening of each finger [m]."""
    rows: NDArray[np.intp]
    """(T,) rows of the look that were used."""


def solve_known(
    look: LensView, states: RobotStates, cameras: Sequence[Camera], model: ArmModel, *, zoom_free: bool
) -> LensSolution:
    """The lens, where the robot's posture, or at least the hand's pose, is known in every frame.

    Args:
        look: what the frames show.
        states: the robot in the same frames.
        cameras: intrinsics to start with.
        model: link poses of the arm.
        zoom_free: whether the focal length is looked for.

    Raises:
        UnmeasurableError: too little is seen, or nothing that is seen goes with the postures.
    """
    X_BP = states.part_poses(model)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, look.finger_m)
    cells = look.cells.repeated(X_BP)
    p_B = points(cells, X_BP, finger_m)
    there = np.asarray(np.isfinite(p_B).all(axis=1))
    cells, p_B = cells.take(there), p_B[there]
    require_cells(cells)
    starts = consensus(cells, p_B, cameras)[:_STARTS]
    if not starts:
        raise UnmeasurableError(
            f"nothing that is seen of the robot ({len(cells)} cells) goes with {states.source}: are they of this "
            "video, in the order of its frames, in radians?"
        )
    fit = min((refine(cells, p_B, lens, zoom_free=zoom_free) for lens in starts), key=lambda f: f.cost)
    turned = _misread(cells, fit, X_BP, finger_m)
    if turned.any():
        cells = cells.turned(turned)
        p_B = points(cells, X_BP, finger_m)
        fit = refine(cells, p_B, fit.lens, zoom_free=zoom_free)
    return LensSolution(fit=fit, cells=cells, p_B=p_B, X_BP=X_BP, finger_m=finger_m, rows=np.arange(len(X_BP)))


def solve_moving(look: LensView, states: RobotStates, start: Lens, model: ArmModel, *, zoom_free: bool) -> LensSolution:
    """The lens and the postures together, where these are known in a few frames or in none.

    Args:
        look: what the frames show.
        states: the robot in the same frames.
        start: where to begin.
        model: link poses of the arm.
        zoom_free: whether the focal length is looked for.

    Raises:
        UnmeasurableError: the arm is seen in too few frames.
    """
    known = states.postured
    q = np.where(known[:, None], states.q, look.q)
    rows = np.flatnonzero(np.isfinite(q).all(axis=1))
    if len(rows) < MIN_MOVING_FRAMES:
        raise UnmeasurableError(
            f"the arm behind the gripper is seen in {len(rows)} of {len(q)} frames, at least {MIN_MOVING_FRAMES} are "
            "needed without joint angles; give --joints FILE"
        )
    cells = look.cells.of_frames(rows).thinned(_EVERY)
    require_cells(cells)
    finger_m = np.where(np.isfinite(states.finger_m), states.finger_m, look.finger_m)[rows]
    cells = cells.repeated(model.poses(q[rows]))
    found = refine_articulated(cells, start, q[rows], finger_m, model, known=known[rows], zoom_free=zoom_free)
    X_BP = model.poses(found.q)
    return LensSolution(
        fit=found.fit,
        cells=cells,
        p_B=points(cells, X_BP, found.finger_m),
        X_BP=X_BP,
        finger_m=found.finger_m,
        rows=rows,
    )


def require_cells(cells: CalibrationCorrespondences) -> None:
    """Refuse frames that show next to nothing of the robot.

    Raises:
        UnmeasurableError: they do.
    """
    if len(cells) < MIN_CELLS:
        raise UnmeasurableError(
            f"{len(cells)} cells show a Panda over all frames, at least {MIN_CELLS} are needed: it is not in the "
            "picture, or does not look like the one the network knows"
        )


def _misread(cells: CalibrationCorrespondences, fit: LensFit, X_BP: Array, finger_m: Array) -> NDArray[np.bool_]:
    """(T,) frames in which the gripper's cells go better with it turned by 180 degrees about its axis."""
    everywhere = cells.turned(np.ones(len(X_BP), dtype=bool))
    uv, _ = fit.lens.project(points(everywhere, X_BP, finger_m))
    other = (uv - cells.uv_px) / fit.sigma_px[:, None]
    gain = np.log1p((fit.residual / CAUCHY) ** 2).sum(axis=1) - np.log1p((other / CAUCHY) ** 2).sum(axis=1)
    better = np.bincount(cells.frame, weights=gain * cells.of_gripper, minlength=len(X_BP))
    return np.asarray(better > 0.0)
