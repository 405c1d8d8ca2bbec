"""Joint estimation of lens and postures, from a moving robot of unknown joint angles.

The link lengths are known and the base is fixed, so the arm is the calibration target. Unknown are the camera pose, the
focal length, and seven angles and a finger opening per frame (bundle adjustment; Triggs et al., "Bundle adjustment, a
modern synthesis", 1999). A rotation of the camera about the axis of joint 1 is equivalent to other postures: only the
base link determines it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.correspondences import CalibrationCorrespondences, locate_points
from kinebench_drake.grounding.camera.fit import CAUCHY, UNKNOWNS, Lens, LensFit, cauchy_loss, left_jacobian, sigma_px
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.models.panda.cad import MAX_FINGER_M
from kinebench_drake.models.robot import N_JOINTS

_A_FRAME = N_JOINTS + 1
_SIGMA_RAD = np.array([10.0, *[0.7] * 6])  # prior of an initial posture; that of joint 1 is uninformative
_FIXED_SIGMA_RAD, _OPENING_SIGMA_M = 1e-3, 0.02
_OVER_LIMIT_RAD = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class ArticulatedFit:
    """Lens fitted jointly with postures."""

    fit: LensFit
    """Fitted lens; its information is marginal, with the postures eliminated."""
    q: Array
    """(T, 7) joint angles [rad]."""
    finger_m: Array
    """(T,) opening of each finger [m]."""


def refine_articulated(
    cells: CalibrationCorrespondences,
    start: Lens,
    q: Array,
    finger_m: Array,
    model: ArmModel,
    *,
    fixed: NDArray[np.bool_],
    focal_free: bool,
    rounds: int = 2,
) -> ArticulatedFit:
    """Refine lens, openings and free postures by robust least squares on the reprojection.

    Args:
        cells: cells of T frames.
        start: initial lens.
        q: (T, 7) initial postures [rad].
        finger_m: (T,) initial openings of each finger [m].
        model: link poses of the arm.
        fixed: (T,) frames whose postures are fixed.
        focal_free: True to estimate the focal length.
        rounds: number of rounds, each with newly computed sigmas [px].
    """
    free = UNKNOWNS if focal_free else UNKNOWNS - 1
    frames = len(q)
    rows = free + _A_FRAME * np.arange(frames)[:, None] + np.arange(_A_FRAME)
    posture_sigma = np.where(fixed[:, None], _FIXED_SIGMA_RAD, _SIGMA_RAD)
    scale = np.concatenate([posture_sigma, np.full((frames, 1), _OPENING_SIGMA_M)], axis=1).ravel()
    prior = np.zeros((len(scale), free + len(scale)))
    prior[:, free:] = np.diag(1.0 / scale)
    weight = np.concatenate([np.repeat(cells.weight, 2), np.ones(len(scale))])
    first = np.concatenate([q, finger_m[:, None]], axis=1).ravel()
    lower = np.tile([*(model.lower - _OVER_LIMIT_RAD), 0.0], frames)
    upper = np.tile([*(model.upper + _OVER_LIMIT_RAD), MAX_FINGER_M], frames)
    state = np.clip(first, lower + 1e-6, upper - 1e-6)
    lens, sigma = start, np.ones((len(cells), 1))

    def parts(x: Array) -> tuple[Lens, Array, Array]:
        own = x[free:].reshape(frames, _A_FRAME)
        return lens.displace(np.concatenate([x[:free], np.zeros(UNKNOWNS - free)])), own[:, :N_JOINTS], own[:, N_JOINTS]

    def errors(x: Array) -> Array:
        here, angles, opening = parts(x)
        uv, _ = here.project(locate_points(cells, model.poses(angles), opening))
        return np.concatenate([((uv - cells.uv_px) / sigma).ravel(), (x[free:] - first) / scale])

    def slopes(x: Array) -> Array:
        here, angles, opening = parts(x)
        J = np.zeros((len(cells), 2, len(x)))
        by_lens, by_state = _derivatives(cells, here, angles, opening, model)
        by_lens[..., :3] = by_lens[..., :3] @ left_jacobian(x[:3])
        J[..., :free] = by_lens[..., :free]
        J[np.arange(len(cells))[:, None, None], np.arange(2)[:, None], rows[cells.frame][:, None]] = by_state
        return np.concatenate([(J / sigma[..., None]).reshape(-1, len(x)), prior])

    solution = None
    for _ in range(rounds):
        sigma = sigma_px(cells, lens, locate_points(cells, model.poses(_angles(state)), state[N_JOINTS::_A_FRAME]))[
            :, None
        ]
        solution = least_squares(
            errors,
            np.concatenate([np.zeros(free), state]),
            jac=slopes,
            bounds=(np.concatenate([np.full(free, -np.inf), lower]), np.concatenate([np.full(free, np.inf), upper])),
            loss=lambda z: cauchy_loss(weight, z),
            f_scale=CAUCHY,
            x_scale="jac",
            max_nfev=40,
        )
        lens, state = parts(solution.x)[0], solution.x[free:]
    at = np.concatenate([np.zeros(free), state])
    error, J = errors(at), slopes(at)
    n = 2 * len(cells)
    W = weight / (1.0 + (error / CAUCHY) ** 2)
    W[:n] /= np.repeat(cells.repeats, 2)
    H = J.T @ (J * W[:, None])
    states = H[free:, free:] + 1e-9 * np.eye(len(H) - free)
    information = np.zeros((UNKNOWNS, UNKNOWNS))
    information[:free, :free] = H[:free, :free] - H[:free, free:] @ np.linalg.solve(states, H[free:, :free])
    residual = error[:n].reshape(-1, 2)
    cost = float((cells.weight[:, None] * np.log1p((residual / CAUCHY) ** 2)).sum() / (2 * cells.weight.sum()))
    fit = LensFit(lens=lens, cost=cost, residual_px=residual * sigma, sigma_px=sigma[:, 0], information=information)
    return ArticulatedFit(fit=fit, q=_angles(state), finger_m=state[N_JOINTS::_A_FRAME])


def _angles(state: Array) -> Array:
    return state.reshape(-1, _A_FRAME)[:, :N_JOINTS]


def _derivatives(
    cells: CalibrationCorrespondences, lens: Lens, q: Array, finger_m: Array, model: ArmModel
) -> tuple[Array, Array]:
    """Return the derivatives of the cells' pixels by the lens (N, 2, 7) and by angles and opening (N, 2, 8)."""
    p_B = locate_points(cells, model.poses(q), finger_m)
    by_lens, by_C = lens.derivatives(p_B)
    by_B = by_C @ lens.X_CB[:3, :3]
    to_camera = [model.poses_and_axes(posture) for posture in q]
    axis, point = (np.stack([p[k] for p in to_camera])[cells.frame] for k in (1, 2))
    turning = np.cross(axis, p_B[:, None] - point) * model.moves[cells.part][..., None]
    y_B = np.stack([p[0] for p in to_camera])[cells.frame, cells.part, :3, 1]
    moving = np.concatenate([turning, (cells.opening_sign[:, None] * y_B)[:, None]], axis=1)
    return by_lens, np.asarray(by_B @ np.swapaxes(moving, 1, 2))
