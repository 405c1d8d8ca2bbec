"""Smoothness of a motion with unknown stretches: its least value over everything that may have happened there.

Any speeds of 0 or more may stand in for the unknown ones. So replacing known speeds by unknown ones never raises these
values, and no value exceeds that of the whole motion.
"""

import numpy as np

from kinebench_drake.geometry import Array


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
    total = float(speed[finite].sum())
    mass = np.where(finite, speed, 0.0) / (total or 1.0)
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
