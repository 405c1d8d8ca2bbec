"""Lower-bound derivatives of a noisy path with their standard errors, and smoothing of the path.

The k-th derivative is k! times the leading coefficient of the polynomial of degree k fitted to a window of samples by
least squares: k!/||r|| times the projection on r/||r||, r being t^k less its fit by lower powers (the discrete Legendre
polynomials of Gram; A. Savitzky and M. J. E. Golay, Anal. Chem. 36, 1964, tabulate them for even times). By Peano's
theorem (P. J. Davis, Interpolation and Approximation, 1963, chapter 3) it is a mean of the k-th derivative over the
window with weights that are nowhere negative and sum to 1: it can prove that a path breaks a limit, not that it keeps
it. White noise sigma of the samples gives it the standard error k! sigma/||r||, which determines the length of the
window.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from kinebench_drake.geometry import Array
from kinebench_drake.segments import finite_rows, segments

NOISE_SHARE = 0.1
"""Standard error / limit at which a window is long enough."""
LONGEST_S = {1: 1.0, 2: 1.5, 3: 0.5}
"""Greatest length of a window [s], by order of the derivative.

No joint of the Panda can stay at a limit for much longer: it crosses its range in 1.4 to 2.7 s at its speed limit, in
1.2 to 1.9 s at its acceleration limit (braking, then reversing: 8 range = a w^2), in 0.3 to 0.4 s at its jerk limit
(96 range = j w^3). So a longer window could hardly show a violation.
"""
NEGLIGIBLE_RAD = 1e-4
"""Noise below which a path is not smoothed [rad]."""
LEAST_CUTOFF_HZ = 0.25
"""Lowest cut-off frequency of `smooth_path`, however noisy the path [Hz]."""

_ROUGHNESS = 3  # order of the differences that smooth_path minimises


@dataclass(frozen=True, slots=True, kw_only=True)
class Derivative:
    """One derivative of a joint path."""

    value: Array
    """(T, 7) weighted mean of the derivative over the window of each frame [rad/s^order]; NaN where there is none."""
    standard_error: Array
    """(T, 7) standard deviation of `value` due to the noise of the samples [rad/s^order]; NaN if unknown."""
    window: int
    """Number of samples in a window."""
    window_s: float
    """Time from the first to the last sample of a window [s]."""
    bandwidth_hz: float
    """Frequency at which the derivative of a sinusoid is attenuated by 3 dB [Hz]; at most half the frame rate."""


def differentiate(t_s: Array, q: Array, sigma: Array, order: int, limits: Array) -> Derivative:
    """Differentiate a joint path over the shortest window that makes the noise small relative to the limits.

    The whole track has one window size in samples: the smallest at which the standard error, for the median noise of
    every joint, is NOISE_SHARE of its limit, at most LONGEST_S long, at least order + 1 samples. Windows are centred on
    their frame (for an even size one sample further back), at the ends of the track the nearest complete ones. Frames
    with NaN are left out and windows span them: the result remains a mean of the derivative.

    Args:
        t_s: (T,) times [s], increasing; evenly spaced times are faster.
        q: (T, 7) joint angles [rad], NaN where unknown.
        sigma: (7,) or (T, 7) standard deviations of the noise of `q` [rad]; NaN where unknown.
        order: 1, 2 or 3.
        limits: (7,) limits of the derivative [rad/s^order].
    """
    finite = finite_rows(q)
    variance = np.broadcast_to(np.asarray(sigma, dtype=np.float64) ** 2, q.shape)
    period = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    noise = np.sqrt(np.median(variance[finite], axis=0)) / limits if finite.any() else np.zeros(1)
    size = _window(period, float(np.nan_to_num(noise).max()), order)
    value, error = np.full((2, *q.shape), np.nan)
    frames = np.flatnonzero(finite)
    size = max(min(size, len(frames)), order + 1)
    if len(frames) >= size:
        weights = _weights(_windows(t_s[frames], size), order)  # (N or 1, size)
        first = np.clip(np.arange(len(frames)) - size // 2, 0, len(frames) - size)
        value[frames] = _apply(weights, q[frames])[first]
        error[frames] = np.sqrt(_apply(weights**2, variance[frames]))[first]
    return Derivative(
        value=value,
        standard_error=error,
        window=size,
        window_s=(size - 1) * period,
        bandwidth_hz=_bandwidth(period, size, order),
    )


def smooth_path(t_s: Array, q: Array, sigma: Array) -> Array:
    """Return the path (T, 7) [rad] smoothed as far as its noise explains; NaN where `q` is.

    In each run of finite frames, of all paths whose residuals are no more than the noise explains, less the degrees of
    freedom of the path, the one with the least third differences: a smoothing spline in discrete time (E. T. Whittaker,
    Proc. Edinburgh Math. Soc. 41, 1923; C. H. Reinsch, Numer. Math. 10, 1967; P. H. C. Eilers, Anal. Chem. 75, 2003).
    All joints share one weight. Paths whose noise is below NEGLIGIBLE_RAD, or unknown, are returned unchanged.

    Args:
        t_s: (T,) times [s], increasing.
        q: (T, N) samples of any unit, NaN where unknown.
        sigma: (N,) or (T, N) standard deviations of the noise.
    """
    variance = np.maximum(np.broadcast_to(np.asarray(sigma, dtype=np.float64), q.shape), 0.1 * NEGLIGIBLE_RAD) ** 2
    smoothed = q.copy()
    for run in segments(finite_rows(q)):
        noisy = float(np.median(variance[run].mean(axis=-1))) > NEGLIGIBLE_RAD**2
        if noisy and run.stop - run.start > _ROUGHNESS + 1:
            smoothed[run] = _smooth_run(t_s[run], q[run], variance[run])
    return smoothed


def _smooth_run(t_s: Array, q: Array, variance: Array) -> Array:
    """Minimise sum (q - s)^2 / w + weight * sum (D s)^2, D the third differences, w the noise relative to its median.

    Solved as s = q - w D^T u, (I / weight + D w D^T) u = D q, which preserves parabolas to rounding.
    """
    n = len(t_s)
    w = (variance / np.median(variance, axis=0)).mean(axis=-1)
    window = np.lib.stride_tricks.sliding_window_view(t_s, _ROUGHNESS + 1)
    apart = window[:, :, None] - window[:, None, :] + np.eye(_ROUGHNESS + 1)
    period = float(t_s[-1] - t_s[0]) / (n - 1)
    D = factorial(_ROUGHNESS) * period**_ROUGHNESS / apart.prod(axis=-1)  # (n - 3, 4): -1, 3, -3, 1 at even times
    rough = np.einsum("nk,nkj->nj", D, np.lib.stride_tricks.sliding_window_view(q, _ROUGHNESS + 1, axis=0).mT)
    DwD = np.zeros((_ROUGHNESS + 1, len(D)))
    for k in range(min(_ROUGHNESS + 1, len(D))):  # the lower diagonals of D w D^T
        shared = w[k + np.arange(len(D) - k)[:, None] + np.arange(_ROUGHNESS + 1 - k)]
        DwD[k, : len(D) - k] = np.sum(D[: len(D) - k, k:] * D[k:, : _ROUGHNESS + 1 - k] * shared, axis=-1)
    stiffness = (2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n)) ** _ROUGHNESS  # approximate eigenvalues of D^T D
    best = q
    low = -4.0
    high = max(-4.0, -2.0 * _ROUGHNESS * np.log10(2.0 * np.pi * LEAST_CUTOFF_HZ * period))
    for _ in range(10):
        middle = 0.5 * (low + high)
        banded = DwD.copy()
        banded[0] += 10.0**-middle
        u = solveh_banded(banded, rough, lower=True, check_finite=False)
        correction = np.zeros_like(q)
        for k in range(_ROUGHNESS + 1):
            correction[k : k + len(D)] += D[:, k, None] * u
        correction *= w[:, None]
        freedom = float(np.sum(1.0 / (1.0 + 10.0**middle * stiffness)))
        if float(np.sum(correction**2 / variance)) <= (n - freedom) * q.shape[1]:
            best = q - correction
            low = middle
        else:
            high = middle
    return best


def _orthogonal(t: Array, degree: int) -> tuple[Array, Array]:
    """Return orthonormal polynomials (N, n, degree + 1) and the norm (N,) of t^degree less its fit by lower powers."""
    x = t - t.mean(axis=-1, keepdims=True)
    scale = np.abs(x).max(axis=-1, keepdims=True)
    x = x / scale
    basis = np.empty((*t.shape, degree + 1))
    for k in range(degree + 1):
        r = x**k
        for _ in range(2):  # two passes give orthogonality to rounding
            for lower in range(k):
                e = basis[..., lower]
                r = r - np.sum(e * r, axis=-1, keepdims=True) * e
        norm = np.linalg.norm(r, axis=-1, keepdims=True)
        basis[..., k] = r / norm
    return basis, np.asarray((norm * scale**degree)[..., 0])


def _weights(t: Array, order: int) -> Array:
    """Return the weights (N, n) [1/s^order] of the samples of windows `t` (N, n) [s] in the derivative."""
    basis, norm = _orthogonal(t, order)
    return np.asarray(factorial(order) * basis[..., order] / norm[:, None])


def _windows(t_s: Array, n: int) -> Array:
    """Return the times (N, n) of all windows of `n` samples, or (1, n) if the times are evenly spaced."""
    dt = np.diff(t_s)
    if np.ptp(dt) <= 1e-6 * dt.mean():
        return np.asarray(np.arange(n)[None] * float(dt.mean()))
    return np.lib.stride_tricks.sliding_window_view(t_s, n)


def _apply(weights: Array, samples: Array) -> Array:
    """Return weighted sums (T - n + 1, 7) over the windows of `samples` (T, 7), by `weights` (T - n + 1 or 1, n)."""
    windows = np.lib.stride_tricks.sliding_window_view(samples, weights.shape[1], axis=0)  # (N, 7, n)
    if len(weights) == 1:
        return np.asarray(windows @ weights[0])
    return np.asarray((windows @ weights[:, :, None])[..., 0])


def _window(period: float, ratio: float, order: int) -> int:
    """Return the size of the shortest window at which noise of `ratio` x limit [s^order] is below NOISE_SHARE."""
    sizes = np.arange(order + 1, max(order + 1, int(LONGEST_S[order] / period + 1e-9) + 1) + 1)
    enough = ratio * noise_gain(period, sizes, order) <= NOISE_SHARE
    return int(sizes[np.argmax(enough)] if enough.any() else sizes[-1])


def noise_gain(period: float, sizes: Array | NDArray[np.intp], order: int) -> Array:
    """Return the standard error [1/s^order] of the derivative over `sizes` evenly spaced samples of unit noise.

    k!/||r||, with the norm of Gram's polynomials ||r||^2 = h^2k (k!)^4/((2k)! (2k+1)!) n (n^2 - 1) ... (n^2 - k^2).
    """
    n2 = np.asarray(sizes, dtype=np.float64) ** 2
    k = order
    squared = np.sqrt(n2) * np.prod([n2 - j**2 for j in range(1, k + 1)], axis=0)
    squared *= factorial(k) ** 4 / (factorial(2 * k) * factorial(2 * k + 1))
    return np.asarray(factorial(k) / (np.sqrt(squared) * period**k))


def _bandwidth(period: float, size: int, order: int) -> float:
    weights = _weights(np.asarray(np.arange(size)[None] * period), order)[0]
    frequency = np.linspace(0.0, 0.5 / period, 129)[1:]
    time = (np.arange(size) - 0.5 * (size - 1)) * period
    gain = np.abs(np.exp(2j * np.pi * frequency[:, None] * time) @ weights) / (2 * np.pi * frequency) ** order
    below = np.flatnonzero(gain < np.sqrt(0.5))
    return float(frequency[below[0]] if len(below) else 0.5 / period)
