from math import factorial

import numpy as np
import pytest
from scipy.signal import savgol_coeffs

from kinebench_drake.geometry import Array
from kinebench_drake.metrics.derivatives import LONGEST_S, NOISE_SHARE, differentiate, noise_gain, smooth_path

WIDE = np.full(7, 1e9)


def _uneven(n: int = 60) -> Array:
    return np.cumsum(np.random.default_rng(0).uniform(0.02, 0.2, n))


def _forced(t_s: Array, q: Array, order: int, window: int) -> Array:
    """Derivative over windows of this many samples: the noise is chosen so that no shorter one will do."""
    period = float(np.median(np.diff(t_s)))
    sigma = NOISE_SHARE / noise_gain(period, np.array([window]), order)[0] * (1.0 - 1e-9)
    derivative = differentiate(t_s, q, np.full(7, sigma), order, np.ones(7))
    assert derivative.window == window
    return derivative.value


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("even", [True, False])
def test_derivatives_of_polynomials_of_their_order_are_exact_up_to_the_ends(order: int, even: bool) -> None:
    t_s = 0.1 * np.arange(60) if even else _uneven()
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=(order + 1, 7))
    q = np.polynomial.polynomial.polyval(t_s, coefficients).T
    for value in (
        differentiate(t_s, q, np.zeros(7), order, WIDE).value,
        _forced(t_s, q, order, 4 if order == 3 and even else order + 2),
    ):
        np.testing.assert_allclose(value, np.tile(factorial(order) * coefficients[order], (60, 1)), atol=1e-6)


@pytest.mark.parametrize(("order", "window"), [(1, 3), (1, 4), (1, 6), (2, 3), (2, 4), (2, 5), (3, 4), (3, 5), (3, 6)])
def test_even_times_give_the_weights_of_savitzky_and_golay(order: int, window: int) -> None:
    q = np.random.default_rng(0).normal(size=(40, 7))
    weights = savgol_coeffs(window, order, deriv=order, delta=0.05, use="dot", pos=(window - 1) / 2)
    expected = np.array([weights @ q[i - window // 2 : i - window // 2 + window] for i in range(5, 35)])
    np.testing.assert_allclose(_forced(0.05 * np.arange(40), q, order, window)[5:35], expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_derivatives_stay_within_the_range_of_the_true_ones(order: int) -> None:
    """Sums of sines, whose derivatives are known: the value lies within the range of the true one."""
    rng = np.random.default_rng(2)
    for t_s in (0.2 * np.arange(50), 0.03 * np.arange(80), _uneven()):
        w = rng.uniform(0.5, 12.0, (5, 7))
        phase = rng.uniform(0, 6.3, (5, 7))
        fine = np.linspace(t_s[0], t_s[-1], 4000)
        true = sum(w[k] ** order * np.sin(w[k] * fine[:, None] + phase[k] + order * np.pi / 2) for k in range(5))
        q = sum(np.sin(w[k] * t_s[:, None] + phase[k]) for k in range(5))
        for window in (order + 1, order + 3):
            value = differentiate(t_s, q, np.zeros(7), order, WIDE).value if window == order + 1 else None
            if value is None:
                period = float(np.median(np.diff(t_s)))
                if window * period > LONGEST_S[order]:
                    continue
                value = _forced(t_s, q, order, window)
            slack = 1e-3 * np.abs(true).max(axis=0)
            assert (value <= true.max(axis=0) + slack).all()
            assert (value >= true.min(axis=0) - slack).all()


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("window", [4, 7, 12])
def test_the_averaging_kernel_of_a_derivative_is_nowhere_negative(order: int, window: int) -> None:
    """Peano's kernel: the functional applied to the truncated power (t - x)_+^(k-1) / (k-1)!."""
    for times in (0.01 * np.arange(window), 0.1 * _uneven(window)):
        x = np.linspace(times[0], times[-1], 301)[1:-1]
        power = np.maximum(times[:, None] - x, 0.0) ** (order - 1) * (times[:, None] > x) / factorial(order - 1)
        kernel = []
        for column in np.array_split(power, 43, axis=1):
            q = np.zeros((window, 7))
            q[:, : column.shape[1]] = column
            period = float(np.median(np.diff(times)))
            sigma = 2.0 / noise_gain(period, np.array([window]), order)[0]
            # A run of `window` samples and noise that asks for longer: the window is the whole run.
            kernel.append(differentiate(times, q, np.full(7, sigma), order, np.ones(7)).value[0, : column.shape[1]])
        k = np.concatenate(kernel)
        assert k.min() > -1e-9 * k.max()
        assert np.trapezoid(k, x) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("even", [True, False])
def test_the_standard_error_is_the_scatter_of_noisy_derivatives(order: int, even: bool) -> None:
    t_s = 0.05 * np.arange(30) if even else _uneven(30)
    sigma = np.random.default_rng(0).uniform(0.5, 2.0, (30, 7))
    rng = np.random.default_rng(1)
    draws = [differentiate(t_s, sigma * rng.normal(size=(30, 7)), sigma, order, WIDE) for _ in range(400)]
    scatter = np.std([d.value for d in draws], axis=0)
    np.testing.assert_allclose(scatter / draws[0].standard_error, 1.0, atol=0.2)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_window_is_the_shortest_with_noise_below_its_share_of_the_limit(order: int) -> None:
    t_s = 0.02 * np.arange(200)
    q = np.zeros((200, 7))
    limits = np.full(7, 10.0)
    sizes = []
    for sigma in (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 100.0):
        d = differentiate(t_s, q, np.full(7, sigma), order, limits)
        sizes.append(d.window)
        longest = int(LONGEST_S[order] / 0.02 + 1e-9) + 1
        if order + 1 < d.window < longest:
            assert d.standard_error.max() <= NOISE_SHARE * 10.0
        if d.window > order + 1:
            shorter = sigma * noise_gain(0.02, np.array([d.window - 1]), order)[0]
            assert shorter > NOISE_SHARE * 10.0
        assert d.window_s == pytest.approx((d.window - 1) * 0.02)
    assert sizes[0] == order + 1
    assert sizes[-1] == longest
    assert sizes == sorted(sizes)


def test_the_noisiest_joint_decides_the_window() -> None:
    sigma = np.array([0, 0, 0, 0, 0, 0, 0.05])
    joint = differentiate(0.05 * np.arange(50), np.zeros((50, 7)), sigma, 1, np.ones(7))
    assert (
        joint.window == differentiate(0.05 * np.arange(50), np.zeros((50, 7)), np.full(7, 0.05), 1, np.ones(7)).window
    )
    assert joint.window > 2


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_bandwidth_is_where_a_sine_loses_three_decibels(order: int) -> None:
    t_s = 0.02 * np.arange(400)
    d = differentiate(t_s, np.zeros((400, 7)), np.full(7, 0.01), order, np.full(7, 20.0**order))
    w = 2 * np.pi * d.bandwidth_hz
    q = np.repeat(np.sin(w * t_s)[:, None], 7, axis=1)
    seen = differentiate(t_s, q, np.full(7, 0.01), order, np.full(7, 20.0**order)).value[100:300]
    assert 0.67 < np.abs(seen).max() / w**order < 0.72


def test_windows_span_gaps_and_shrink_to_short_tracks() -> None:
    t_s = 0.1 * np.arange(30)
    q = np.repeat(t_s[:, None] ** 2, 7, axis=1)
    q[[3, 6, 8]] = np.nan
    d = differentiate(t_s, q, np.full(7, 0.03), 2, np.ones(7))
    assert d.window > 3
    assert np.flatnonzero(np.isnan(d.value).all(axis=-1)).tolist() == [3, 6, 8]
    np.testing.assert_allclose(d.value[np.isfinite(d.value[:, 0])], 2.0, atol=1e-9)
    short = differentiate(t_s[:4], q[:4], np.full(7, 0.03), 2, np.ones(7))
    assert short.window == 3
    np.testing.assert_allclose(short.value[:3], 2.0, atol=1e-9)
    assert short.window_s == pytest.approx(0.2)


def test_gaps_hide_neither_a_jump_nor_a_steady_speed() -> None:
    t_s = 0.1 * np.arange(20)
    q = np.zeros((20, 7))
    q[10:] = 1.0
    q[9] = np.nan
    assert np.nanmax(np.abs(differentiate(t_s, q, np.zeros(7), 1, np.ones(7)).value)) == pytest.approx(5.0)
    steady = np.repeat(3.0 * t_s[:, None], 7, axis=1)
    steady[1::2] = np.nan
    d = differentiate(t_s, steady, np.zeros(7), 1, np.ones(7))
    np.testing.assert_allclose(d.value[::2], 3.0)


def test_derivatives_of_unknown_values_are_unknown() -> None:
    for n in (0, 1, 5):
        d = differentiate(0.1 * np.arange(n), np.full((n, 7), np.nan), np.full(7, np.nan), 2, np.ones(7))
        assert d.value.shape == (n, 7)
        assert np.isnan(d.value).all()


def _wave(t_s: Array) -> Array:
    return np.sin(t_s[:, None] * np.linspace(0.5, 1.5, 7) + np.arange(7))


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("sigma", [0.003, 0.03])
def test_smoothing_brings_a_noisy_path_closer_to_the_true_one(sigma: float, even: bool) -> None:
    t_s = 0.05 * np.arange(200) if even else np.cumsum(np.random.default_rng(0).uniform(0.02, 0.08, 200))
    noisy = _wave(t_s) + sigma * np.random.default_rng(1).normal(size=(200, 7))
    error = smooth_path(t_s, noisy, np.full(7, sigma)) - _wave(t_s)
    assert error.std() < 0.45 * sigma
    assert np.diff(error, 2, axis=0).std() < 0.05 * np.sqrt(6) * sigma


def test_a_noisier_frame_has_less_weight_in_smoothing() -> None:
    t_s = 0.05 * np.arange(100)
    sigma = np.full((100, 7), 0.003)
    sigma[50] = 0.3
    q = _wave(t_s) + 0.003 * np.random.default_rng(0).normal(size=(100, 7))
    q[50] += 0.3
    assert np.abs(smooth_path(t_s, q, sigma)[50] - _wave(t_s)[50]).max() < 0.01
    assert np.abs(smooth_path(t_s, q, np.full(7, 0.003))[50] - _wave(t_s)[50]).max() > 0.05


def test_smoothing_changes_neither_clean_nor_unknown_values() -> None:
    t_s = 0.2 * np.arange(40)
    q = _wave(t_s)
    q[10:13] = np.nan
    for sigma in (np.zeros(7), np.full(7, 5e-5), np.full(7, np.nan)):
        np.testing.assert_array_equal(smooth_path(t_s, q, sigma), q)
    smoothed = smooth_path(t_s, q, np.full(7, 0.01))
    np.testing.assert_array_equal(np.isnan(smoothed), np.isnan(q))


def test_smoothing_keeps_parabolas_and_joints_without_noise() -> None:
    t_s = _uneven()
    q = 1.0 + t_s[:, None] * np.linspace(-1, 1, 7) + t_s[:, None] ** 2 * np.linspace(1, -2, 7)
    sigma = np.full(7, 0.5)
    sigma[3] = 0.0
    np.testing.assert_allclose(smooth_path(t_s, q, sigma), q, atol=1e-6)


def test_residuals_of_smoothing_are_as_large_as_the_noise() -> None:
    """The residuals are about as large as the noise, not larger."""
    t_s = 0.05 * np.arange(400)
    noisy = _wave(6.0 * t_s) + 0.02 * np.random.default_rng(0).normal(size=(400, 7))
    residual = noisy - smooth_path(t_s, noisy, np.full(7, 0.02))
    assert 0.8 * 0.02 < residual.std() < 1.05 * 0.02
