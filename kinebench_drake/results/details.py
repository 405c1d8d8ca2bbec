"""Data behind a verdict, in the field `details` of a row (written by `metrics.kinematic_result.path_details`)."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kinebench_drake.results.record import read_record
from kinebench_drake.results.row import SampleRow


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionRange:
    """Limits of the joint angles."""

    lower: tuple[float, ...]
    """(7,) least angles [rad]."""
    upper: tuple[float, ...]
    """(7,) greatest angles [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmLimits:
    """Limits that a track was judged by; None of a kind that the robot does not state."""

    joints: tuple[str, ...] = ()
    """(7,) joint names."""
    position: PositionRange | None = None
    velocity: tuple[float, ...] | None = None
    """(7,) greatest magnitudes [rad/s]; NaN where there is no limit, as in the following."""
    acceleration: tuple[float, ...] | None = None
    """(7,) [rad/s^2]."""
    jerk: tuple[float, ...] | None = None
    """(7,) [rad/s^3]."""
    torque: tuple[float, ...] | None = None
    """(7,) [N m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseEstimate:
    """Noise of a track."""

    position_m: float | None = None
    """Standard deviation of a position [m]."""
    rotation_rad: float | None = None
    """Standard deviation of an orientation [rad]."""
    assumed: bool = False
    """True if the track is too short for an estimate."""
    offset_m: float | None = None
    """Error that all positions share [m]."""
    offset_rad: float | None = None
    """Error that all orientations share [rad]."""
    turn_is_sure: bool = True
    """False if the turn about the gripper's own axis is not measured as well as the rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RateCheck:
    """Check of one kind of limit along a track (`metrics.limit_checks.LimitCheck`)."""

    ratio_max: float
    """Greatest |value| / limit; NaN where noise hides all."""
    joint: str | None = None
    """Joint of that ratio."""
    frame: int | None = None
    """Frame of that ratio."""
    t_worst_s: float | None = None
    """Time of that frame [s]."""
    ratios: tuple[float, ...] = ()
    """(7,) greatest ratio of each joint; NaN where noise hides all."""
    window_s: float | None = None
    """Length of the windows of the derivatives [s]."""
    bandwidth_hz: float | None = None
    """Bandwidth of the derivatives [Hz]."""
    noise_ratio: float | None = None
    """Median standard error / limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitPlace:
    """Limit that determines a number, and where."""

    limit: str | None = None
    """Kind of the limit; None if there is none."""
    joint: str | None = None
    frame: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Prevention:
    """Violation that keeps a trajectory near the track from being feasible."""

    kind: str
    value: float
    limit: float
    joint: str | None = None
    frame: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectorySearch:
    """Search for a feasible trajectory near the track."""

    tube_limit_m: float | None = None
    """Largest tube radius of a feasible track [m]."""
    against: Prevention | None = None
    """None of a feasible track."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Details:
    """Data behind a verdict, as far as a row has them."""

    limits: ArmLimits = ArmLimits()
    noise: NoiseEstimate = NoiseEstimate()
    checks: Mapping[str, RateCheck] = field(default_factory=dict)
    """Checks of velocity, acceleration, jerk and torque."""
    slowdown: LimitPlace | None = None
    """Limit that determines the slow-down needed."""
    time_scale: LimitPlace | None = None
    """Limit that determines the fastest execution."""
    trajopt: TrajectorySearch = TrajectorySearch()


def read_details(row: SampleRow) -> Details:
    """Read the data behind the verdict of a row.

    Raises:
        InputError: they are damaged.
    """
    return read_record(Details, dict(row.details.items()))
