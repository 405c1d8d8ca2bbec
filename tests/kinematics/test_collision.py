from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.geometry.optimization import VPolytope
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from kinebench_drake.errors import UsageError
from kinebench_drake.kinematics.collision import TABLE, CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import rest_q

FOLDED = np.array([0.0, -1.2, 0.0, -3.05, 0.0, 0.3, 0.785])
"""The forearm folded onto the upper arm, the gripper turned back into the shoulder."""


@pytest.fixture(scope="module")
def model(plant: ArmPlant) -> CollisionModel:
    return CollisionModel(plant)


def _random(plant: ArmPlant, n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(plant.lower, plant.upper, size=(n, 7))


def _nearest_by_pair(
    model: CollisionModel, q: np.ndarray, within_m: float, width: float | None = None
) -> dict[tuple[str, str], float]:
    nearest: dict[tuple[str, str], float] = {}
    for p in model.near_pairs(q, within_m, width):
        nearest.setdefault((p.link_a, p.link_b), p.distance_m)
    return nearest


def test_the_rest_posture_is_free_of_self_collision_and_a_folded_arm_is_not(model: CollisionModel) -> None:
    clearance = model.self_distance(np.array([rest_q(), FOLDED]))
    assert clearance.distance_m[0] > 0.1
    assert clearance.distance_m[1] < -0.01
    assert clearance.pair[1] is not None
    assert clearance.pair[1][1].startswith("panda_")


def test_near_pairs_contain_no_allowed_pair(plant: ArmPlant, model: CollisionModel) -> None:
    for q in _random(plant, 30):
        pairs = [frozenset((p.link_a, p.link_b)) for p in model.near_pairs(q, 10.0)]

        assert not plant.allowed_pairs & set(pairs)
        assert all(len(pair) == 2 for pair in pairs)


def test_least_distance_is_that_of_the_nearest_pair(plant: ArmPlant, model: CollisionModel) -> None:
    q = _random(plant, 50)
    itself = model.self_distance(q)
    table = model.table_distance(q)
    for i, row in enumerate(q):
        nearest = _nearest_by_pair(model, row, 10.0)
        tables = {pair: d for pair, d in nearest.items() if pair[1] == TABLE}
        links = {pair: d for pair, d in nearest.items() if pair[1] != TABLE}
        assert itself.distance_m[i] == pytest.approx(min(links.values()), abs=1e-9)
        assert links[itself.pair[i]] == pytest.approx(itself.distance_m[i], abs=1e-9)
        assert table.distance_m[i] == pytest.approx(min(tables.values()), abs=1e-12)
        assert tables[table.pair[i]] == pytest.approx(table.distance_m[i], abs=1e-12)


def test_distance_gradients_are_finite_differences(plant: ArmPlant, model: CollisionModel) -> None:
    h = 1e-6
    errors = []
    penetrating = 0
    for q in _random(plant, 25, seed=3):
        first = {}
        for p in model.near_pairs(q, 0.3):
            first.setdefault((p.link_a, p.link_b), p)
        slopes = {pair: np.zeros(7) for pair in first}
        for j in range(7):
            step = h * np.eye(7)[j]
            ahead, behind = (_nearest_by_pair(model, q + s, 0.4) for s in (step, -step))
            for pair, slope in slopes.items():
                slope[j] = (ahead[pair] - behind[pair]) / (2 * h)
        errors += [float(np.abs(first[pair].gradient - slopes[pair]).max()) for pair in first]
        penetrating += sum(p.distance_m < 0 for p in first.values())
    assert penetrating >= 3
    assert np.quantile(errors, 0.99) < 1e-5  # beyond: the nearest points jump within the step


def _by_optimisation(query: Any, pair: Any) -> float:
    """Distance of two of Drake's geometries as a quadratic program over their vertices' weights."""
    program = MathematicalProgram()
    a = program.NewContinuousVariables(3)
    b = program.NewContinuousVariables(3)
    VPolytope(query, pair.id_A).AddPointInSetConstraints(program, a)
    VPolytope(query, pair.id_B).AddPointInSetConstraints(program, b)
    Q = 2.0 * np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
    program.AddQuadraticCost(Q, np.zeros(6), [*a, *b], is_convex=True)
    result = ClarabelSolver().Solve(program)
    assert result.is_success()
    return float(np.linalg.norm(result.GetSolution(a) - result.GetSolution(b)))


def test_self_distance_is_exact_if_drakes_iteration_stops_early(plant: ArmPlant, model: CollisionModel) -> None:
    q = _random(plant, 4000, seed=11)
    ours = model.self_distance(q).distance_m
    raw = np.empty(len(q))
    for i, row in enumerate(q):
        query = plant.query(row)
        pairs = query.ComputeSignedDistancePairwiseClosestPoints(0.2)
        raw[i] = min(pair.distance for pair in pairs)
        if raw[i] - ours[i] > 1e-5 or (i < 10 and raw[i] > 0.01):
            near = [pair for pair in pairs if pair.distance < raw[i] + 0.02]
            assert ours[i] == pytest.approx(min(_by_optimisation(query, pair) for pair in near), abs=1e-6)
    assert (ours <= raw).all()
    assert (raw - ours > 1e-5).any()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("speed", [0.02, 0.2, 2.0])
def test_least_distances_along_a_motion_equal_those_of_every_posture(
    plant: ArmPlant, model: CollisionModel, seed: int, speed: float
) -> None:
    start, end = _random(plant, 2, seed=seed)
    q = start + speed * np.linspace(0.0, 1.0, 101)[:, None] * (end - start)
    width = np.linspace(0.0, 0.08, 101)
    every = model.self_distance(q, width).distance_m
    found = model.least_distances(q, width, 4, 0.03)
    wanted = every <= max(every.min(), 0.03) + 1e-9
    np.testing.assert_allclose(found[wanted], every[wanted], atol=1e-9)
    np.testing.assert_allclose(found[np.isfinite(found)], every[np.isfinite(found)], atol=1e-9)
    np.testing.assert_allclose(found[::4], every[::4], atol=1e-9)
    if speed < 0.1 and every.min() > 0.03:
        assert np.isnan(found).mean() > 0.3


def test_distances_are_continuous_along_a_motion(plant: ArmPlant, model: CollisionModel) -> None:
    """No point of the arm moves faster than its reach (1.2 m) times the rate of the joints, nor do two approach."""
    start, end = _random(plant, 2, seed=5)
    q = start + np.linspace(0.0, 1.0, 400)[:, None] * (end - start)
    step = np.abs(np.diff(q, axis=0)).sum(axis=-1)
    for clearance in (model.self_distance(q), model.table_distance(q)):
        assert (np.abs(np.diff(clearance.distance_m)) <= 2 * 1.2 * step).all()


def test_table_distance_does_not_depend_on_joint_1(plant: ArmPlant, model: CollisionModel) -> None:
    q = _random(plant, 20)
    turned = q.copy()
    turned[:, 0] = 0.3
    np.testing.assert_allclose(model.table_distance(q).distance_m, model.table_distance(turned).distance_m, atol=1e-12)


def test_raising_the_table_lowers_the_table_distance_by_the_same_amount(plant: ArmPlant, model: CollisionModel) -> None:
    q = _random(plant, 20)
    raised = CollisionModel(plant, table_height_m=0.123).table_distance(q)
    assert raised.pair == model.table_distance(q).pair
    np.testing.assert_allclose(raised.distance_m, model.table_distance(q).distance_m - 0.123, atol=1e-12)


def test_table_distance_is_the_lowest_vertex_of_the_posed_meshes(plant: ArmPlant, model: CollisionModel) -> None:
    """Reference: the converted meshes read as text, carried by Drake's link poses; finger tips by their box."""
    meshes = {f"panda_link{i}": f"collision_link{i}.obj" for i in range(1, 8)} | {"panda_hand": "collision_hand.obj"}
    tip = np.array([[x, y, 0.0545] for x in (-0.00875, 0.00875) for y in (-0.00002, 0.01518)])
    points = {"panda_leftfinger": tip, "panda_rightfinger": tip * [1.0, -1.0, 1.0]}
    for link, file in meshes.items():
        lines = (Path(plant.robot.urdf).parent / file).read_text().splitlines()
        points[link] = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64)
    for q in _random(plant, 40, seed=7):
        poses = plant.link_poses(q)
        lowest = {link: float((p @ poses[link][2, :3]).min() + poses[link][2, 3]) for link, p in points.items()}
        clearance = model.table_distance(q[None])
        assert clearance.pair[0] is not None
        link = clearance.pair[0][0]
        if "finger" not in link:
            assert link == min(lowest, key=lambda name: lowest[name])
            assert clearance.distance_m[0] == pytest.approx(lowest[link], abs=1e-9)
        else:  # the knuckle's boxes may be lower than the tip's
            assert clearance.distance_m[0] <= min(lowest.values()) + 1e-9


def test_gripper_pointing_down_touches_the_table_with_its_finger_tips(plant: ArmPlant, model: CollisionModel) -> None:
    """The finger's boxes end 54.5 mm below its joint, which lies 58.4 mm below the hand: 9.5 mm below the TCP."""
    q = rest_q()
    q[1] += 0.25
    q[5] += 0.25 - 1e-3
    clearance = model.table_distance(q[None])
    X_BG = plant.forward(q)
    assert X_BG[2, 3] < 0.1
    assert clearance.pair[0] is not None
    assert clearance.pair[0][0] in ("panda_leftfinger", "panda_rightfinger")
    assert clearance.distance_m[0] == pytest.approx(X_BG[2, 3] - 0.0095, abs=5e-5)


def test_links_fixed_to_the_base_may_stand_on_the_table(plant: ArmPlant) -> None:
    model = CollisionModel(plant, table_height_m=0.1)
    assert model.table_distance(rest_q()[None]).distance_m[0] > 0.03
    assert all(p.link_a != "panda_link0" for p in model.near_pairs(rest_q(), 10.0) if p.link_b == TABLE)


def test_opening_the_gripper_moves_each_finger_by_half_the_width(plant: ArmPlant, model: CollisionModel) -> None:
    for q in _random(plant, 20):
        shut, open_ = (_nearest_by_pair(model, q, 10.0, width) for width in (0.0, 0.08))
        rise = 0.04 * plant.forward(q)[2, 1]  # the left finger opens along the hand's y
        for link, sign in (("panda_leftfinger", 1.0), ("panda_rightfinger", -1.0)):
            assert open_[link, TABLE] - shut[link, TABLE] == pytest.approx(sign * rise, abs=1e-12)
        assert open_["panda_hand", TABLE] == shut["panda_hand", TABLE]


def test_unknown_postures_have_no_distance_and_unknown_widths_default_to_the_plants(
    plant: ArmPlant, model: CollisionModel
) -> None:
    q = np.tile(rest_q(), (3, 1))
    q[1, 2] = np.nan
    for measure in (model.self_distance, model.table_distance):
        clearance = measure(q, np.array([0.08, 0.08, np.nan]))
        np.testing.assert_array_equal(np.isnan(clearance.distance_m), [False, True, False])
        assert clearance.pair[1] is None
        assert clearance.distance_m[0] == clearance.distance_m[2]
        nothing = measure(np.empty((0, 7)))
        assert len(nothing.distance_m) == len(nothing.pair) == 0
        assert np.isnan(measure(np.full((2, 7), np.nan)).distance_m).all()


def test_near_pairs_default_to_the_plants_finger_width(model: CollisionModel) -> None:
    known, unknown = (_nearest_by_pair(model, rest_q(), 1.0, width) for width in (None, np.nan))
    assert known == unknown


def test_wrong_shapes_and_an_infinite_table_height_are_refused(model: CollisionModel, plant: ArmPlant) -> None:
    for measure in (model.self_distance, model.table_distance):
        with pytest.raises(UsageError, match="2 rows"):
            measure(np.tile(rest_q(), (2, 1)), np.zeros(3))
    with pytest.raises(UsageError, match="expected"):
        model.near_pairs(np.zeros((2, 7)), 0.1)
    with pytest.raises(UsageError, match="finite"):
        CollisionModel(plant, table_height_m=np.nan)
