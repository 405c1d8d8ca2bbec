"""Smoothness of a motion by its speed profile: spectral arc length (SPARC) and log dimensionless jerk (LDLJ).

Both are negative, independent of the size of the motion, and nearer to 0 for a smoother motion; both follow the
reference implementation of their authors (github.com/siva82kb/smoothness). A gripper at rest has no smoothness. Noise
makes any motion rougher, more so at higher frame rates: the filtered SPARC uses only the low frequencies of a motion,
equal at any frame rate, and each metric has a noise floor, its value for the smoothed motion plus the measured noise.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.interpolate import CubicSpline
from scipy.ndimage import convolve1d

from kinebench_drake.geometry import Array, rotation_angle
from kinebench_drake.metrics.derivatives import smooth_path
from kinebench_drake.metrics.noise import TrackNoise, estimate_track_noise, rotation_steps
from kinebench_drake.segments import segments
from kinebench_drake.track import GripperTrack

CUTOFF_HZ = 10.0
"""Highest frequency of the spectral arc."""
THRESHOLD = 0.05
"""Fraction of the spectrum's maximum that the last bin of the arc reaches."""
DRAWS = 64
"""Noisy copies of the smoothed motion that determine a noise floor."""

MAX_LOST_SHARE = 0.05
"""Largest share of lost frames at which a motion as a whole has a smoothness."""
MIN_FRAMES = 8
"""Least number of consecutive tracked frames."""
STILL_M = 0.005
"""Distance from its first position within which a gripper counts as at rest [m]."""
STILL_RAD = 0.05
"""Angle from its first orientation within which a gripper counts as at rest [rad]."""

FILTERED_CUTOFF_HZ = 2.0
"""End of the arc of the filtered SPARC, without amplitude threshold [Hz]; the frame rate must be at least twice it."""


_GRID_HZ = 10.0  # least sampling rate of the filtered speed


def sparc(speed: Array, sampling_hz: float, cutoff_hz: float = CUTOFF_HZ, threshold: float = THRESHOLD) -> Array:
    """Compute the spectral arc length (M,) of speed profiles (M, N), none all zero; NaN for one without an arc.

    SPARC = - integral over 0..f_c of sqrt((1 / f_c)^2 + (dV/df)^2) df with V the magnitude of the speed's spectrum over
    its maximum and f_c the last frequency, at most `cutoff_hz`, at which V reaches `threshold`. Source: S.
    Balasubramanian, A. Melendez-Calderon, A. Roby-Brami, E. Burdet, "On the analysis of movement smoothness", J.
    NeuroEngineering Rehabil. 12:112, 2015, eq. (8), and the reference implementation. Unlike there, frequencies above
    sampling_hz / 2 are left out: they mirror those below, which would double the arc of a smooth motion at 10 Hz.
    """
    bins = _bins(speed.shape[-1])
    frequency = np.arange(bins // 2 + 1) * (sampling_hz / bins)
    kept = int(np.count_nonzero(frequency <= min(cutoff_hz, sampling_hz / 2.0)))
    spectrum = rfft(speed, bins)
    if speed.min() >= 0.0:  # then no bin exceeds the first
        spectrum = spectrum[:, :kept]
    magnitude = np.sqrt(spectrum.real**2 + spectrum.imag**2)
    magnitude /= magnitude.max(axis=-1, keepdims=True)
    frequency = frequency[:kept]
    magnitude = magnitude[:, :kept]
    above = magnitude >= threshold
    first = np.argmax(above, axis=-1)
    last = kept - 1 - np.argmax(above[:, ::-1], axis=-1)
    index = np.arange(kept - 1)
    inside = (index >= first[:, None]) & (index < last[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        df = (frequency[1] - frequency[0]) / (frequency[last] - frequency[first])
        arc = np.sqrt(np.diff(magnitude, axis=-1) ** 2 + df[:, None] ** 2)
        length = np.einsum("mf,mf->m", arc, inside)
    return np.where(above.any(axis=-1) & (last > first), -length, np.nan)


def _bins(n: int) -> int:
    return int(2 ** (np.ceil(np.log2(n)) + 4))  # zero padding by 2^4


def ldlj(speed: Array, sampling_hz: float) -> Array:
    """Compute the log dimensionless jerk (M,) of speed profiles (M, N), none all zero; infinite for one without jerk.

    LDLJ = -ln((D^3 / v_peak^2) integral (d2v/dt2)^2 dt), D = N / sampling_hz the duration and v the speed, its second
    derivative taken by differences; comparable only between tracks of equal frame rate. Sources: S. Balasubramanian, A.
    Melendez-Calderon, E. Burdet, "A robust and sensitive metric for quantifying movement smoothness", IEEE Trans.
    Biomed. Eng. 59(8), 2012, and the 2015 paper that `sparc` cites.
    """
    duration = speed.shape[-1] / sampling_hz
    jerk = np.diff(speed, 2, axis=-1) * sampling_hz**2
    with np.errstate(divide="ignore"):
        value = duration**3 / np.abs(speed).max(axis=-1) ** 2 * np.sum(jerk**2, axis=-1) / sampling_hz
        return np.asarray(-np.log(value))


def filtered_sparc(t_s: Array, p: Array) -> Array:
    """Compute SPARC (M,) of paths (N, M, 3) at `t_s` (N,) [s] through a fixed filter, comparable between frame rates.

    The path is interpolated by a natural cubic spline; its velocity, zero before and after, is smoothed by the Gaussian
    filter with gain 1/sqrt(2) at 1 Hz; the arc of the resulting speed extends to FILTERED_CUTOFF_HZ, without
    amplitude threshold. It needs 2 FILTERED_CUTOFF_HZ frames per second and paths with motion.
    """
    rate = _rate(t_s)
    fine_hz = rate * max(1.0, np.ceil(_GRID_HZ / rate - 1e-9))
    width = fine_hz * np.sqrt(np.log(2.0)) / (2.0 * np.pi)  # -3 dB at 1 Hz
    reach = int(np.ceil(4.0 * width))
    times = t_s[0] + (np.arange(round(float(t_s[-1] - t_s[0]) * fine_hz)) + 0.5) / fine_hz
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    velocity = CubicSpline(t_s, p.reshape(len(t_s), -1), bc_type="natural")(times, 1)
    every = max(1, int(fine_hz / _GRID_HZ))  # the filtered velocity needs no finer grid
    padded = np.pad(velocity, ((reach, reach), (0, 0)))
    smooth = convolve1d(padded, kernel / kernel.sum(), axis=0, mode="constant")[::every]
    speed = np.linalg.norm(smooth.reshape(len(smooth), -1, 3), axis=-1).T
    return sparc(speed, fine_hz / every, FILTERED_CUTOFF_HZ, 0.0)


def _rate(t_s: Array) -> float:
    return (len(t_s) - 1) / float(t_s[-1] - t_s[0])


def _even_speeds(t_s: Array, lengths: Array) -> Array:
    """Return the speeds (M, N - 1) of steps of `lengths` (M, N - 1) between `t_s` (N,), at evenly spaced times."""
    dt = np.diff(t_s)
    speed = lengths / dt
    period = 1.0 / _rate(t_s)
    if float(np.abs(dt - period).max()) > 1e-3 * period:
        middle = 0.5 * (t_s[:-1] + t_s[1:])
        even = t_s[0] + period * (np.arange(len(dt)) + 0.5)
        speed = np.array([np.interp(even, middle, row) for row in speed])
    return np.asarray(speed)


METRICS = ("sparc", "sparc_rotation", "ldlj", "sparc_filtered", "sparc_rotation_filtered")
"""Names of the metrics."""
_OF_POSITION = ("sparc", "ldlj", "sparc_filtered")
_OF_ROTATION = ("sparc_rotation", "sparc_rotation_filtered")
_FLOORS = {"low": 5.0, "median": 50.0, "high": 95.0}  # percentiles


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothness:
    """Smoothness of a gripper track."""

    metrics: Mapping[str, float | None]
    """Values by name, None where they cannot be measured.

    The noise floor of `sparc` has the name with _floor_low, _floor_median and _floor_high appended, and so on:
    percentiles 5, 50 and 95 over DRAWS copies of the smoothed motion with the track's noise."""
    reasons: Mapping[str, str]
    """Why a metric, or its noise floor, is missing, by metric."""
    bounds: Mapping[str, float | None]
    """Least value of each metric whatever happens in unknown frames, by name; empty if all frames are measured."""


def measure_smoothness(
    track: GripperTrack, noise: TrackNoise | None = None, seed: int = 0, *, measured: NDArray[np.bool_] | None = None
) -> Smoothness:
    """Measure the smoothness of a track.

    The value is that of the longest run of consecutive tracked frames, None if that leaves out more than MAX_LOST_SHARE
    of the frames. The bounds of SPARC and LDLJ are the least values over all motions in the frames that are not
    measured, None if more than MAX_LOST_SHARE are not; those of the filtered SPARC are None.

    Args:
        noise: noise of the track; estimated if None (`noise.estimate_track_noise`).
        measured: (T,) frames that are neither lost, bridged nor out of reach; None: the tracked ones.
    """
    measured = track.tracked if measured is None else measured
    n = len(track.t_s)
    lost = int((~measured).sum())
    run = max(segments(track.tracked), key=lambda run: run.stop - run.start, default=slice(0, 0))
    left_out = n - (run.stop - run.start)
    whole = _measure_run(track, run, noise, seed)
    if left_out > MAX_LOST_SHARE * n:
        why = f"{left_out} of {n} frames are lost or apart, more than {MAX_LOST_SHARE:.0%}"
        whole = _smoothness({}, dict.fromkeys(METRICS, why))
    if lost == 0:
        return whole
    bounds = _least_values(track, measured) if lost <= MAX_LOST_SHARE * n else {}
    return replace(whole, bounds=MappingProxyType({name: bounds.get(name) for name in METRICS}))


def _least_values(track: GripperTrack, tracked: NDArray[np.bool_]) -> dict[str, float]:
    """Return the least SPARC and LDLJ over all motions in frames other than `tracked`; none of a gripper at rest."""
    t_s = track.t_s
    rate = _rate(t_s)
    stepped = tracked[1:] & tracked[:-1]
    p = track.X_BG[:, :3, 3]
    R = np.where(tracked[:, None, None], track.X_BG[:, :3, :3], np.eye(3))
    lengths = np.linalg.norm([np.diff(p, axis=0), rotation_steps(R)], axis=-1)
    moved, turned = _even_speeds(t_s, np.where(stepped, lengths, np.nan))
    bins = _bins(len(moved))
    cutoff_hz = min(CUTOFF_HZ, rate / 2.0)
    values = {}
    if _rests(p[tracked]) is None:
        values["sparc"] = least_arc(moved, rate, bins, cutoff_hz)
        values["ldlj"] = least_ldlj(moved, rate)
    if _keeps_orientation(R[tracked]) is None:
        values["sparc_rotation"] = least_arc(turned, rate, bins, cutoff_hz)
    return values


def stands_still(X_BG: Array) -> bool:
    """Return whether poses (N, 4, 4) neither move by more than STILL_M nor turn by more than STILL_RAD."""
    return _rests(X_BG[:, :3, 3]) is not None and _keeps_orientation(X_BG[:, :3, :3]) is not None


def _rests(p: Array) -> str | None:
    """Return why positions (N, 3) [m] have no smoothness; None if they move."""
    return None if np.linalg.norm(p - p[0], axis=-1).max() > STILL_M else f"the gripper stays within {STILL_M} m"


def _keeps_orientation(R: Array) -> str | None:
    """Return why rotations (N, 3, 3) have no smoothness; None if they turn."""
    return None if rotation_angle(R[0].T @ R).max() > STILL_RAD else f"the gripper stays within {STILL_RAD} rad"


def _measure_run(track: GripperTrack, run: slice, noise: TrackNoise | None, seed: int) -> Smoothness:
    """Measure the smoothness of a run of consecutive tracked frames of `track`.

    Speeds are those between neighbouring frames, interpolated linearly to evenly spaced times if the frames are not. A
    run of fewer than MIN_FRAMES frames has no smoothness, nor has a gripper that stays within STILL_M (translation) or
    STILL_RAD (rotation). Noise floors are based on the motion as smoothed by `smooth_path`, which is slightly smoother
    than the true one for few frames per move (at six frames per move and 3 mm of noise by 0.1 to 0.4 of SPARC).
    """
    X = track.X_BG[run]
    t_s = track.t_s[run]
    n = len(t_s)
    if n < MIN_FRAMES:
        short = f"the longest run of tracked frames has {n}, {MIN_FRAMES} are needed"
        return _smoothness({}, dict.fromkeys(METRICS, short))
    noise = noise or estimate_track_noise(track.t_s, track.X_BG, track.tracked)
    p = X[:, :3, 3]
    # The cumulative sum of the rotation vectors between frames is a path whose steps are those of the rotation.
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(rotation_steps(X[:, :3, :3]), axis=0)])
    rng = np.random.default_rng(seed)
    values: dict[str, float] = {}
    reasons: dict[str, str] = {}
    for names, path, sigma, still in (
        (_OF_POSITION, p, noise.position_m, _rests(p)),
        (_OF_ROTATION, turned, noise.rotation_rad, _keeps_orientation(X[:, :3, :3])),
    ):
        if still is not None:
            reasons |= dict.fromkeys(names, still)
            continue
        for name, measured in _measure(names, t_s, path, sigma, rng):
            if isinstance(measured, str):
                reasons[name] = measured
            else:
                values[name] = measured
    return _smoothness(values, reasons)


def _measure(
    names: tuple[str, ...], t_s: Array, p: Array, sigma: float, rng: np.random.Generator
) -> Iterator[tuple[str, float | str]]:
    """Yield metrics and floors of a path `p` (N, 3) with noise `sigma` per axis by name, or why one is missing."""
    paths = p[:, None]
    if np.isfinite(sigma):
        smooth = smooth_path(t_s, p, np.full(3, sigma))
        paths = np.concatenate([paths, smooth[:, None] + sigma * rng.standard_normal((len(p), DRAWS, 3))], axis=1)
    rate = _rate(t_s)
    speeds = _even_speeds(t_s, np.linalg.norm(np.diff(paths, axis=0), axis=-1).T)
    for name in names:
        if name == "ldlj":
            values = ldlj(speeds, rate)
        elif not name.endswith("_filtered"):
            values = sparc(speeds, rate)
        elif rate >= 2.0 * FILTERED_CUTOFF_HZ * (1.0 - 1e-9):
            values = filtered_sparc(t_s, paths)
        else:
            needed = 2.0 * FILTERED_CUTOFF_HZ
            yield name, f"{rate:.3g} frames a second are too few; the filter needs {needed:g}"
            continue
        drawn = values[1:][np.isfinite(values[1:])]
        if len(drawn):
            for part, floor in zip(_FLOORS, np.percentile(drawn, list(_FLOORS.values())), strict=True):
                yield f"{name}_floor_{part}", float(floor)
        else:
            yield name, "the noise is not known"
        yield name, float(values[0]) if np.isfinite(values[0]) else "the speed has no spectrum to measure"


def _smoothness(values: Mapping[str, float], reasons: Mapping[str, str]) -> Smoothness:
    names = (*METRICS, *(f"{name}_floor_{part}" for name in METRICS for part in _FLOORS))
    return Smoothness(
        metrics=MappingProxyType({name: values.get(name) for name in names}),
        reasons=MappingProxyType({name: reasons[name] for name in METRICS if name in reasons}),
        bounds=MappingProxyType({}),
    )


def least_arc(speed: Array, sampling_hz: float, bins: int, cutoff_hz: float) -> float:
    """Return a lower bound of SPARC over all speeds in place of the unknown ones.

    The spectrum of a profile is the mean of exp(-2 pi i f t) over its samples, weighted by speed: a mixture (1 - s) K +
    s U of the known and the unknown samples. From one frequency to the next, df higher, its magnitude V changes by at
    most |exp(2 pi i df c) (V e)(f + df) - (V e)(f)| with e its phase, for any time c. That is at most (1 - s) A + s H,
    where A is this difference for K and H = max |2 sin(pi df (t - c))| over the unknown times t; hence at most max(A,
    H), minimised over c. The arc is longest with these changes and with the end, of all up to the cut-off, that makes
    it longest. A known sample that becomes unknown moves its part of A into H, so that max(A, H) does not fall.

    Args:
        speed: (N,) speeds at evenly spaced times; NaN where unknown.
        sampling_hz: sampling rate.
        bins: length of the zero-padded spectrum.
        cutoff_hz: greatest frequency of the arc [Hz].
    """
    finite = np.isfinite(speed)
    t = np.arange(len(speed)) / sampling_hz
    df = sampling_hz / bins
    kept = int(np.count_nonzero(df * np.arange(bins // 2 + 1) <= cutoff_hz))
    mass = np.where(finite, speed, 0.0) / (float(speed[finite].sum()) or 1.0)
    spectrum = np.fft.rfft(mass, bins)[:kept]
    centres = np.linspace(t[0], t[-1], 65)[:, None]  # times about which spectra are turned
    change = np.abs(np.exp(2j * np.pi * df * centres) * spectrum[1:] - spectrum[:-1])
    if not finite.all():
        apart = np.abs(np.sin(np.pi * df * (t[~finite] - centres))).max(axis=-1, keepdims=True)
        change = np.maximum(change, 2.0 * apart)
    change = change.min(axis=0)
    steps = 1.0 / np.arange(1, kept)  # the width of a step over the length of the arc's frequency range
    return -max(float(np.hypot(step, change[:last]).sum()) for last, step in enumerate(steps, 1))


def least_ldlj(speed: Array, sampling_hz: float) -> float:
    """Return the least log dimensionless jerk over all speeds in place of the unknown ones; infinite without jerk.

    `speed` (N,) is that at evenly spaced times, NaN where unknown. The value falls with the sum of squared second
    differences of the speed over its peak: a convex function of the unknown samples and of the scale of the known ones,
    all in 0..1, so that its greatest value is taken with each of them 0 or 1. Dynamic programming over the last two
    samples finds it.
    """
    finite = np.isfinite(speed)
    peak = float(speed[finite].max(initial=0.0)) or 1.0
    greatest = 0.0
    for scale in (0.0, 1.0):
        options = [(scale * v / peak,) if k else (0.0, 1.0) for v, k in zip(speed.tolist(), finite, strict=True)]
        sums = {(a, b): 0.0 for a in options[0] for b in options[1]}
        for choice in options[2:]:
            extended: dict[tuple[float, float], float] = {}
            for (a, b), value in sums.items():
                for c in choice:
                    extended[b, c] = max(extended.get((b, c), 0.0), value + (a - 2.0 * b + c) ** 2)
            sums = extended
        greatest = max(greatest, *sums.values())
    return -float(np.log(len(speed) ** 3 * greatest)) if greatest > 0.0 else np.inf
