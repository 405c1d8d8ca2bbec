import numpy as np
import pytest

from benchmarks.sweep import REACH_M, all_postures, least_bend, least_excess, least_step, postures, wrist_distance
from kinebench_drake.geometry import make_pose


@pytest.fixture
def drawn(arm):
    return np.random.default_rng(1).uniform(arm.plant.lower, arm.plant.upper, (300, 7))


def test_the_closed_form_misses_no_posture_of_a_pose(arm, drawn):
    """The closed form misses none: the proofs by sweeps stand on this."""
    for q in drawn:
        found = all_postures(arm.plant, arm.plant.forward(q), q[6:])[0]
        assert np.nanmin(np.abs(found - q).max(axis=-1)) < 1e-6


def test_every_posture_of_the_closed_form_reaches_its_pose(arm, drawn):
    for q in drawn[:50]:
        X = arm.plant.forward(q)
        found = all_postures(arm.plant, X, np.linspace(-3.0, 3.0, 50)).reshape(-1, 7)
        found = found[np.isfinite(found[:, 0])]
        np.testing.assert_allclose(arm.body.forward(found), np.broadcast_to(X, (len(found), 4, 4)), atol=1e-7)


def test_the_sweep_has_a_posture_within_2_mrad_of_any_other(arm, drawn):
    distance = [np.abs(postures(arm, arm.plant.forward(q)) - q).max(axis=-1).min() for q in drawn[:50]]
    assert np.median(distance) < 2e-3


def test_no_posture_reaches_beyond_the_wrists_sphere(arm, drawn):
    X_BG = arm.body.forward(drawn)
    links = arm.body.links(drawn)
    wrist = (links[:, 5] @ np.append(arm.body.points[4], 1.0))[:, :3]  # joint 5's axis passes the wrist
    shoulder = np.array([0.0, 0.0, 0.333])
    assert (wrist_distance(X_BG) <= REACH_M + 1e-9).all()
    stretched = arm.plant.forward([0.3, 0.5, -0.7, -0.467, 0.2, 1.6, 0.1])
    assert wrist_distance(stretched) <= REACH_M
    assert np.linalg.norm(wrist - shoulder, axis=-1).max() <= REACH_M + 1e-2


def test_beyond_the_wrists_sphere_no_posture_exists(arm):
    X = make_pose(np.diag([1.0, -1.0, -1.0]), [0.9, 0.0, 0.4])
    assert wrist_distance(X) > REACH_M
    assert least_excess(arm, X) is None


def test_a_pose_of_a_posture_within_limits_has_no_excess(arm, drawn):
    excess = [least_excess(arm, arm.plant.forward(q)) for q in drawn[:20]]
    assert max(excess) < 2e-3  # the sweep may miss the posture itself by half a step


def test_the_least_step_is_at_most_the_step_of_an_existing_path(arm):
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = arm.plant.robot.rest_q + rng.normal(0.0, 0.2, 7)
        dq = rng.normal(0.0, 0.2, 7)
        known = np.abs(dq / arm.plant.velocity_limits).max() / 0.2
        found = least_step(arm, arm.plant.forward(q), arm.plant.forward(q + dq), 0.2)
        assert found <= known + 0.02
    half_turn = arm.plant.forward(arm.plant.robot.rest_q)
    turned = half_turn @ make_pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    assert least_step(arm, half_turn, turned, 0.2) > 2.0


def test_the_least_bend_is_at_most_the_bend_of_an_existing_path(arm):
    q = arm.plant.robot.rest_q
    steps = 0.5 * arm.plant.acceleration_limits * 0.2**2 * np.array([1, 0, 0, 0.5, 0, 0, 0])
    X = [arm.plant.forward(x) for x in (q, q, q + steps)]
    assert least_bend(arm, np.array(X), 0.2) <= 0.55
    far = X[0].copy()
    far[:3, 3] += [0.0, 0.3, 0.0]
    assert least_bend(arm, np.array([X[0], far, X[0]]), 0.2) > 1.2
