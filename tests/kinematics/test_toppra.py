import numpy as np
import pytest
from pydrake.multibody.optimization import Toppra, ToppraDiscretization
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline
from scipy.optimize import linprog

from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.timing import PathLimits, _PathMotion, fastest_rates
from kinebench_drake.models.panda.description import rest_q

ENDS = 1.0, 1.0


def _drakes_rates(plant: ArmPlant, t: np.ndarray, q: np.ndarray, grid: np.ndarray) -> np.ndarray | None:
    """Return ds/dt (G,) by Drake's Toppra; its solver needs (ds/dt)^2 of the order of 1e4."""
    stretch = 100.0
    spline = CubicSpline(t, q)
    n = plant.drake.num_velocities()
    rates = np.zeros((len(t), n))
    rates[:, plant.arm_rates] = spline(t, 1) / stretch
    path = PiecewisePolynomial.CubicHermite(stretch * t, plant.positions(spline(t)).T, rates.T)
    toppra = Toppra(path, plant.drake, stretch * grid)
    speed, acceleration, torque = (np.full(n, 1e9) for _ in range(3))
    speed[plant.arm_rates] = plant.velocity_limits
    torque[plant.arm_rates] = plant.effort_limits
    acceleration[plant.arm_rates] = plant.acceleration_limits
    toppra.AddJointVelocityLimit(-speed, speed)
    toppra.AddJointAccelerationLimit(-acceleration, acceleration, ToppraDiscretization.kInterpolation)
    toppra.AddJointTorqueLimit(-torque, torque, ToppraDiscretization.kInterpolation)
    s = toppra.SolvePathParameterization(*(stretch * end for end in ENDS))
    return None if s is None else np.array([s.EvalDerivative(x, 1)[0, 0] for x in s.get_segment_times()]) / stretch


@pytest.mark.parametrize("seed", range(8))
def test_path_rates_equal_drakes_toppra(plant: ArmPlant, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0.0, 6.0, 30))
    t -= t[0]
    q = rest_q() + 0.2 * np.sin(rng.uniform(0.3, 1.5, 7) * t[:, None] + rng.uniform(0.0, 6.0, 7))
    motion = _PathMotion(plant, t, q, np.arange(len(t)))
    ours = fastest_rates(motion.limits, *ENDS)
    drakes = _drakes_rates(plant, t, q, motion.grid)
    assert ours is not None
    assert drakes is not None
    np.testing.assert_allclose(ours, drakes, rtol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_path_rates_are_the_optimum_of_one_linear_program(seed: int) -> None:
    """The fastest s(t) is fastest at every point, so that it maximises the sum of (ds/dt)^2."""
    rng = np.random.default_rng(seed)
    n = 25
    rows = 5
    s = np.cumsum(rng.uniform(0.05, 0.15, n))
    limits = PathLimits(
        s=s,
        fastest=rng.uniform(2.0, 6.0, n),
        slope=np.sin(s[:, None] * rng.uniform(0.5, 2.0, rows) + rng.uniform(0.0, 6.0, rows)),
        bend=0.2 * rng.standard_normal((n, rows)),
        rest=0.3 * rng.uniform(-1.0, 1.0, (n, rows)),
    )
    difference = (np.eye(n)[1:] - np.eye(n)[:-1]) / (2.0 * np.diff(s)[:, None])
    near = limits.slope[:-1, :, None] * difference[:, None] + limits.bend[:-1, :, None] * np.eye(n)[:-1, None]
    far = limits.slope[1:, :, None] * difference[:, None] + limits.bend[1:, :, None] * np.eye(n)[1:, None]
    A = np.vstack([near.reshape(-1, n), far[:-1].reshape(-1, n)])
    rest = np.concatenate([limits.rest[:-1].ravel(), limits.rest[1:-1].ravel()])
    bounds = np.stack([np.zeros(n), limits.fastest**2], axis=-1)
    bounds[[0, -1]] = 0.25, 0.25
    best = linprog(-np.ones(n), np.vstack([A, -A]), np.concatenate([1.0 - rest, 1.0 + rest]), bounds=bounds)
    rate = fastest_rates(limits, 0.5, 0.5)
    assert (rate is None) == (not best.success)
    if rate is not None:
        np.testing.assert_allclose(rate**2, best.x, atol=1e-6)


def test_an_end_rate_that_cannot_be_reached_gives_no_solution() -> None:
    """From rest with d2s/dt2 of at most 1 - s over 1 m: (ds/dt)^2 = 1 in the end."""
    s = np.linspace(0.0, 1.0, 101)[:, None]
    limits = PathLimits(s=s[:, 0], fastest=np.full(101, 9.0), slope=np.ones_like(s), bend=np.zeros_like(s), rest=s)
    assert fastest_rates(limits, 0.0, 0.98) is not None
    assert fastest_rates(limits, 0.0, 1.02) is None
