"""A dense score of a motion, 0 to 1, from the fault ratios of every check in every frame.

A fault ratio r is a measured value over its bound: 0 without a fault, 1 at the bound, without an upper end. A frame is
worth g = prod_k (1 + r_k^4)^(-w_k / 4) with the weights w_k of the terms, 0 if it or a neighbour is lost. All frames
are worth (1 - D)^2, where D^6 is the mean of (1 - g)^6, so that the size of the worst fault counts more than the number
of its frames; each term of the whole clip is a factor (1 + r^4)^(-w). Far beyond the bound g falls as 1 / r, so that
large faults differ, too. A lost frame is worth as little as the worst fault.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import prod
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.path import limit_margin
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.coverage import MISS_M
from kinebench_drake.metrics.discontinuity import find_discontinuities
from kinebench_drake.metrics.kinematic_result import KinematicResult, PathMeasurements
from kinebench_drake.metrics.noise import TrackNoise, estimate_track_noise
from kinebench_drake.metrics.reach import contact_tolerance, pose_error, pose_tolerance
from kinebench_drake.violation import Violation, ViolationKind

TERMS = (
    *("reach", "joint_limit", "self_distance", "table_distance", "obstacle"),
    *("velocity", "acceleration", "jerk", "torque", "jump", "jitter"),
    *(kind.value for kind in AnomalyKind),
    *("start", "idle", "evidence", "motion"),
)
"""Terms of a score; a clip has those that can be measured of it."""
FAULT = "fault_"
"""Start of the names of the curves that hold fault ratios."""
MIN_TRACKED_FRAMES = 5
"""Fewest tracked frames of a feasible track, and of a score."""
MIN_TRACKED_FRACTION = 0.5
"""Least share of tracked frames of both."""
MOST_NOISE = TrackNoise(position_m=0.015, rotation_rad=float(np.deg2rad(7.5)))
"""Greatest noise that is allowed for: a track that jitters more is taken for motion and judged as exact."""
MOTION_M = 0.1
"""Path length of a motion that halves the score where no path is expected [m]: less than a third of those of the
suites' experts."""
_DETOUR = 0.1
"""Weight of a path beyond the expected one: twice its length costs 9 %."""
LEAST_M = 1e-6
"""Path length that stands for none [m]."""
_LIMIT_RAD = 0.05
"""Distance of a joint from its limit at which the ratio is 1/e [rad]; three standard deviations of its noise if these
are more."""
_LEAST_JUMP = 0.05
"""Least fault ratio of a jump that counts."""
_IDLE = 0.5
"""Fault ratio of a frame that repeats the picture before it: such frames cost 2 to 3 %, more than a clip may gain by
them, as they are as easy to track as those before."""
_START_PX = 48
"""Width and height of the pictures in which a first frame is compared with its conditioning image [px]."""
_START_LEVELS = 40.0
"""Difference of a first frame from another image [grey levels of 255], in the hundredth of the picture that differs
most: 12 at most for the same image after JPEG of quality 20, a third of its size or 6 % more light, 86 at least for the
start of another task (example videos)."""
_POWER = 4.0
"""Exponent of the ratios: in all frames one of a half costs 3 %, of 1 it leaves 71 %, of 2 it leaves 24 %."""
_NORM = 6.0
"""Order of the mean over the frames. With 2 a fault of half the size in three times as many frames would cost more."""
_OF_THE_CLIP = ("jitter", "start", "motion")
"""Terms with one ratio for all frames."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFaults:
    """Fault ratios of a clip, from which the score is computed with any weights."""

    ratios: Mapping[str, Array]
    """(T,) fault ratios by term; NaN where there is nothing to measure."""
    lost: NDArray[np.bool_]
    """(T,) frames without a pose."""
    path_m: float
    """Length of the path of the TCP [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Executability:
    """Score of a clip."""

    score: float
    """Score, 0 to 1."""
    terms: Mapping[str, float] = field(default_factory=dict)
    """Score by each term alone over the measured frames, and `coverage`: that by the lost frames alone."""


def rate_faults(
    faults: MotionFaults, weights: Mapping[str, float] = MappingProxyType({}), motion_m: float | None = None
) -> Executability:
    """Return the score of fault ratios.

    The term `motion` multiplies the score by L / (L + MOTION_M) for a path of length L, or, with x = L / `motion_m`,
    by x up to 1 and by 1 / (0.9 + x / 10) beyond.

    Args:
        faults: fault ratios of the clip.
        weights: exponents of the terms, 0 leaves one out; 1 for those not named.
        motion_m: length of the path that is expected of the clip [m], such as that of a reference; None: unknown.

    Raises:
        UsageError: a weight is negative or of no term, or the expected length is not positive.
    """
    odds = MOTION_M / max(faults.path_m, LEAST_M)
    if motion_m is not None:
        if not 0.0 < motion_m < np.inf:
            raise UsageError(f"motion_m is {motion_m}, expected a length in metres above 0")
        share = max(faults.path_m, LEAST_M) / motion_m
        odds = max(1.0 / share - 1.0, _DETOUR * (share - 1.0))
    ratios = {**faults.ratios, "motion": np.full(len(faults.lost), odds ** (1.0 / _POWER))}
    for name, weight in weights.items():
        if name not in TERMS or not 0.0 <= weight < np.inf:
            raise UsageError(f"weight {name}={weight}: expected a number from 0 on, and one of {', '.join(TERMS)}")
    worth = {name: (1.0 + np.nan_to_num(ratio) ** _POWER) ** -0.25 for name, ratio in ratios.items()}
    near = np.convolve(faults.lost, np.ones(3), mode="same")[: len(faults.lost)] > 0.0

    def rate(worth: Array) -> float:
        return float((1.0 - np.mean((1.0 - worth) ** _NORM) ** (1.0 / _NORM)) ** 2)

    whole = {name: float(worth.pop(name)[0]) ** _POWER for name in _OF_THE_CLIP if name in worth}
    frames = np.prod([value ** weights.get(name, 1.0) for name, value in worth.items()], axis=0)
    return Executability(
        score=prod(value ** weights.get(name, 1.0) for name, value in whole.items())
        * rate(np.where(near, 0.0, frames)),
        terms={
            "coverage": rate(np.where(near, 0.0, 1.0)),
            **{name: rate(value[~faults.lost]) for name, value in worth.items()},
            **whole,
        },
    )


def gather_faults(kinematics: KinematicResult, curves: Mapping[str, Array]) -> MotionFaults | None:
    """Return the fault ratios of a clip; None where too few frames have a pose.

    Args:
        kinematics: verdict on its track, whose curves have the ratios of the motion.
        curves: curves of the grounding, which have those of the anomalies.
    """
    track = kinematics.track
    if track.tracked.sum() < max(MIN_TRACKED_FRAMES, MIN_TRACKED_FRACTION * len(track.t_s)):
        return None
    confidence = np.clip(track.confidence, 1e-6, 1.0)
    ratios = {
        name.removeprefix(FAULT): ratio
        for name, ratio in {**curves, **kinematics.curves}.items()
        if name.startswith(FAULT)
    }
    ratios["evidence"] = (1.0 / confidence - 1.0) ** (1.0 / _POWER)
    if "repeated" in curves:
        ratios["idle"] = _IDLE * curves["repeated"]
    return MotionFaults(
        ratios=ratios, lost=~track.tracked, path_m=float(kinematics.metrics.get("path_length_m") or 0.0)
    )


def start_ratio(frame: NDArray[np.uint8], image: NDArray[np.uint8]) -> float:
    """Return the fault ratio of a first frame (H, W, 3) that should show the conditioning image (h, w, 3)."""
    small = [cv2.resize(each, (_START_PX, _START_PX), interpolation=cv2.INTER_AREA) for each in (frame, image)]
    change = np.abs(np.subtract(*small, dtype=np.float64)).max(axis=-1)
    return float(np.percentile(change, 99.0)) / _START_LEVELS


def motion_ratios(plant: ArmPlant, measured: PathMeasurements, violations: Iterable[Violation]) -> dict[str, Array]:
    """Return the curves (T,) with the fault ratios of a motion; NaN where not measured."""
    path = measured.path
    track = path.track
    noise = path.noise
    estimate = estimate_track_noise(track.t_s, track.X_BG, track.tracked)
    jitter = np.hypot(estimate.position_m / MOST_NOISE.position_m, estimate.rotation_rad / MOST_NOISE.rotation_rad)
    contact_m = contact_tolerance(noise)
    margin_rad = 0.5 * (plant.upper - plant.lower) * limit_margin(plant, path.joints.q)
    joints = _approach(margin_rad, np.fmax(_LIMIT_RAD, 3.0 * path.sigma))
    reach = pose_error(path.joints) / max(pose_tolerance(noise), MISS_M)
    rates = {
        kind.value: np.fmax.reduce(np.abs(c.value) / c.limits, axis=-1) for kind, c in measured.checks.checks.items()
    }
    ratios = {
        "reach": reach,
        "joint_limit": np.fmax.reduce(joints, axis=-1),
        "self_distance": _approach(path.own.distance_m + contact_m, contact_m),
        "table_distance": _approach(path.table.distance_m + contact_m, contact_m),
        **{name: np.where(np.isnan(ratio), reach, ratio) for name, ratio in rates.items()},  # out of reach: unknown
        "jump": _jumps(measured),
        "obstacle": np.zeros(len(track.t_s)),
        "jitter": np.full(len(track.t_s), jitter),
    }
    for violation in violations:
        if violation.kind is ViolationKind.OBSTACLE_COLLISION:
            frames = slice(violation.frame_start, violation.frame_end + 1)
            ratios["obstacle"][frames] = np.maximum(ratios["obstacle"][frames], violation.value / violation.limit)
    return {FAULT + name: ratio for name, ratio in ratios.items()}


def _approach(margin: Array, scale: Array | float) -> Array:
    """Return the ratios of distances from a bound, negative beyond it: exp(-m) for m >= 0, 1 - m below, m in scales."""
    m = margin / scale
    return np.asarray(np.where(m > 0.0, np.exp(-np.maximum(m, 0.0)), 1.0 - m))


def _jumps(measured: PathMeasurements) -> Array:
    """Return deviations (T,) of steps from the motion around them, over the thresholds of a discontinuity."""
    track = measured.path.track
    ratio = np.zeros(len(track.t_s))
    for jump in find_discontinuities(track.t_s, track.X_BG, track.tracked, measured.path.noise, tolerance=_LEAST_JUMP):
        frames = slice(jump.frame_start, jump.frame_end + 1)
        ratio[frames] = np.maximum(ratio[frames], _LEAST_JUMP * jump.value / jump.limit)
    return ratio
