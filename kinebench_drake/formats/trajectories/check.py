"""Validation of a raw trajectory: a trajectory that can be judged, or a one-line reason why it cannot."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UnmeasurableError, count_noun
from kinebench_drake.formats.trajectories.recorder import unwrap
from kinebench_drake.formats.trajectories.times import check_times, fill_gaps, undo_jitter
from kinebench_drake.formats.trajectories.trajectory import (
    MAX_FRAMES,
    RawTrajectory,
    Trajectory,
    first_index,
    others_text,
    require_numbers,
)
from kinebench_drake.geometry import Array, make_pose, orthonormalize
from kinebench_drake.segments import finite_rows, rounding_unit, spread
from kinebench_drake.track import MAX_WIDTH_M

MIN_FRAMES = 2
"""A path needs two postures."""
REPAIRABLE = 1e-3
"""Greatest deviation of R^T R from the identity, or of a quaternion's norm from 1, that is repaired."""
FAR_M = 10.0
"""Greatest coordinate of the gripper in the robot base frame [m]: larger values are not in metres."""
ROUNDED_UNITS = 4.0
"""The same of rounded rotations, in units of their last digit."""
ROUNDING = 1e-5
"""Deviation within single precision, which is repaired without a warning."""

_MANY_RAD = 10.0  # larger angles are taken for degrees
_WIDTH_SLACK_M = 0.01  # overshoot of sensors and simulators


def check(raw: RawTrajectory, rate_hz: float | None = None) -> Trajectory:
    """Check shapes, times, rotations, units and values of a trajectory, and convert it; `rate_hz` overrides its times.

    Raises:
        InputError: shapes, times, rotations, units or values are wrong; the message names the frame and the fix.
        UnmeasurableError: there are fewer than two frames, or fewer than two are tracked.
    """
    warnings = list(raw.warnings)
    name = "base_from_tcp" if raw.q is None else "q"
    array = raw.X_BG if raw.q is None else raw.q
    if array is None:
        raise InputError("holds neither poses nor joint angles")
    values = require_numbers(name, array)
    if values.shape[:1] == (0,):
        raise UnmeasurableError(f"holds no frame, a path needs at least {MIN_FRAMES}")
    if values.shape[1:] not in ([(4, 4)] if raw.q is None else [(raw.joints + k,) for k in range(3)]):
        expected = "(T, 4, 4)" if raw.q is None else f"(T, {raw.joints}) in radians"
        turned = ", transposed?" if raw.q is not None and values.shape[:1] == (raw.joints,) else ""
        raise InputError(f"{name} has shape {values.shape}, expected {expected}{turned}")
    n = len(values)
    if n > MAX_FRAMES:
        raise InputError(f"has {n} frames, at most {MAX_FRAMES} are accepted: cut it into parts")
    tracked = _tracked(raw.tracked, n)
    t_s = check_times(raw.t_s, n, rate_hz, warnings)
    width = None if raw.finger_width_m is None else require_numbers("finger_width_m", raw.finger_width_m)
    if raw.repeats is not None and raw.repeats.any():
        own = ~raw.repeats
        warnings.append(
            f"{count_noun(int(raw.repeats.sum()), 'row')} of {n} repeat a state that the recorder held: left out, and "
            "frames are counted without them"
        )
        values = values[own]
        tracked = tracked[own]
        t_s = t_s[own]
        width = width[own] if width is not None and len(width) == n else width
        n = len(t_s)
    if n < MIN_FRAMES:
        raise UnmeasurableError(f"has {n} frame, a path needs at least {MIN_FRAMES}")
    q = X_BG = None
    if raw.q is not None:
        q, fingers = _joints(values, raw.joints, tracked, warnings)
        path = q
        width = fingers if width is None else width
    else:
        X_BG, repairs = rigid_poses(values, tracked, repairable_deviation(values.reshape(n, -1)))
        path = X_BG[:, :3, 3]
        warnings += repairs
    if tracked.sum() < MIN_FRAMES:
        raise UnmeasurableError(f"{int(tracked.sum())} of {n} frames are tracked, a path needs {MIN_FRAMES}")
    t_s, dropped = fill_gaps(undo_jitter(t_s, path, warnings), X_BG, q)
    if dropped:
        first = ", ".join(map(str, dropped[:8])) + (", ..." if len(dropped) > 8 else "")
        warnings.append(
            f"{count_noun(len(dropped), 'sample')} missing before frames {first}: these steps last two periods"
        )
    return Trajectory(
        t_s=t_s,
        X_BG=X_BG,
        q=q,
        tracked=tracked,
        finger_width_m=_widths(width, n, warnings),
        dropped=dropped,
        columns=raw.columns,
        warnings=tuple(warnings),
    )


def repairable_deviation(numbers: Array) -> float:
    """Return the greatest deviation from a rotation that is repaired: more than REPAIRABLE if the rows were rounded."""
    return max(REPAIRABLE, ROUNDED_UNITS * float(rounding_unit(numbers[finite_rows(numbers)]).min()))


def _tracked(array: NDArray[np.generic] | None, n: int) -> NDArray[np.bool_]:
    if array is None:
        return np.ones(n, dtype=bool)
    if array.shape != (n,) or array.dtype.kind not in "biu":
        raise InputError(f"tracked has shape {array.shape} and type {array.dtype}, expected ({n},) of booleans")
    return array.astype(bool)


def _joints(values: Array, joints: int, tracked: NDArray[np.bool_], warnings: list[str]) -> tuple[Array, Array | None]:
    """Return the arm angles (T, joints) and the finger gap (T,) [m] if two finger joints follow them."""
    columns = values.shape[1]
    q = np.where(tracked[:, None], values[:, :joints], np.nan)
    if columns > joints:
        warnings.append(f"q has {columns} columns: the first {joints} are used as the arm's joints")
    # the two finger joints of the Panda, each half of the gap
    fingers = values[:, joints:].sum(axis=1) if columns == joints + 2 else None
    broken = tracked & ~np.isfinite(q).all(axis=1)
    if (k := first_index(broken)) is not None:
        value = "NaN" if np.isnan(q[k]).any() else "infinity"
        raise InputError(
            f"the joint angles of frame {k} hold {value}{others_text(broken)}, expected finite radians; "
            "unknown frames are marked in an array tracked"
        )
    if tracked.any():
        largest = np.nanmax(np.abs(q), axis=0)
        j = int(np.argmax(largest))
        if largest[j] > _MANY_RAD:
            k = int(np.nanargmax(np.abs(q[:, j])))
            message = f"joint {j + 1} is at {q[k, j]:.4g} rad in frame {k}, more than {_MANY_RAD:g}"
            degrees = "the angles look like degrees, convert them to radians (multiply by pi / 180)"
            guess = degrees if largest[j] <= 720.0 else "these are no joint angles in radians"
            raise InputError(f"{message}: {guess}")
        if largest[j] > 2.0 * np.pi:  # larger angles give a warning
            warnings.append(
                f"joint {j + 1} goes up to {largest[j]:.4g} rad, more than a full turn: are the angles in degrees? "
                "They are interpreted as radians"
            )
    q, wrapped = unwrap(q)
    warnings += [
        f"joint {j + 1} jumps by a full turn between frames, as an angle that a recorder wraps: the turns were undone"
        for j in np.flatnonzero(wrapped)
    ]
    return q, fingers


def _widths(width: Array | None, n: int, warnings: list[str]) -> Array:
    if width is None:
        return np.full(n, np.nan)
    if width.shape != (n,):
        raise InputError(f"finger_width_m has shape {width.shape}, but there are {n} frames")
    finite = width[np.isfinite(width)]
    if len(finite) and (finite.min() < -_WIDTH_SLACK_M or finite.max() > MAX_WIDTH_M + _WIDTH_SLACK_M):
        warnings.append(
            f"finger widths from {finite.min():.4g} to {finite.max():.4g} are not metres from 0 to {MAX_WIDTH_M}: they "
            "are ignored"
        )
        return np.full(n, np.nan)
    return np.clip(np.where(np.isfinite(width), width, np.nan), 0.0, MAX_WIDTH_M)


@np.errstate(over="ignore", invalid="ignore")  # values that overflow are refused below
def rigid_poses(X: Array, valid: NDArray[np.bool_], repairable: float = REPAIRABLE) -> tuple[Array, tuple[str, ...]]:
    """Return rigid poses (T, 4, 4) of matrices, NaN for frames that are not `valid` (T,), and messages about repairs.

    Raises:
        InputError: a frame holds no finite number, no homogeneous matrix, a left-handed or a distorted frame, or a
            position that cannot be in metres.
    """
    frames = np.flatnonzero(valid)
    matrices = X[valid]
    broken = ~np.isfinite(matrices).all(axis=(1, 2))
    if (k := first_index(broken)) is not None:
        value = "NaN" if np.isnan(matrices[k]).any() else "infinity"
        more = f" and {int(broken.sum()) - 1} more frames" if broken.sum() > 1 else ""
        raise InputError(f"the pose of frame {frames[k]}{more} holds {value}, expected finite numbers")
    off = np.abs(matrices[:, 3] - np.eye(4)[3]).max(axis=-1, initial=0.0)
    if (k := first_index(off > REPAIRABLE)) is not None:
        row = ", ".join(f"{v:.4g}" for v in matrices[k, 3])
        turned = np.abs(matrices[k, :, 3] - np.eye(4)[3]).max() <= REPAIRABLE
        fix = "the matrices are transposed, store them row by row" if turned else "expected 0, 0, 0, 1"
        raise InputError(f"the last row of the pose of frame {frames[k]} is {row}: {fix}")
    R = matrices[:, :3, :3]
    deviation = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2), initial=0.0)
    if (k := first_index(~(deviation <= repairable) | (np.linalg.det(R) < 0.0))) is not None:
        reason = f"not orthonormal: R^T R is off the identity by {deviation[k]:.2g}, at most {repairable:g} is repaired"
        if deviation[k] <= repairable:
            turned = f"(determinant {np.linalg.det(R[k]):.3f}): one of its axes is mirrored"
            reason = f"left-handed {turned}, expected a right-handed frame"
        raise InputError(f"the rotation of frame {frames[k]} is {reason}")
    largest = np.abs(matrices[:, :3, 3]).max(axis=-1, initial=0.0)
    if (largest > FAR_M).any():
        k = int(np.argmax(largest))
        raise InputError(
            f"positions go up to {largest[k]:.4g} m (frame {frames[k]}), no gripper is more than {FAR_M:g} m from its "
            "robot's base: they look like millimetres, convert them to metres"
        )
    repaired = int((deviation > ROUNDING).sum())
    message = f"{repaired} rotations, off by up to {deviation.max(initial=0.0):.1e}, were made orthonormal"
    poses = make_pose(orthonormalize(R), matrices[:, :3, 3])
    return spread(poses, valid, len(X)), ((message,) if repaired else ())
