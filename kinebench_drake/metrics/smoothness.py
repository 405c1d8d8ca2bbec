"""Smoothness of a motion from its speed profile: spectral arc length (SPARC) and log dimensionless jerk (LDLJ).

Both are negative, do not change with the size of the motion, and are nearer to 0 the smoother it is. A gripper that
does not move has no smoothness: None, never 0. Both follow the reference implementation of their authors
(github.com/siva82kb/smoothness) to the digits it documents.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, rotation_angle
from kinebench_drake.products import GripperTrack

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
    bins = int(2 ** (np.ceil(np.log2(len(speed))) + PAD_LEVEL))
    frequency = np.arange(bins) * (sampling_hz / bins)
    magnitude = np.abs(np.fft.fft(speed, bins))
    magnitude /= magnitude.max()
    kept = frequency <= min(CUTOFF_HZ, sampling_hz / 2.0)
    frequency, magnitude = frequency[kept], magnitude[kept]
    above = np.flatnonzero(magnitude >= AMPLITUDE_THRESHOLD)
    if len(above) == 0 or above[-1] == above[0]:
        return None
    arc = slice(int(above[0]), int(above[-1]) + 1)
    frequency, magnitude = frequency[arc], magnitude[arc]
    df = np.diff(frequency) / (frequency[-1] - frequency[0])
    return float(-np.sum(np.hypot(df, np.diff(magnitude))))


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
    duration = len(speed) / sampling_hz
    jerk = np.diff(speed, 2) * sampling_hz**2
    value = duration**3 / float(np.abs(speed).max()) ** 2 * float(np.sum(jerk**2)) / sampling_hz
    return -float(np.log(value)) if value > 0.0 else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothness:
    """Smoothness of a gripper track; None where there is too little to judge."""

    sparc: float | None
    """SPARC of the TCP's translation speed."""
    sparc_rotation: float | None
    """SPARC of the TCP's rotation speed."""
    ldlj: float | None
    """LDLJ of the TCP's translation speed."""


def runs(mask: NDArray[np.bool_]) -> list[slice]:
    """Stretches of consecutive true values of `mask` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(start), int(end)) for start, end in zip(edges[::2], edges[1::2], strict=True)]


def track_smoothness(track: GripperTrack) -> Smoothness:
    """Smoothness of the longest run of consecutive tracked frames of `track`: gaps are neither bridged nor guessed.

    Speeds are those between neighbouring frames. If the frames are unevenly spaced in time, the speed is read off at
    even times by linear interpolation. A run of fewer than MIN_FRAMES frames gives None, and so does a gripper that
    stays within STILL_M (translation) or STILL_RAD (rotation): what would be judged there is the tracking noise.
    """
    run = max(runs(track.tracked), key=lambda run: run.stop - run.start, default=slice(0, 0))
    X, t_s = track.X_BG[run], track.t_s[run]
    if len(t_s) < MIN_FRAMES:
        return Smoothness(sparc=None, sparc_rotation=None, ldlj=None)
    p, R = X[:, :3, 3], X[:, :3, :3]
    distance = np.linalg.norm(np.diff(p, axis=0), axis=-1)
    angle = rotation_angle(np.swapaxes(R[:-1], -1, -2) @ R[1:])
    moves = float(np.linalg.norm(p - p[0], axis=-1).max()) > STILL_M
    turns = float(rotation_angle(R[0].T @ R).max()) > STILL_RAD
    return Smoothness(
        sparc=_judge(sparc, distance, t_s) if moves else None,
        sparc_rotation=_judge(sparc, angle, t_s) if turns else None,
        ldlj=_judge(ldlj, distance, t_s) if moves else None,
    )


def _judge(metric: Callable[[ArrayLike, float], float | None], step: Array, t_s: Array) -> float | None:
    """`metric` of the speed of steps (N - 1,) between the times `t_s` (N,)."""
    dt = np.diff(t_s)
    period = float(t_s[-1] - t_s[0]) / len(dt)
    speed = step / dt
    if float(np.abs(dt - period).max()) > 1e-3 * period:
        middle = 0.5 * (t_s[:-1] + t_s[1:])
        speed = np.interp(t_s[0] + period * (np.arange(len(dt)) + 0.5), middle, speed)
    return metric(speed, 1.0 / period)
