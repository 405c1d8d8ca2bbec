"""Smoothness of a motion from its speed profile: spectral arc length (SPARC) and log dimensionless jerk (LDLJ).

Both are negative, do not change with the size of the motion, and are nearer to 0 the smoother it is. A gripper that
does not move has no smoothness: None, never 0. Both follow the reference implementation of their authors
(github.com/siva82kb/smoothness) to the digits it documents. Noise makes any motion look rough, the more so the higher
the frame rate; two things tell that apart. The filtered SPARC looks at the slow part of a motion alone, the same at any
frame rate. And each metric comes with its noise floor: what it would be for this motion, smoothed, if nothing but the
track's own noise were added.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import rfft
from scipy.interpolate import CubicSpline
from scipy.ndimage import convolve1d

from kinebench_drake.geometry import Array, rotation_angle
from kinebench_drake.metrics.derivatives import smooth_path
from kinebench_drake.metrics.noise import TrackNoise, estimate_track_noise, rotation_steps
from kinebench_drake.segments import segments
from kinebench_drake.types import GripperTrack

PAD_LEVEL = 4
"""Zero padding: the spectrum has 2^(ceil(log2 N) + PAD_LEVEL) bins."""
CUTOFF_HZ = 10.0
"""Highest frequency of the spectral arc."""
AMPLITUDE_THRESHOLD = 0.05
"""The arc ends at the last bin that reaches this fraction of the spectrum's maximum."""

MIN_FRAMES = 8
"""Fewest consecutive tracked frames that can be judged."""
STILL_M = 0.005
"""A gripper that stays within this distance of its first position does not move [m]."""
STILL_RAD = 0.05
"""A gripper that stays within this angle of its first orientation does not turn [rad]."""

FILTER_HZ = 1.0
"""The filtered SPARC sees a motion through a Gaussian filter without delay, at -3 dB here ..."""
FILTERED_CUTOFF_HZ = 2.0
"""... and its arc ends here, whatever the amplitude: video must have at least twice as many frames a second."""

DRAWS = 64
"""Noisy copies of the smoothed motion that a noise floor is made from."""

_GRID_HZ = 10.0  # the filtered speed is sampled this often at least


def sparc(speed: ArrayLike, sampling_hz: float) -> float | None:
    """Spectral arc length of a speed profile `speed` (N,) sampled at `sampling_hz`; None for a profile of zeros.

    SPARC = - integral over 0..f_c of sqrt((1 / f_c)^2 + (dV/df)^2) df with V the magnitude of the speed's spectrum
    over its maximum and f_c the last frequency, at most CUTOFF_HZ, at which V reaches AMPLITUDE_THRESHOLD. Source:
    S. Balasubramanian, A. Melendez-Calderon, A. Roby-Brami, E. Burdet, "On the analysis of movement smoothness",
    J. NeuroEngineering Rehabil. 12:112, 2015, eq. (8), and the reference implementation. Other than that, frequencies
    above sampling_hz / 2 are left out: they mirror those below, and the reference counts them when sampling_hz is
    less than twice CUTOFF_HZ, which doubles the arc of a smooth motion at 10 Hz.
    """
    speed = np.asarray(speed, dtype=np.float64)
    if len(speed) < 2 or not np.isfinite(speed).all() or not np.any(speed):
        return None
    value = float(_arcs(speed[None], sampling_hz, CUTOFF_HZ, AMPLITUDE_THRESHOLD)[0])
    return value if np.isfinite(value) else None


def _arcs(speed: Array, sampling_hz: float, cutoff_hz: float, threshold: float) -> Array:
    """SPARC (M,) of speed profiles (M, N), none of them all zero; NaN where no arc is left. Threshold 0 keeps all."""
    bins = int(2 ** (np.ceil(np.log2(speed.shape[-1])) + PAD_LEVEL))
    frequency = np.arange(bins // 2 + 1) * (sampling_hz / bins)
    kept = int(np.count_nonzero(frequency <= min(cutoff_hz, sampling_hz / 2.0)))
    spectrum = rfft(speed, bins)
    if speed.min() >= 0.0:  # then no bin exceeds the first
        spectrum = spectrum[:, :kept]
    magnitude = np.sqrt(spectrum.real**2 + spectrum.imag**2)
    magnitude /= magnitude.max(axis=-1, keepdims=True)
    frequency, magnitude = frequency[:kept], magnitude[:, :kept]
    above = magnitude >= threshold
    first, last = np.argmax(above, axis=-1), kept - 1 - np.argmax(above[:, ::-1], axis=-1)
    index = np.arange(kept - 1)
    inside = (index >= first[:, None]) & (index < last[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        df = (frequency[1] - frequency[0]) / (frequency[last] - frequency[first])
        arc = np.sqrt(np.diff(magnitude, axis=-1) ** 2 + df[:, None] ** 2)
        length = np.einsum("mf,mf->m", arc, inside)
    return np.where(above.any(axis=-1) & (last > first), -length, np.nan)


def ldlj(speed: ArrayLike, sampling_hz: float) -> float | None:
    """Log dimensionless jerk of a speed profile `speed` (N,) sampled at `sampling_hz`; None if it has no jerk.

    LDLJ = -ln((D^3 / v_peak^2) integral (d2v/dt2)^2 dt), D = N / sampling_hz the duration and v the speed, its second
    derivative taken by differences. Sources: S. Balasubramanian, A. Melendez-Calderon, E. Burdet, "A robust and
    sensitive metric for quantifying movement smoothness", IEEE Trans. Biomed. Eng. 59(8), 2012, and the 2015 paper
    that `sparc` cites. Three derivatives of the position amplify tracking noise: compare it between tracks of equal
    frame rate only.
    """
    speed = np.asarray(speed, dtype=np.float64)
    if len(speed) < 3 or not np.isfinite(speed).all() or not np.any(speed):
        return None
    value = float(_jerks(speed[None], sampling_hz)[0])
    return value if np.isfinite(value) else None


def _jerks(speed: Array, sampling_hz: float) -> Array:
    """LDLJ (M,) of speed profiles (M, N), none of them all zero; infinite where there is no jerk."""
    duration = speed.shape[-1] / sampling_hz
    jerk = np.diff(speed, 2, axis=-1) * sampling_hz**2
    with np.errstate(divide="ignore"):
        value = duration**3 / np.abs(speed).max(axis=-1) ** 2 * np.sum(jerk**2, axis=-1) / sampling_hz
        return np.asarray(-np.log(value))


def filtered_sparc(t_s: ArrayLike, p: ArrayLike) -> float | None:
    """SPARC of a path `p` (N, 3) at times `t_s` (N,) [s] through one fixed filter, comparable between frame rates.

    The path is interpolated by a natural cubic spline; its velocity is smoothed by the Gaussian filter that passes
    1/sqrt(2) at FILTER_HZ, at rest before and after; the arc of the resulting speed runs to FILTERED_CUTOFF_HZ with no
    threshold of amplitude. None below 2 FILTERED_CUTOFF_HZ frames a second, and for a path that stays where it is.
    """
    t_s, p = np.asarray(t_s, dtype=np.float64), np.asarray(p, dtype=np.float64)
    if len(t_s) < 3 or _rate(t_s) < 2.0 * FILTERED_CUTOFF_HZ or not np.any(np.diff(p, axis=0)):
        return None
    return float(_filtered_arcs(t_s, p[:, None])[0])


def _rate(t_s: Array) -> float:
    return (len(t_s) - 1) / float(t_s[-1] - t_s[0])


def _filtered_arcs(t_s: Array, p: Array) -> Array:
    """Filtered SPARC (M,) of paths `p` (N, M, 3)."""
    rate = _rate(t_s)
    fine_hz = rate * max(1.0, np.ceil(_GRID_HZ / rate - 1e-9))
    width = fine_hz * np.sqrt(np.log(2.0)) / (2.0 * np.pi * FILTER_HZ)
    reach = int(np.ceil(4.0 * width))
    times = t_s[0] + (np.arange(round(float(t_s[-1] - t_s[0]) * fine_hz)) + 0.5) / fine_hz
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    velocity = CubicSpline(t_s, p.reshape(len(t_s), -1), bc_type="natural")(times, 1)
    every = max(1, int(fine_hz / _GRID_HZ))  # what the filter leaves needs no finer grid
    padded = np.pad(velocity, ((reach, reach), (0, 0)))
    smooth = convolve1d(padded, kernel / kernel.sum(), axis=0, mode="constant")[::every]
    speed = np.linalg.norm(smooth.reshape(len(smooth), -1, 3), axis=-1).T
    return _arcs(speed, fine_hz / every, FILTERED_CUTOFF_HZ, 0.0)


def _speeds(t_s: Array, p: Array) -> Array:
    """Speeds (M, N - 1) of paths `p` (N, M, 3) at even times."""
    dt = np.diff(t_s)
    speed = np.linalg.norm(np.diff(p, axis=0), axis=-1).T / dt
    period = 1.0 / _rate(t_s)
    if float(np.abs(dt - period).max()) > 1e-3 * period:
        middle, even = 0.5 * (t_s[:-1] + t_s[1:]), t_s[0] + period * (np.arange(len(dt)) + 0.5)
        speed = np.array([np.interp(even, middle, row) for row in speed])
    return np.asarray(speed)


@dataclass(frozen=True, slots=True, kw_only=True)
class Floor:
    """What a metric is for the smoothed motion with the track's measured noise: percentiles over DRAWS noisy copies."""

    low: float
    """5th percentile."""
    median: float
    """50th percentile."""
    high: float
    """95th percentile."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothness:
    """Smoothness of a gripper track; None where there is too little to judge."""

    sparc: float | None
    """SPARC of the TCP's translation speed."""
    sparc_rotation: float | None
    """SPARC of the TCP's rotation speed."""
    ldlj: float | None
    """LDLJ of the TCP's translation speed."""
    sparc_filtered: float | None
    """SPARC of the TCP's translation through the fixed filter."""
    sparc_rotation_filtered: float | None
    """SPARC of the TCP's rotation through the fixed filter."""
    floors: Mapping[str, Floor]
    """Noise floors by metric, of those metrics that have one."""
    reasons: Mapping[str, str]
    """Why a metric is None, or else its floor, by metric."""

    @property
    def metrics(self) -> dict[str, float | None]:
        """All numbers by name; those of the floor of `sparc` are `sparc_floor_low`, `_median`, `_high`, and so on."""
        values = {name: getattr(self, name) for name in METRICS}
        for name in METRICS:
            floor = self.floors.get(name)
            for part in ("low", "median", "high"):
                values[f"{name}_floor_{part}"] = None if floor is None else getattr(floor, part)
        return values


METRICS = ("sparc", "sparc_rotation", "ldlj", "sparc_filtered", "sparc_rotation_filtered")
"""Names of the metrics."""


def measure_smoothness(track: GripperTrack, noise: TrackNoise | None = None, seed: int = 0) -> Smoothness:
    """Smoothness of the longest run of consecutive tracked frames of `track`: gaps are neither bridged nor guessed.

    Speeds are those between neighbouring frames. If the frames are unevenly spaced in time, the speed is read off at
    even times by linear interpolation. A run of fewer than MIN_FRAMES frames gives None, and so does a gripper that
    stays within STILL_M (translation) or STILL_RAD (rotation): what would be judged there is the tracking noise.

    Noise floors start from the motion as `smooth_path` finds it, which is a little smoother than the true one where
    there are few frames a move: at six frames a move and 3 mm of noise, the floor of SPARC came out 0.1 to 0.4 nearer
    to 0 than the true motion's (measured; at 24 frames a move the same to 0.1).

    Args:
        track: the gripper's path.
        noise: its noise; None measures it (`noise.track_noise`).
        seed: of the draws for the noise floor: the same track gives the same floor.
    """
    run = max(segments(track.tracked), key=lambda run: run.stop - run.start, default=slice(0, 0))
    X, t_s = track.X_BG[run], track.t_s[run]
    n = len(t_s)
    if n < MIN_FRAMES:
        short = f"the longest run of tracked frames has {n}, {MIN_FRAMES} are needed"
        return _smoothness(dict.fromkeys(METRICS, (None, None, short)))
    noise = noise or estimate_track_noise(track.t_s, track.X_BG, track.tracked)
    p, R = X[:, :3, 3], X[:, :3, :3]
    # Turns from frame to frame, added up, make a path whose steps are the rotation's.
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(rotation_steps(R), axis=0)])
    rng = np.random.default_rng(seed)
    found = {
        **_judge(
            ("sparc", "ldlj", "sparc_filtered"),
            t_s,
            p,
            noise.position_m,
            rng,
            None if np.linalg.norm(p - p[0], axis=-1).max() > STILL_M else f"the gripper stays within {STILL_M} m",
        ),
        **_judge(
            ("sparc_rotation", "sparc_rotation_filtered"),
            t_s,
            turned,
            noise.rotation_rad,
            rng,
            None if rotation_angle(R[0].T @ R).max() > STILL_RAD else f"the gripper stays within {STILL_RAD} rad",
        ),
    }
    return _smoothness(found)


_Measurement = tuple[float | None, Floor | None, str]


def _judge(
    names: tuple[str, ...], t_s: Array, p: Array, sigma: float, rng: np.random.Generator, still: str | None
) -> dict[str, _Measurement]:
    """Value, floor and reason of each metric of a path `p` (N, 3) whose noise is `sigma` an axis."""
    if still is not None:
        return dict.fromkeys(names, (None, None, still))
    paths = p[:, None]
    if np.isfinite(sigma):
        smooth = smooth_path(t_s, p, np.full(3, sigma))
        paths = np.concatenate([paths, smooth[:, None] + sigma * rng.standard_normal((len(p), DRAWS, 3))], axis=1)
    rate, speeds = _rate(t_s), _speeds(t_s, paths)
    found: dict[str, _Measurement] = {}
    for name in names:
        if name == "ldlj":
            values = _jerks(speeds, rate)
        elif not name.endswith("_filtered"):
            values = _arcs(speeds, rate, CUTOFF_HZ, AMPLITUDE_THRESHOLD)
        elif rate >= 2.0 * FILTERED_CUTOFF_HZ * (1.0 - 1e-9):
            values = _filtered_arcs(t_s, paths)
        else:
            needed = 2.0 * FILTERED_CUTOFF_HZ
            found[name] = (None, None, f"{rate:.3g} frames a second are too few; the filter needs {needed:g}")
            continue
        value = float(values[0]) if np.isfinite(values[0]) else None
        drawn = values[1:][np.isfinite(values[1:])]
        floor = None
        if len(drawn):
            low, median, high = (float(v) for v in np.percentile(drawn, (5.0, 50.0, 95.0)))
            floor = Floor(low=low, median=median, high=high)
        reason = "the noise is not known" if floor is None else ""
        found[name] = (value, floor, reason if value is not None else "the speed has no spectrum to measure")
    return found


def _smoothness(found: Mapping[str, _Measurement]) -> Smoothness:
    return Smoothness(
        **{name: found[name][0] for name in METRICS},
        floors=MappingProxyType({name: floor for name in METRICS if (floor := found[name][1]) is not None}),
        reasons=MappingProxyType({name: reason for name in METRICS if (reason := found[name][2])}),
    )
