import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline

from kinebench_drake.kinematics.spline import SplineBasis


@pytest.fixture
def basis() -> SplineBasis:
    return SplineBasis(np.array([0.0, 0.1, 0.15, 0.4, 0.5, 0.9]))


def test_derivative_matrices_give_the_control_points_of_the_derivatives(basis: SplineBasis) -> None:
    control = np.random.default_rng(0).normal(size=(basis.size, 2))
    curve = BSpline(basis.knots, control, 3)
    t = np.linspace(0.0, 0.9, 200)[1:-1]
    for k, D in enumerate(basis.derivatives):
        knots = basis.knots[k : len(basis.knots) - k]
        np.testing.assert_allclose(BSpline(knots, D @ control, 3 - k)(t), curve(t, k), rtol=1e-9, atol=1e-9)


def test_curve_and_derivatives_lie_within_the_hull_of_their_control_points(basis: SplineBasis) -> None:
    control = np.random.default_rng(1).normal(size=(basis.size, 3))
    t = np.linspace(0.0, 0.9, 1000)
    for k, D in enumerate(basis.derivatives):
        value = basis.evaluate(control, t, k)
        hull = D @ control
        assert (value <= hull.max(axis=0) + 1e-9).all()
        assert (value >= hull.min(axis=0) - 1e-9).all()


def test_control_points_of_a_linear_derivative_are_its_values_at_the_centres(basis: SplineBasis) -> None:
    t = np.linspace(0.0, 0.9, 40)
    control = basis.fit(t, np.stack([t**3, t**2], axis=1), stiffness=0.0)
    for k, expected in ((1, 2 * basis.centres(1)), (2, np.full(basis.size - 2, 2.0))):  # of t^2
        np.testing.assert_allclose((basis.derivatives[k] @ control)[:, 1], expected, atol=1e-8)
    np.testing.assert_allclose((basis.derivatives[2] @ control)[:, 0], 6 * basis.centres(2), atol=1e-8)
    np.testing.assert_allclose((basis.derivatives[3] @ control)[:, 0], 6.0, atol=1e-6)
    assert len(basis.centres(3)) == basis.size - 3


def test_fit_passes_through_every_frame_with_least_acceleration() -> None:
    t = np.cumsum(np.random.default_rng(2).uniform(0.05, 0.1, 30))
    t -= t[0]
    q = np.sin(3.0 * t)[:, None]
    basis = SplineBasis.through(t)
    control = basis.fit(t, q)
    np.testing.assert_allclose(basis.values(t) @ control, q, atol=1e-6)
    # The interpolant of least acceleration is the natural cubic spline.
    dense = np.linspace(0.0, t[-1], 300)
    natural = CubicSpline(t, q, bc_type="natural")(dense)
    np.testing.assert_allclose(basis.evaluate(control, dense), natural, atol=2e-4)


def test_a_refined_basis_represents_the_same_curve(basis: SplineBasis) -> None:
    control = np.random.default_rng(3).normal(size=(basis.size, 2))
    finer = basis.refine()
    assert len(finer.breaks_s) == 2 * len(basis.breaks_s) - 1
    t = np.linspace(0.0, 0.9, 100)
    curve = basis.evaluate(control, t)
    np.testing.assert_allclose(finer.values(t) @ finer.fit(t, curve, stiffness=0.0), curve, atol=1e-9)


@pytest.mark.parametrize(
    "t",
    [
        np.array([0.0, 1.0]),
        np.array([0.0, 0.1, 0.2]),
        np.array([0.0, 0.1, 0.2, 0.2001, 0.3, 0.4, 2.0, 2.1, 2.2]),
        np.array([0.0, 0.1, 0.2, 0.3, 0.3001]),
        np.array([0.0, 1e-6, 0.1, 0.2]),
    ],
)
def test_breaks_follow_the_frames_with_close_ones_merged_and_gaps_filled(t: np.ndarray) -> None:
    basis = SplineBasis.through(t)
    spacing = np.median(np.diff(t))
    spans = np.diff(basis.breaks_s)
    assert basis.breaks_s[0] == 0.0
    assert basis.breaks_s[-1] == t[-1]
    assert (spans >= 0.24 * spacing).all()
    assert (spans <= 2.26 * spacing).all()
    assert basis.size == len(basis.breaks_s) + 2
