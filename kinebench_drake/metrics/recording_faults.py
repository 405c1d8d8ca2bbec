"""Faults of a recording that have nothing to do with the robot: idle ends, a lag between action and state, copies."""

import hashlib

import numpy as np

from kinebench_drake.geometry import Array, rotation_angle
from kinebench_drake.results.row import ActionLag
from kinebench_drake.segments import finite_rows
from kinebench_drake.track import GripperTrack

IDLE_S = 1.0
"""Shortest rest at an end of a recording that counts as idle [s]."""
# from the pose at the end; beyond sensors' noise
_STILL_M = 0.005
_STILL_RAD = 0.04
_STILL_GAP_M = 0.004
LAG_S = 1.0
"""Greatest lag that is looked for, either way [s]."""
_CORRELATED = 0.5  # least correlation of actions with the motion that they command
_SHARP = 0.02  # of the correlation: lags that come as near to the greatest are not told from its own


def idle_ends(track: GripperTrack) -> list[int] | None:
    """Return the frames at the start and at the end in which the gripper rests, 0 if less than IDLE_S; None if unknown.

    A rest throughout counts at the start.
    """
    frames = np.flatnonzero(track.tracked & finite_rows(track.X_BG.reshape(-1, 16)))
    if len(frames) < 2:
        return None
    counts = []
    for order in (frames, frames[::-1]):
        X = track.X_BG[order]
        gap = track.finger_width_m[order]
        moved = np.linalg.norm(X[:, :3, 3] - X[0, :3, 3], axis=-1) > _STILL_M
        moved |= rotation_angle(X[0, :3, :3].T @ X[:, :3, :3]) > _STILL_RAD
        moved |= np.nan_to_num(np.abs(gap - gap[0])) > _STILL_GAP_M
        rest = int(np.argmax(moved)) if moved.any() else len(order)
        idle_s = abs(float(track.t_s[order[rest - 1]] - track.t_s[order[0]]))
        counts.append(rest if idle_s >= IDLE_S else 0)
    return [counts[0], 0] if counts[0] == len(frames) else counts


def find_action_lag(state: Array, action: Array, period_s: float) -> ActionLag | None:
    """Find by how many frames states (T, n) follow the actions (T, n) that command them; None if they do not correlate.

    Changes of the state are correlated with changes of the action (targets) and with the action itself (deltas); the
    better of the two counts. `frames`: lag of the greatest correlation, negative if actions come after the motion;
    `tolerance`: lags up to this far from it correlate as well; `correlation`.
    """
    change = np.diff(state, axis=0)
    most = min(max(round(LAG_S / period_s), 2), len(change) // 3)
    if most < 2 or not (np.isfinite(state).all() and np.isfinite(action).all()):
        return None
    curves = [_correlations(signal, change, most) for signal in (np.diff(action, axis=0), action[:-1])]
    values = max(curves, key=max)
    best = int(np.argmax(values))
    tolerance = int(np.abs(np.flatnonzero(values >= values[best] - _SHARP) - best).max())
    if values[best] < _CORRELATED or tolerance >= most:
        return None
    return ActionLag(frames=best - most, tolerance=tolerance, correlation=float(values[best]))


def _correlations(signal: Array, change: Array, most: int) -> Array:
    """Return the mean correlation (2 most + 1,) of columns that move with changes `-most` to `most` rows later."""
    moves = (np.ptp(signal, axis=0) > 0.0) & (np.ptp(change, axis=0) > 0.0)
    if not moves.any():
        return np.zeros(2 * most + 1)
    signal = signal[:, moves]
    change = change[:, moves]
    weight = np.linalg.norm(change, axis=0)
    values = []
    for lag in range(-most, most + 1):
        n = len(signal) - abs(lag)
        pair = signal[max(-lag, 0) :][:n], change[max(lag, 0) :][:n]
        a, b = (part - part.mean(axis=0) for part in pair)
        power = np.maximum(np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0), 1e-12)
        values.append(float(weight @ ((a * b).sum(axis=0) / power) / weight.sum()))
    return np.array(values)


def fingerprint(values: Array | None) -> str | None:
    """Return a hash that equal motions share: of the numbers in single precision; None if none is finite."""
    if values is None:
        return None
    numbers = np.asarray(values, dtype=np.float32)
    return hashlib.sha256(numbers.tobytes()).hexdigest()[:16] if np.isfinite(numbers).any() else None
