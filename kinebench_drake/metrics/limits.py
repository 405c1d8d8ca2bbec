"""Velocity, acceleration, jerk and torque of a joint path against the robot's limits, with room for its noise.

A limit is called broken where |value| - z * standard error > limit. The values are those of `derivatives`: means over
a window, so never above the true peak (torque is computed from such means, and so to that approximation only). At
video rates they lie far below it for jerk (a track at 5 Hz resolves a fraction of a percent of the Panda's jerk
limits): jerk may convict, never acquit, and each check reports its bandwidth. The factor z makes FALSE_ALARM the
chance that noise alone condemns a track that stays at its limits everywhere: Bonferroni over all looks (frames x
joints x kinds, both signs), and Student's distribution because the noise is itself measured.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.derivatives import Derivative, differentiate, smooth_path
from kinebench_drake.metrics.noise import FREEDOM_A_FRAME
from kinebench_drake.segments import complete, segments
from kinebench_drake.types import Violation, ViolationKind

FALSE_ALARM = 0.01
"""Chance, at most, that white noise alone makes a track break a limit."""

_ORDERS = {ViolationKind.VELOCITY: 1, ViolationKind.ACCELERATION: 2, ViolationKind.JERK: 3}
_KINDS = (*_ORDERS, ViolationKind.TORQUE)


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCheck:
    """One kind of limit along a track. Units are the kind's: rad/s, rad/s^2, rad/s^3 or N m."""

    kind: ViolationKind
    ratio_max: float
    """Greatest |value| / limit of all joints, where the noise leaves it to be seen."""
    joint: str
    """The joint that has it ..."""
    frame: int
    """... the frame ..."""
    t_worst_s: float
    """... and its time [s]."""
    margins: Array
    """(7,) limit - greatest |value| of each joint; NaN where the noise hides it throughout."""
    ratios: Array
    """(7,) greatest |value| / limit of each joint; NaN likewise."""
    value: Array
    """(T, 7) point estimates; NaN where there is none."""
    window_s: float
    """Length of the windows that the derivatives are means over [s]."""
    bandwidth_hz: float
    """Up to here motion is seen (-3 dB)."""
    noise_ratio: float
    """Standard error / limit: median over frames, of the joint where that is greatest; NaN if unknown."""
    slowdown: Array
    """(T, 7) least k for which the track played k times slower keeps the limit, by the point estimate, but no more than
    1 where the noise explains what is above; NaN if unknown."""
    violations: tuple[Violation, ...]
    """Runs of frames in which a joint breaks the limit; value is the worst |value|."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Slowdown:
    """The least k for which the track played k times slower keeps every limit."""

    factor: float
    """k; above 1 exactly if a limit is broken, inf if gravity alone breaks one."""
    kind: ViolationKind
    """The limit that decides it ..."""
    joint: str
    """... the joint ..."""
    frame: int
    """... and the frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitChecks:
    """All limits along a track."""

    checks: Mapping[ViolationKind, LimitCheck]
    """What could be checked."""
    reasons: Mapping[ViolationKind, str]
    """Why the other kinds could not."""
    slowdown: Slowdown | None
    """None if the noise is unknown or no derivative could be taken."""
    z: float
    """Standard errors that a value is allowed above its limit."""

    @property
    def violations(self) -> tuple[Violation, ...]:
        """All limits broken."""
        return tuple(violation for check in self.checks.values() for violation in check.violations)


def check_limits(
    plant: ArmPlant, t_s: Array, q: Array, sigma: Array, freedom_a_frame: float = FREEDOM_A_FRAME
) -> LimitChecks:
    """Check a joint path against all limits that the robot has.

    Torques are those of inverse dynamics, with nothing in the hand, at the smoothed path and its derivatives; their
    noise is that of the accelerations through the mass matrix (what noise in posture and speed does to gravity and
    Coriolis forces is small beside it).

    Args:
        plant: the robot.
        t_s: (T,) times [s], increasing.
        q: (T, 7) joint angles [rad], NaN where unknown.
        sigma: (7,) or (T, 7) standard deviations of the noise of `q` [rad]; NaN if unknown, and then nothing convicts.
        freedom_a_frame: degrees of freedom of `sigma` for each known frame; JOINT_FREEDOM_A_FRAME for `joint_noise`.
    """
    known = complete(q)
    frames = int(known.sum())
    z = allowance(frames * q.shape[1] * len(_KINDS), freedom_a_frame * frames)
    limits = {
        ViolationKind.VELOCITY: plant.velocity_limits,
        ViolationKind.ACCELERATION: plant.acceleration_limits,
        ViolationKind.JERK: plant.jerk_limits,
    }
    checks: dict[ViolationKind, LimitCheck] = {}
    reasons: dict[ViolationKind, str] = {}
    derivatives: dict[ViolationKind, Derivative] = {}
    for kind, order in _ORDERS.items():
        limit = limits[kind]
        scale = plant.velocity_limits if limit is None else limit
        derivatives[kind] = derivative = differentiate(t_s, q, sigma, order, scale)
        if not np.isfinite(derivative.value).any():
            reasons[kind] = f"fewer than {order + 1} frames have joint angles"
        elif limit is None:
            reasons[kind] = f"no {kind.value} limits are published for {plant.robot.name}"
        else:
            error = derivative.standard_error
            k = [
                np.maximum((np.abs(derivative.value) - room) / limit, 0.0) ** (1.0 / order)
                for room in (z * error, np.zeros_like(error))
            ]
            checks[kind] = _check(plant, kind, t_s, derivative.value, error, limit, (k[0], k[1]), derivative, z)
    acceleration = derivatives[ViolationKind.ACCELERATION]
    if np.isfinite(acceleration.value).any():
        smooth = smooth_path(t_s, q, sigma)
        checks[ViolationKind.TORQUE] = _check_torque(
            plant, t_s, smooth, derivatives[ViolationKind.VELOCITY], acceleration, z
        )
    else:
        reasons[ViolationKind.TORQUE] = "fewer than 3 frames have joint angles"
    return LimitChecks(
        checks=MappingProxyType(checks),
        reasons=MappingProxyType(reasons),
        slowdown=_slowdown(plant, checks),
        z=z,
    )


def allowance(looks: int, freedom: float) -> float:
    """Quantile of Student's t with `freedom` degrees that `looks` two-sided looks exceed with FALSE_ALARM at most."""
    return float(-stdtrit(max(freedom, 1.0), FALSE_ALARM / (2.0 * max(looks, 1))))


def torque_slowdown(gravity: Array, rest: Array, error: Array, limits: Array) -> Array:
    """Least k (..., 7) for which |gravity + (rest -+ error) / k^2| stays within `limits`; inf if gravity does not.

    Played k times slower, accelerations and products of speeds shrink by k^2, and so does what their noise puts on
    them; the torque that carries the arm's weight stays. Solved for 1/k^2 on either side, the larger k counts.

    Args:
        gravity: (..., 7) torques that hold the arm still [N m].
        rest: (..., 7) what the motion adds at its own pace [N m].
        error: (..., 7) room left for its noise [N m].
        limits: (7,) [N m].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.maximum(rest - error, 0.0) / (limits - gravity)
        down = np.maximum(-rest - error, 0.0) / (limits + gravity)
    k = np.sqrt(np.maximum(np.maximum(up, down), 0.0))
    return np.asarray(np.where(np.abs(gravity) > limits, np.inf, k))


def _check_torque(
    plant: ArmPlant, t_s: Array, q: Array, velocity: Derivative, acceleration: Derivative, z: float
) -> LimitCheck:
    torque, gravity, error = np.full((3, *q.shape), np.nan)
    at_rest = np.zeros(q.shape[1])
    for i in np.flatnonzero(complete(acceleration.value)):
        torque[i] = plant.torque(q[i], velocity.value[i], acceleration.value[i])
        gravity[i] = plant.torque(q[i], at_rest, at_rest)
        error[i] = np.sqrt(plant.mass_matrix(q[i]) ** 2 @ acceleration.standard_error[i] ** 2)
    moving = torque - gravity
    k = (
        torque_slowdown(gravity, moving, z * error, plant.effort_limits),
        torque_slowdown(gravity, moving, np.zeros_like(error), plant.effort_limits),
    )
    return _check(plant, ViolationKind.TORQUE, t_s, torque, error, plant.effort_limits, k, acceleration, z)


def _check(
    plant: ArmPlant,
    kind: ViolationKind,
    t_s: Array,
    value: Array,
    error: Array,
    limits: Array,
    k: tuple[Array, Array],
    derivative: Derivative,
    z: float,
) -> LimitCheck:
    """One check; `k` are the slow-downs (T, 7) that the limit asks for at least, after the noise, and by the value."""
    magnitude, (least, own) = np.abs(value), k
    broken = np.asarray(least > 1.0)
    seen = np.isfinite(value) & (~(z * error > limits) | broken)  # the rest may be all noise: it tells nothing
    ratio = np.where(seen, magnitude / limits, -1.0)
    frame, joint = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    ratios = np.where(seen.any(axis=0), ratio.max(axis=0), np.nan)
    return LimitCheck(
        kind=kind,
        ratio_max=float(ratio[frame, joint]) if seen.any() else np.nan,
        joint=plant.robot.joints[joint],
        frame=int(frame),
        t_worst_s=float(t_s[frame]),
        margins=limits * (1.0 - ratios),
        ratios=ratios,
        value=value,
        window_s=derivative.window_s,
        bandwidth_hz=derivative.bandwidth_hz,
        noise_ratio=float((np.median(error[complete(value)], axis=0) / limits).max()),
        slowdown=np.where(seen, np.maximum(least, np.minimum(own, 1.0)), np.where(least > 0.0, least, np.nan)),
        violations=tuple(_violations(plant, kind, magnitude, limits, broken)),
    )


def _violations(
    plant: ArmPlant, kind: ViolationKind, magnitude: Array, limits: Array, broken: NDArray[np.bool_]
) -> Iterator[Violation]:
    for j, name in enumerate(plant.robot.joints):
        for run in segments(broken[:, j]):
            yield Violation(
                kind=kind,
                frame_start=run.start,
                frame_end=run.stop - 1,
                joint=name,
                value=float(magnitude[run, j].max()),
                limit=float(limits[j]),
            )


def _slowdown(plant: ArmPlant, checks: Mapping[ViolationKind, LimitCheck]) -> Slowdown | None:
    found = [
        Slowdown(
            factor=float(check.slowdown[frame, joint]), kind=kind, joint=plant.robot.joints[joint], frame=int(frame)
        )
        for kind, check in checks.items()
        if np.isfinite(check.slowdown).any() or np.isinf(check.slowdown).any()
        for frame, joint in [np.unravel_index(int(np.nanargmax(check.slowdown)), check.slowdown.shape)]
    ]
    return max(found, key=lambda slowdown: slowdown.factor, default=None)
