"""Check of velocity, acceleration, jerk and torque of a noisy joint path against the limits of the robot.

A limit counts as broken where |value| - z * standard error > limit. The values are those of `derivatives`: means over a
window, never above the true peak (torque: approximately). At video rates they lie far below it for jerk: the check can
show a violation, not its absence, and reports its bandwidth. The factor z makes FALSE_ALARM the probability that noise
alone gives a violation for a track at its limits throughout: Bonferroni correction over all tests (frames x joints x
kinds, both signs), with Student's distribution because the noise is estimated.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from scipy.special import stdtrit

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.derivatives import Derivative, differentiate, smooth_path
from kinebench_drake.metrics.noise import FREEDOM_PER_FRAME
from kinebench_drake.segments import finite_rows, segments
from kinebench_drake.violation import RATES, Violation, ViolationKind

FALSE_ALARM = 0.01
"""Greatest probability that white noise alone makes a track break a limit."""

KINDS = (*RATES, ViolationKind.TORQUE)
"""Kinds of limits that are checked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCheck:
    """Check of one kind of limit along a track, in the unit of the kind: rad/s, rad/s^2, rad/s^3 or N m."""

    ratio_max: float
    """Greatest |value| / limit of all joints, over the values that the noise does not hide; NaN where it hides all."""
    joint: str | None
    """Joint of the greatest ratio; None where there is none."""
    frame: int | None
    """Frame of the greatest ratio; None likewise."""
    t_worst_s: float | None
    """Time of that frame [s]; None likewise."""
    margins: Array
    """(7,) limit - |value| of each joint where their ratio is greatest; NaN where the noise hides all values."""
    ratios: Array
    """(7,) greatest |value| / limit of each joint; NaN where the noise hides all values."""
    value: Array
    """(T, 7) point estimates; NaN where there is none."""
    limits: Array
    """(T, 7) limits of the point estimates."""
    window_s: float
    """Length of the windows of the derivatives [s]."""
    bandwidth_hz: float
    """Bandwidth of the derivatives (-3 dB) [Hz]."""
    noise_ratio: float
    """Median standard error / limit over the frames, of the joint where it is greatest; NaN if unknown."""
    slowdown: Array
    """(T, 7) least k for which the track played k times slower keeps the limit, by the point estimate, but at most 1
    where the noise explains the excess; NaN if unknown."""
    violations: tuple[Violation, ...]
    """Runs of frames in which a joint breaks the limit; `value` and `limit` where their ratio is greatest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Slowdown:
    """Least k for which the track played k times slower keeps every limit."""

    factor: float
    """k; above 1 if and only if a limit is broken, inf if gravity alone breaks one."""
    kind: ViolationKind
    """Limit that determines k."""
    joint: str
    """Joint of that limit."""
    frame: int
    """Frame of that limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitChecks:
    """Checks of all limits along a track."""

    checks: Mapping[ViolationKind, LimitCheck]
    """Checks by kind."""
    reasons: Mapping[ViolationKind, str]
    """Why the other kinds were not checked."""
    slowdown: Slowdown | None
    """Slow-down; None if the noise is unknown or no derivative could be computed."""
    q_smooth: Array
    """(T, 7) joint path smoothed as far as its noise explains [rad]."""
    z: float
    """Standard errors by which a value may exceed its limit."""

    @property
    def violations(self) -> tuple[Violation, ...]:
        """Violations of all kinds."""
        return tuple(violation for check in self.checks.values() for violation in check.violations)


def check_limits(
    plant: ArmPlant, t_s: Array, q: Array, sigma: Array, freedom_per_frame: float = FREEDOM_PER_FRAME
) -> LimitChecks:
    """Check a joint path against all limits of the robot.

    Torques are those of inverse dynamics with the robot's payload, at the smoothed path and its derivatives; their
    noise is that of the accelerations through the mass matrix.

    Args:
        t_s: (T,) times [s], increasing.
        q: (T, 7) joint angles [rad], NaN where unknown.
        sigma: (7,) or (T, 7) standard deviations of the noise of `q` [rad]; NaN if unknown: then no limit is broken.
        freedom_per_frame: degrees of freedom of `sigma` per frame; JOINT_FREEDOM_PER_FRAME for `estimate_joint_noise`.
    """
    frames = int(finite_rows(q).sum())
    q_smooth = smooth_path(t_s, q, sigma)
    z = noise_allowance(frames * q.shape[1] * len(KINDS), freedom_per_frame * frames)
    checks: dict[ViolationKind, LimitCheck] = {}
    reasons: dict[ViolationKind, str] = {}
    derivatives: dict[ViolationKind, Derivative] = {}
    for order, (kind, limit) in enumerate(zip(RATES, plant.rate_limits, strict=True), 1):
        scale = plant.planned_speeds if limit is None else np.where(np.isfinite(limit), limit, plant.planned_speeds)
        derivatives[kind] = derivative = differentiate(t_s, q, sigma, order, scale)
        if not np.isfinite(derivative.value).any():
            reasons[kind] = f"fewer than {order + 1} frames have joint angles"
        elif limit is None or not np.isfinite(limit).any():
            reasons[kind] = f"{plant.robot.name} states no {kind.value} limits: not checked"
        else:
            limits = _speed_limits(plant, q, sigma, derivative, z) if kind is ViolationKind.VELOCITY else limit
            slowdown = partial(rate_slowdown, derivative.value, limits, order)
            checks[kind] = _check(plant, kind, t_s, derivative, limits, slowdown, z)
    acceleration = derivatives[ViolationKind.ACCELERATION]
    if np.isfinite(acceleration.value).any():
        velocity = derivatives[ViolationKind.VELOCITY]
        checks[ViolationKind.TORQUE] = _check_torque(plant, t_s, q_smooth, velocity, acceleration, z)
    else:
        reasons[ViolationKind.TORQUE] = "fewer than 3 frames have joint angles"
    return LimitChecks(
        checks=MappingProxyType(checks),
        reasons=MappingProxyType(reasons),
        slowdown=_slowdown(plant, checks),
        q_smooth=q_smooth,
        z=z,
    )


def noise_allowance(tests: int, freedom: float) -> float:
    """Return the quantile of Student's t that `tests` two-sided tests exceed with probability FALSE_ALARM at most."""
    return float(-stdtrit(max(freedom, 1.0), FALSE_ALARM / (2.0 * max(tests, 1))))


def _speed_limits(plant: ArmPlant, q: Array, sigma: Array, velocity: Derivative, z: float) -> Array:
    """Return the speed limits (T, 7) [rad/s] of each frame: the greatest in its window, at angles that noise explains.

    A mean speed above them exceeds the limit of some position in the window, as it does for constant limits.
    """
    limits = plant.robot.limits
    if limits.deceleration is None:
        return np.broadcast_to(limits.velocity, q.shape)
    frames = np.flatnonzero(finite_rows(velocity.value))
    near = z * np.nan_to_num(np.broadcast_to(sigma, q.shape)[frames])
    towards = np.ones((len(frames), q.shape[1]))
    up, down = (limits.speeds(q[frames] - sign * near, sign * towards) for sign in (1.0, -1.0))
    size = min(velocity.window, len(frames))
    first = np.clip(np.arange(len(frames)) - size // 2, 0, len(frames) - size)
    most = [np.lib.stride_tricks.sliding_window_view(each, size, axis=0).max(axis=-1)[first] for each in (up, down)]
    speeds = np.array(np.broadcast_to(limits.velocity, q.shape))
    speeds[frames] = np.where(velocity.value[frames] >= 0.0, *most)
    return speeds


def rate_slowdown(value: Array, limits: Array, order: int, error: Array) -> Array:
    """Return the least k (..., 7) with (|value| - error) / k^order within `limits` (..., 7): played k times slower."""
    return np.asarray(np.maximum((np.abs(value) - error) / limits, 0.0) ** (1.0 / order))


def torque_slowdown(gravity: Array, moving: Array, limits: Array, error: Array) -> Array:
    """Return the least k (..., 7) with |gravity + (moving -+ error) / k^2| within `limits`; inf if gravity is not.

    Played k times slower, the torque (..., 7) added by the motion, `moving`, and the allowance for its noise, `error`,
    shrink by k^2; that against `gravity` stays [N m]. Solved for 1/k^2 at either limit (7,); the larger k counts.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.maximum(moving - error, 0.0) / (limits - gravity)
        down = np.maximum(-moving - error, 0.0) / (limits + gravity)
    k = np.sqrt(np.maximum(np.maximum(up, down), 0.0))
    return np.asarray(np.where(np.abs(gravity) > limits, np.inf, k))


def _check_torque(
    plant: ArmPlant, t_s: Array, q: Array, velocity: Derivative, acceleration: Derivative, z: float
) -> LimitCheck:
    torque, gravity, error = np.full((3, *q.shape), np.nan)
    usable = finite_rows(acceleration.value)
    at_rest = np.zeros_like(q[usable])
    torque[usable] = plant.chain.torques(q[usable], velocity.value[usable], acceleration.value[usable])
    gravity[usable] = plant.chain.torques(q[usable], at_rest, at_rest)
    for i in np.flatnonzero(usable):
        error[i] = np.sqrt(plant.mass_matrix(q[i]) ** 2 @ acceleration.standard_error[i] ** 2)
    estimate = replace(acceleration, value=torque, standard_error=error)
    slowdown = partial(torque_slowdown, gravity, torque - gravity, plant.effort_limits)
    return _check(plant, ViolationKind.TORQUE, t_s, estimate, plant.effort_limits, slowdown, z)


def _check(
    plant: ArmPlant,
    kind: ViolationKind,
    t_s: Array,
    estimate: Derivative,
    limits: Array,
    slowdown: Callable[[Array], Array],
    z: float,
) -> LimitCheck:
    """Return the check against `limits` (..., 7).

    `slowdown` returns the slow-downs (T, 7) that values need less an allowance (T, 7).
    """
    value = estimate.value
    error = estimate.standard_error
    limits = np.broadcast_to(limits, value.shape)
    least = slowdown(z * error)
    own = slowdown(np.zeros_like(error))
    magnitude = np.abs(value)
    broken = np.asarray(least > 1.0)
    significant = np.isfinite(value) & (~(z * error > limits) | broken)  # other values may be noise alone
    ratio = np.where(significant, magnitude / limits, -1.0)
    frame, joint = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    ratios = np.where(significant.any(axis=0), ratio.max(axis=0), np.nan)
    some = bool(significant.any())
    return LimitCheck(
        ratio_max=float(ratio[frame, joint]) if some else np.nan,
        joint=plant.robot.joints[joint] if some else None,
        frame=int(frame) if some else None,
        t_worst_s=float(t_s[frame]) if some else None,
        margins=limits[np.argmax(ratio, axis=0), np.arange(limits.shape[1])] * (1.0 - ratios),
        ratios=ratios,
        value=value,
        limits=limits,
        window_s=estimate.window_s,
        bandwidth_hz=estimate.bandwidth_hz,
        noise_ratio=float((np.median(error[finite_rows(value)] / limits[finite_rows(value)], axis=0)).max()),
        slowdown=np.where(significant, np.maximum(least, np.minimum(own, 1.0)), np.where(least > 0.0, least, np.nan)),
        violations=tuple(
            Violation.of_run(kind, run, name, float(magnitude[worst, j]), float(limits[worst, j]))
            for j, name in enumerate(plant.robot.joints)
            for run in segments(broken[:, j])
            for worst in [run.start + int(np.argmax(ratio[run, j]))]
        ),
    )


def _slowdown(plant: ArmPlant, checks: Mapping[ViolationKind, LimitCheck]) -> Slowdown | None:
    candidates = [
        Slowdown(
            factor=float(check.slowdown[frame, joint]), kind=kind, joint=plant.robot.joints[joint], frame=int(frame)
        )
        for kind, check in checks.items()
        if not np.isnan(check.slowdown).all()
        for frame, joint in [np.unravel_index(int(np.nanargmax(check.slowdown)), check.slowdown.shape)]
    ]
    return max(candidates, key=lambda slowdown: slowdown.factor, default=None)
