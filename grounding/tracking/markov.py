"""Hidden Markov models along a video: gripper width, half turns of the gripper, and turn of the last joint.

States are likely in their frames and in their changes from frame to frame. The likeliest sequence is found by dynamic
programming (Viterbi), uncertainties by the forward-backward algorithm; Rabiner, "A tutorial on hidden Markov models",
Proc. IEEE 77(2), 1989.

- Rotated half a turn about its approach axis the gripper looks almost the same. Each frame yields a log-likelihood
  ratio of the fitted pose against the flipped one, and sudden rotations are avoided.
- The turn of the last joint is on a grid. Where its change between two frames is measured, both vote for the same turn,
  up to the error of that change.
- Fingers rest or keep their speed, also where they are hidden: states are widths and speeds.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.special import logsumexp, softmax

from kinebench_drake.geometry import Array, invert, rotation_angle, transform_points
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.registration.arm_model import EVIDENCE_CAP
from kinebench_drake.grounding.registration.hand_contour import GAP_STEP_M, GAPS_M
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.models.gripper import X_HALF_TURN
from kinebench_drake.models.panda.cad import MAX_FINGER_M

# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_BLIND_M = 0.010
"""Standard deviation of a width from which on it is ignored [m]."""
_UNKNOWN_M = 0.015
"""Standard deviation of a width above which it is unknown after all [m].

Large errors of widths correlate: fingers that hide each other are confused."""
_CAP_WITH_EDGES = 2.0
"""Greatest log-likelihood ratio by CAD coordinates, which are less sure where poses had to be fitted to edges."""
_ROTATION_SIGMA_RAD = np.deg2rad(20.0)
"""Usual rotation between frames [rad]."""
_AGREEMENT_NATS = 25.0
"""Log-likelihood ratio per difference of edge agreement of postures."""
_JOINT_SIGMA_RAD = 0.25
"""Usual change of a joint from frame to frame [rad]."""
_JOINT_CAP = 12.0
"""Greatest cost of a change of posture: generated arms jump."""
_ROTATION_CAP = 40.0
"""Cost of a jump: half a turn in one frame is no motion of an arm."""
TURNS_RAD = np.deg2rad(np.arange(-170.0, 171.0, 10.0))
"""Turns over the range of the joint [rad]."""
OFFSETS_RAD = np.deg2rad(np.arange(-15.0, 15.1, 3.0))
"""Offsets from turns that are known roughly [rad]."""
_STATES = 5
"""States from one turn of the grid to the next."""
_STEP_RAD = np.deg2rad(8.0)
"""Standard deviation of a step from frame to frame, and of a change that is measured badly [rad]."""
_CHANGE_RAD = np.deg2rad(1.5)
"""Standard deviation of a measured change [rad]."""
_BADLY = 0.1
"""Share of the changes that are measured badly."""
_BLUNT_FACTOR = 2.5
"""Factor by which the error of a width that is not sharp exceeds its standard deviation."""
_OUTLIER_SHARE = 0.02
_EDGE_OUTLIERS = 0.05
_SPEEDS = np.array([0, *(s * k for k in (1, 2, 3, 4, 6, 10, 15, 25, 40) for s in (-1, 1))])
"""Changes of the width per frame in grid steps; the first is rest."""
_REST = 0.96
"""Probability that resting fingers rest in the next frame."""
_GO_ON = 0.6
"""Probability that moving fingers keep their speed in the next frame."""
_BLUR = (0.1, 0.8, 0.1)
"""Probabilities of one step less than the speed, of the speed, and of one step more."""


def _likeliest_states(own: Sequence[Array] | Array, steps: Sequence[Array]) -> list[int]:
    """Return the likeliest sequence of T states (Viterbi 1967).

    Args:
        own: (T, S) log-likelihood of each state by its frame alone.
        steps: (T - 1, S, S) log-probability of each state (rows) after each other (columns).
    """
    best = own[0]
    origins = []
    for step, row in zip(steps, own[1:], strict=True):
        reached = best + step
        origins.append(reached.argmax(axis=1))
        best = reached.max(axis=1) + row
    path = [int(best.argmax())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    return path[::-1]


def flip_evidence(pose: FramePose, *, is_symmetric: bool = False) -> float:
    """Return the log-likelihood ratio of the fitted pose against the flipped one, given the CAD coordinates.

    Those of a symmetric gripper tell nothing: the arm alone does.
    """
    of_arm = 0.0 if pose.arm is None else pose.arm.evidence
    if is_symmetric:
        return of_arm
    view = pose.view
    cells = view.gripper
    cloud_V = view.rays()[cells] * (view.depth_m[cells] * pose.hand.depth_factor)[:, None]
    p_H = transform_points(invert(pose.X_CH) @ view.crop.X_CV, cloud_V)
    p_H[:, 1] -= view.opening_sign[cells] * (pose.finger_m if np.isfinite(pose.finger_m) else 0.0)
    scale = view.coordinates_sigma_m[cells] / np.sqrt(2.0)
    estimated_H = view.coordinates_P[cells]
    as_fitted = np.abs(p_H - estimated_H).sum(axis=1) / scale
    flipped = np.abs(p_H * [-1.0, -1.0, 1.0] - estimated_H).sum(axis=1) / scale
    of_hand = float((flipped - as_fitted).mean())
    cap = EVIDENCE_CAP if pose.arm is None or np.isnan(pose.arm.edge_agreement) else _CAP_WITH_EDGES
    return float(np.clip(of_hand, -cap, cap)) + of_arm


def _rotation_cost(X_1: Array, X_2: Array) -> float:
    angle = float(rotation_angle(X_1[:3, :3].T @ X_2[:3, :3]))
    return float(min((angle / _ROTATION_SIGMA_RAD) ** 2, _ROTATION_CAP))


def resolve_flips(poses: Sequence[FramePose | None], *, is_symmetric: bool = False) -> list[FramePose | None]:
    """Return the poses, each as fitted or flipped, that fit the whole video best; of a symmetric gripper by its arm."""
    measured = [(i, pose) for i, pose in enumerate(poses) if pose is not None]
    resolved = list(poses)
    if not measured:
        return resolved
    own = [
        np.array([0.0, -np.inf if pose.from_prior else -flip_evidence(pose, is_symmetric=is_symmetric)])
        for _, pose in measured
    ]
    variants = [(pose.X_CH, pose.X_CH @ X_HALF_TURN) for _, pose in measured]
    steps = [
        -np.array([[_rotation_cost(before, after) for before in previous] for after in current])
        for previous, current in pairwise(variants)
    ]
    for (i, pose), (_, flipped), state in zip(measured, variants, _likeliest_states(own, steps), strict=True):
        if state:
            resolved[i] = replace(pose, X_CH=flipped)
    return resolved


def likeliest_postures(numbers: Sequence[int], postures: Sequence[Array], agreements: Sequence[Array]) -> list[int]:
    """Return the number of the posture in each of T frames that makes the likeliest path of the arm.

    Args:
        numbers: numbers of the frames, ascending.
        postures: of each frame, postures (S, 7) that were fitted to it [rad].
        agreements: of each frame, shares (S,) of their contours on edges of the image.
    """
    own = [_AGREEMENT_NATS * shares for shares in agreements]
    steps = []
    for (first, before), (second, after) in pairwise(zip(numbers, postures, strict=True)):
        sigma = _JOINT_SIGMA_RAD * (second - first) ** 0.5
        distance = np.square((before[:, None] - after[None]) / sigma).sum(axis=-1)
        steps.append(-np.minimum(0.5 * distance, _JOINT_CAP))
    return _likeliest_states(own, [step.T for step in steps])


def likeliest_turns(grid_rad: Array, log_likelihood: Array, change_rad: Array) -> tuple[Array, Array]:
    """Return the turns (T,) that are likeliest together, and their standard deviations (T,) [rad].

    Args:
        grid_rad: (M,) turns at equal steps [rad]; between them likelihoods are interpolated.
        log_likelihood: (T, M) of each turn in each frame; 0 where nothing is known.
        change_rad: (T - 1,) measured changes of the turn from each frame to the next [rad]; NaN where there is none.
    """
    state = np.linspace(grid_rad[0], grid_rad[-1], _STATES * (len(grid_rad) - 1) + 1)
    own = np.array([np.interp(state, grid_rad, row) for row in log_likelihood])
    steps = [_step(state, change) for change in change_rad]
    turns = state[_likeliest_states(own, steps)]
    posterior = _forward(own, steps) + _forward(own[::-1], [step.T for step in reversed(steps)])[::-1] - own
    probability = np.exp(posterior - logsumexp(posterior, axis=1, keepdims=True))
    return turns, np.sqrt((probability * (state - turns[:, None]) ** 2).sum(axis=1))


def _step(state: Array, change_rad: float) -> Array:
    """Return the log-probability of each state (rows) after each other (columns), up to a constant."""
    moved = state[:, None] - state
    if not np.isfinite(change_rad):
        return np.asarray(_log_normal(moved, _STEP_RAD))
    error = moved - change_rad
    good = np.log(1.0 - _BADLY) + _log_normal(error, _CHANGE_RAD)
    return np.asarray(np.logaddexp(good, np.log(_BADLY) + _log_normal(error, _STEP_RAD)))


def _log_normal(error: Array, sigma: float) -> Array:
    return np.asarray(-0.5 * (error / sigma) ** 2 - np.log(sigma))


def _forward(own: Array, steps: list[Array]) -> Array:
    """Return the log-likelihoods (T, M) of the states given all frames up to each."""
    forward = [own[0]]
    for step, row in zip(steps, own[1:], strict=True):
        forward.append(row + logsumexp(forward[-1] + step, axis=1))
    return np.array(forward)


def smooth_gripper_width(width_m: Array, sigma_m: Array, by_edges: Sequence[Array | None] | None = None) -> Array:
    """Return the gripper width (T,) [m], NaN where neither the frame nor its neighbours determine it.

    It is the median of the posterior by two kinds of evidence.

    Args:
        width_m: (T,) measured widths [m]; NaN where there is none.
        sigma_m: (T,) their standard deviations [m]; 0 of widths taken from priors.
        by_edges: (T,) log-likelihoods (G,) of `GAPS_M` by the edges of the image; None where there are none.
    """
    shown = {i: row for i, row in enumerate(by_edges or ()) if row is not None and sigma_m[i] != 0.0}
    if not shown and not np.isfinite(width_m).any():
        return np.full(len(width_m), np.nan)
    widths, initial, transition = _model()
    likelihoods = _likelihoods(width_m, sigma_m, widths)
    for i, row in shown.items():
        mixed = (1.0 - _EDGE_OUTLIERS) * softmax(row) + _EDGE_OUTLIERS / len(row)
        likelihoods[i] *= np.repeat(mixed, len(_SPEEDS))
    forward = [_normalized(initial * likelihoods[0])]
    for likelihood in likelihoods[1:]:
        forward.append(_normalized((forward[-1] @ transition) * likelihood))
    backward = [np.ones(likelihoods.shape[1])]
    for likelihood in likelihoods[:0:-1]:
        backward.append(_normalized(transition @ (backward[-1] * likelihood)))
    posterior = (np.array(forward) * np.array(backward[::-1])).reshape(len(width_m), -1, len(_SPEEDS)).sum(axis=2)
    posterior /= posterior.sum(axis=1, keepdims=True)
    spread = np.sqrt(np.maximum(posterior @ GAPS_M**2 - (posterior @ GAPS_M) ** 2, 0.0))
    median = [_median(probabilities) for probabilities in posterior]
    return np.where(sigma_m == 0.0, width_m, np.where(spread <= _UNKNOWN_M, median, np.nan))


def _median(probabilities: Array) -> float:
    """Return the median of a density that is uniform within each grid step; a mean could lie between two modes."""
    edges = np.append(GAPS_M - GAP_STEP_M / 2, GAPS_M[-1] + GAP_STEP_M / 2)
    middle = np.interp(0.5, np.append(0.0, np.cumsum(probabilities)), edges)
    return float(np.clip(middle, GAPS_M[0], GAPS_M[-1]))


def _likelihoods(width_m: Array, sigma_m: Array, widths: Array) -> Array:
    """Return the likelihoods (T, S) of the states, whose widths are `widths` (S,), given the measurements (T,)."""
    sigma_m = np.where(sigma_m <= bounds.SHARP_M, np.maximum(sigma_m, GAP_STEP_M / 2), _BLUNT_FACTOR * sigma_m)
    usable = np.isfinite(width_m) & (sigma_m <= _BLUNT_FACTOR * _BLIND_M)
    width_m = np.where(usable, width_m, 0.0)[:, None]
    sigma_m = np.where(usable, sigma_m, 1.0)[:, None]
    fits = np.exp(-0.5 * ((widths - width_m) / sigma_m) ** 2) / sigma_m
    return np.where(usable[:, None], (1.0 - _OUTLIER_SHARE) * fits + _OUTLIER_SHARE / (2 * MAX_FINGER_M), 1.0)


def _normalized(probabilities: Array) -> Array:
    return np.asarray(probabilities / probabilities.sum())


@lru_cache(maxsize=1)
def _model() -> tuple[Array, Array, Array]:
    """Return the width (S,) [m] and initial probability (S,) of each state, and the transition matrix (S, S)."""
    n = len(GAPS_M)
    k = len(_SPEEDS)
    change = np.full((k, k), (1.0 - _GO_ON) / (2 * (k - 1)))  # moving fingers stop as often as they change speed
    change[:, 0] += (1.0 - _GO_ON) / 2
    change[np.arange(k), np.arange(k)] = _GO_ON
    change[0] = (1.0 - _REST) / (k - 1)
    change[0, 0] = _REST
    change /= change.sum(axis=1, keepdims=True)
    transition = np.zeros((n, k, n, k))
    for speed, steps in enumerate(_SPEEDS):
        for width in range(n):
            for blur, share in zip((-1, 0, 1), _BLUR, strict=True):
                end = min(max(width + steps + blur, 0), n - 1)
                transition[width, :, end, speed] += share * change[:, speed]
    return np.repeat(GAPS_M, k), np.tile(change[0] / n, n), transition.reshape(n * k, n * k)
