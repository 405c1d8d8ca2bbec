import numpy as np
import pytest

from kinebench_drake.geometry import pose_difference
from kinebench_drake.kinematics import path as path_search
from kinebench_drake.kinematics.path import find_cheapest_path, limit_excess, search_path, select_anchors, speed_ratios
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import NumericSolver, posture_solver
from kinebench_drake.models.panda.description import rest_q
from tests.kinematics.motions import poses_of, random_path


def test_layers_without_a_posture_are_skipped(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    layers = [rng.uniform(plant.lower - 0.1, plant.upper + 0.1, size=(n, 7)) for n in (3, 9, 1, 0, 6, 12, 2)]
    t_s = np.cumsum(rng.uniform(0.2, 1.0, len(layers)))
    path = find_cheapest_path(plant, t_s, layers, rest_q(), spacing=0.1, noise_rad=0.01)
    assert list(np.flatnonzero(np.isnan(path[:, 0]))) == [3]


def test_the_cheapest_path_equals_exhaustive_search(plant: ArmPlant) -> None:
    """Against every combination of three layers."""
    rng = np.random.default_rng(0)
    t_s = np.array([0.0, 0.3, 0.5])
    layers = [rest_q() + rng.normal(0.0, 0.1, size=(k, 7)) for k in (4, 5, 3)]
    path = find_cheapest_path(plant, t_s, layers, rest_q(), spacing=0.1)

    def cost(a: int, b: int, c: int) -> float:
        q = np.array([layers[0][a], layers[1][b], layers[2][c]])
        ratio = speed_ratios(plant, t_s, q).max(axis=-1)
        pull = 1e-2 * np.sum((q[0] - rest_q()) ** 2) + 1e-3 * np.sum((q - rest_q()) ** 2)
        return float(np.sum(ratio**2 + 4 * ratio**8) + pull)

    best = min(((a, b, c) for a in range(4) for b in range(5) for c in range(3)), key=lambda k: cost(*k))
    np.testing.assert_array_equal(path, [layer[k] for layer, k in zip(layers, best, strict=True)])


def test_empty_layers_are_bridged(plant: ArmPlant) -> None:
    layers = [rest_q()[None], np.zeros((0, 7)), rest_q()[None] + 0.1]
    path = find_cheapest_path(plant, np.arange(3.0), layers, rest_q(), spacing=0.1)
    assert np.isnan(path[1]).all()
    np.testing.assert_array_equal(path[[0, 2]], [rest_q(), rest_q() + 0.1])


def test_redundancy_keeps_joint_speeds_below_their_limits(plant: ArmPlant) -> None:
    """Joint 7 alone turns the gripper too fast: with the whole arm's help the turn is possible."""
    q = np.tile([0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.0], (15, 1))
    q[:, 6] = np.linspace(-1.4, 1.4, 15)
    X_BG = poses_of(plant, q)
    t_s = 0.95 * 0.2 / 2.61 * np.arange(15)
    assert speed_ratios(plant, t_s, q).max() > 1.0
    path = search_path(plant, t_s, X_BG, q[0])
    assert speed_ratios(plant, t_s, path).max() <= 1.0
    assert max(d.max() for d in pose_difference(poses_of(plant, path), X_BG)) < 1e-9


@pytest.mark.parametrize("period", [0.02, 0.2, 1.0])
def test_anchors_keep_their_spacing_and_include_both_ends(period: float) -> None:
    t_s = period * np.arange(40)
    chosen = select_anchors(t_s, 0.15)
    assert chosen[0] == 0
    assert chosen[-1] == 39
    assert (np.diff(t_s[chosen[:-1]]) >= 0.15 - 1e-9).all()
    assert list(select_anchors(t_s[:1], 0.15)) == [0]


def test_the_numeric_solver_agrees_with_the_analytic_one(plant: ArmPlant, monkeypatch: pytest.MonkeyPatch) -> None:
    """What serves arms without a closed form, tried on the Panda, whose postures are known."""
    q = random_path(12, seed=2)
    X_BG = poses_of(plant, q)
    t_s = 0.2 * np.arange(12)
    numeric = NumericSolver(plant)
    closed = posture_solver(plant)
    cross = np.einsum("ti,ti->t", numeric.direction(X_BG, q), closed.direction(X_BG, q))
    np.testing.assert_allclose(np.abs(cross), 1.0, atol=1e-6)
    np.testing.assert_allclose(numeric.nearest(X_BG, q), q, atol=1e-6)
    monkeypatch.setattr(path_search, "posture_solver", lambda plant: numeric)
    path = search_path(plant, t_s, X_BG, q[0])
    assert max(d.max() for d in pose_difference(poses_of(plant, path), X_BG)) < 1e-6
    assert limit_excess(plant, path).max() == 0.0
    assert speed_ratios(plant, t_s, path).max() < 1.0
