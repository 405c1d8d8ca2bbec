import numpy as np
import pytest

from benchmarks.planted import (
    DEPTH_M,
    JUMP_BEND,
    JUMP_STEP,
    LIMIT_EXCESS_RAD,
    OVERLAP_M,
    POSE_EXCESS_RAD,
    REACH_EXCESS_M,
    SPEED_RATIO,
)
from benchmarks.sweep import REACH_M, least_excess, least_step, wrist_distance
from benchmarks.trajectory import REASONS, TRUTH, TrajectoryKind, read_truths
from benchmarks.trajectory_sets import Recipe, TrajectorySet, draw, write_set


@pytest.fixture(scope="module")
def planted(arm):
    recipe = Recipe(set=TrajectorySet.INFEASIBLE, seed=4)
    pairs = [draw(recipe, i, arm) for i in range(7)]
    return {truth.kind: (trajectory, truth) for trajectory, truth in pairs}


def test_infeasible_trajectories_plant_every_kind_with_its_reason(planted):
    assert list(planted) == list(REASONS)
    for kind, (_, truth) in planted.items():
        assert truth.feasible is False
        assert truth.reasons == REASONS[kind]


def test_reach_trajectories_leave_the_wrists_sphere(planted):
    trajectory, _ = planted[TrajectoryKind.REACH]
    assert wrist_distance(trajectory.X_BG).max() - REACH_M >= 0.99 * REACH_EXCESS_M[0]


def test_fast_trajectories_exceed_the_least_step_at_velocity_limits(arm, planted):
    trajectory, truth = planted[TrajectoryKind.FAST]
    i = truth.parameters["step"]
    period = truth.parameters["period_s"]
    assert trajectory.t_s[i + 1] - trajectory.t_s[i] == pytest.approx(period)
    assert least_step(arm, *trajectory.X_BG[i : i + 2], period) >= SPEED_RATIO[0]


def test_table_trajectories_enter_the_table(arm, planted):
    trajectory, _ = planted[TrajectoryKind.TABLE]
    assert arm.body.lowest_of_gripper(trajectory.X_BG, trajectory.finger_width_m).min() <= -0.99 * DEPTH_M[0]


def test_teleport_trajectories_exceed_the_step_or_bend_ratio(planted):
    _, truth = planted[TrajectoryKind.TELEPORT]
    p = truth.parameters
    assert p["step_ratio"] >= JUMP_STEP or p["bend_ratio"] >= JUMP_BEND


def test_joint_limit_trajectories_exceed_a_position_limit(arm, planted):
    trajectory, _ = planted[TrajectoryKind.LIMIT_Q]
    past = np.maximum(arm.plant.lower - trajectory.q, trajectory.q - arm.plant.upper).max()
    assert past >= 0.99 * LIMIT_EXCESS_RAD[0]


def test_self_collision_trajectories_overlap_within_joint_limits(arm, planted):
    trajectory, truth = planted[TrajectoryKind.SELF_Q]
    frames = range(truth.parameters["frame_start"], truth.parameters["frame_end"] + 1)
    depths = [
        -pair.distance
        for i in frames
        for pair in arm.plant.query(
            trajectory.q[i], trajectory.finger_width_m[i]
        ).ComputeSignedDistancePairwiseClosestPoints(0.0)
    ]
    assert max(depths) >= OVERLAP_M
    assert ((trajectory.q >= arm.plant.lower) & (trajectory.q <= arm.plant.upper)).all()


def test_limit_pose_trajectories_exceed_limits_in_every_posture(arm, planted):
    trajectory, truth = planted[TrajectoryKind.LIMIT_POSE]
    finer = least_excess(arm, trajectory.X_BG[truth.parameters["frame"]], 3 * 4096)
    assert 0.5 * POSE_EXCESS_RAD < finer <= truth.parameters["excess_rad"] + 1e-9


def test_noisy_trajectories_are_feasible_ones_with_noise_of_the_requested_size(arm):
    noisy, truth = draw(Recipe(set=TrajectorySet.NOISY, seed=4, noise_m=3e-3, noise_rad=0.02), 0, arm)
    clean, _ = draw(Recipe(set=TrajectorySet.FEASIBLE, seed=4), 0, arm)
    assert truth.feasible is True
    off = noisy.X_BG[:, :3, 3] - clean.X_BG[:, :3, 3]
    assert off.std() == pytest.approx(3e-3, rel=0.3)
    assert noisy.q is None


def test_trajectories_of_one_seed_have_the_same_bytes(tmp_path):
    recipe = Recipe(set=TrajectorySet.INFEASIBLE, seed=5)
    first = list(write_set(recipe, 3, tmp_path / "a"))
    list(write_set(recipe, 2, tmp_path / "b"))
    for path in (tmp_path / "b").glob("*.npz"):
        assert path.read_bytes() == (tmp_path / "a" / path.name).read_bytes()
    list(write_set(Recipe(set=TrajectorySet.INFEASIBLE, seed=6), 1, tmp_path / "c"))
    assert (tmp_path / "c" / "reach-00000.npz").read_bytes() != (tmp_path / "a" / "reach-00000.npz").read_bytes()
    assert read_truths(tmp_path / "a" / TRUTH) == {truth.id: truth for truth in first}
