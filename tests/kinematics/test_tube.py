import numpy as np
import pytest

from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.tube import DistanceBound, LimitSet, PoseLinearisation, solve_tube

FRAMES = 21
DURATION_S = 2.0
SPEED = 0.5


@pytest.fixture
def basis() -> SplineBasis:
    return SplineBasis.through(np.linspace(0.0, DURATION_S, FRAMES))


def _rail(wanted_m: np.ndarray) -> PoseLinearisation:
    """A tool whose x is joint 1 and whose other coordinates are fixed, wanted at x = `wanted_m` (T,)."""
    J = np.zeros((FRAMES, 6, 7))
    J[:, 3, 0] = 1.0
    e = np.zeros((FRAMES, 6))
    e[:, 3] = wanted_m
    return PoseLinearisation(t_s=np.linspace(0.0, DURATION_S, FRAMES), q=np.zeros((FRAMES, 7)), J=J, e=e)


def _limits(speed: float | None = SPEED, acceleration: float | None = None) -> LimitSet:
    return LimitSet(
        lower=np.full(7, -10.0),
        upper=np.full(7, 10.0),
        rates=(
            None if speed is None else np.full(7, speed),
            None if acceleration is None else np.full(7, acceleration),
            None,
        ),
    )


def test_a_ramp_at_twice_the_speed_limit_needs_half_of_its_excess_as_radius(basis: SplineBasis) -> None:
    """The best is a ramp at the limit through the middle: the excess of the ends is shared between them."""
    poses = _rail(2.0 * SPEED * np.linspace(0.0, DURATION_S, FRAMES))
    solution = solve_tube(basis, poses, _limits(), radius_m=None, proximity=1e-6)
    assert solution is not None
    assert solution.radius_m == pytest.approx(0.5 * SPEED * DURATION_S, rel=1e-4)
    assert (np.abs(basis.derivatives[1] @ solution.control) <= SPEED).all()
    np.testing.assert_allclose(basis.evaluate(solution.control, np.array([1.0]))[0, 0], SPEED * DURATION_S, atol=1e-4)


def test_a_parabola_at_twice_the_acceleration_limit_has_the_chebyshev_radius(basis: SplineBasis) -> None:
    """Wanted a t^2 / 2 at twice the limit: the rest, L t^2 / 2, is fitted best by a line: Chebyshev, L T^2 / 16."""
    t = np.linspace(0.0, DURATION_S, FRAMES)
    solution = solve_tube(basis, _rail(t**2), _limits(None, 1.0), radius_m=None, proximity=1e-6)
    assert solution is not None
    assert solution.radius_m == pytest.approx(DURATION_S**2 / 16.0, rel=1e-3)


def test_a_fixed_radius_is_feasible_above_the_least_and_infeasible_below(basis: SplineBasis) -> None:
    poses = _rail(2.0 * SPEED * np.linspace(0.0, DURATION_S, FRAMES))
    least = 0.5 * SPEED * DURATION_S
    assert solve_tube(basis, poses, _limits(), radius_m=0.999 * least, proximity=1e-3) is None
    solution = solve_tube(basis, poses, _limits(), radius_m=1.001 * least, proximity=1e-3)
    assert solution is not None
    deviation = basis.values(poses.t_s) @ solution.control[:, 0] - poses.e[:, 3]
    assert np.abs(deviation).max() <= 1.001 * least + 1e-6


def test_the_elastic_program_exceeds_the_speed_limit_by_the_excess_of_the_ramp(basis: SplineBasis) -> None:
    poses = _rail(2.0 * SPEED * np.linspace(0.0, DURATION_S, FRAMES))
    solution = solve_tube(basis, poses, _limits(), radius_m=1e-4, proximity=1e-3, elastic=True)
    assert solution is not None
    assert solution.radius_m == pytest.approx(1e-4, rel=0.01)
    np.testing.assert_allclose(solution.excess[0][4:-4, 0], 1.0, atol=0.02)  # the ends may cut their corners
    np.testing.assert_allclose(solution.excess[0][:, 1:], 0.0, atol=1e-5)
    assert solution.excess[1].size == 0


def test_the_radius_is_the_larger_of_rotation_and_position_errors(basis: SplineBasis) -> None:
    """Errors that no joint can remove: the greater of the two norms counts, not their sum."""
    poses = _rail(np.zeros(FRAMES))
    poses.J[:] = 0.0
    poses.e[7] = [0.003, 0.004, 0.0, 0.0, 0.0, 0.002]
    solution = solve_tube(basis, poses, _limits(), radius_m=None, proximity=1e-6)
    assert solution is not None
    assert solution.radius_m == pytest.approx(0.005, rel=1e-4)


def test_an_obstacle_keeps_the_trajectory_at_its_least_distance(basis: SplineBasis) -> None:
    poses = _rail(np.full(FRAMES, -0.02))
    gradient = np.eye(7)[0]
    wall = [
        DistanceBound(t_s=t, offset_m=0.0, gradient=gradient, least_m=-0.005) for t in np.linspace(0.0, DURATION_S, 41)
    ]
    solution = solve_tube(basis, poses, _limits(), radius_m=None, proximity=1e-6, obstacles=wall)
    assert solution is not None
    assert solution.radius_m == pytest.approx(0.015, rel=1e-3)
    assert basis.evaluate(solution.control, np.linspace(0.0, DURATION_S, 41))[:, 0].min() >= -0.005 - 1e-6


def test_the_trajectory_keeps_joint_limits(basis: SplineBasis) -> None:
    limits = LimitSet(lower=np.full(7, -0.1), upper=np.full(7, 0.1), rates=(np.full(7, SPEED), None, None))
    solution = solve_tube(basis, _rail(np.full(FRAMES, 0.13)), limits, radius_m=None, proximity=1e-6)
    assert solution is not None
    assert solution.radius_m == pytest.approx(0.03, rel=1e-3)
    assert solution.control.max() <= 0.1
