"""Commands follow the track within the limits of the robot and report where they cannot."""

import numpy as np
import pytest

from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import CONTROL_PERIOD_S
from kinebench_drake.suites.closed_loop.execution import LEAD_S, SQUEEZE_M, CommandPlanner, RejectionReason, RobotState
from kinebench_drake.suites.start import START_Q

FRAMES = 25
STEPS = 4
T_S = CONTROL_PERIOD_S * STEPS * np.arange(FRAMES)
START = RobotState(q=START_Q, finger_width_m=0.08, gripping=False)
SEEN = np.ones(FRAMES, dtype=bool)


@pytest.fixture(scope="module")
def plant() -> ArmPlant:
    return ArmPlant()


@pytest.fixture(scope="module")
def planner(plant: ArmPlant) -> CommandPlanner:
    return CommandPlanner(plant)


def along(plant: ArmPlant, way: Array, turn: float = 0.0) -> Array:
    """A smooth move (FRAMES, 4, 4) from the start by `way` (3,) [m], turning about the gripper's axis."""
    s = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, FRAMES))
    X = plant.forward(START_Q)
    return make_pose(X[:3, :3] @ rotation_exp(np.outer(s, [0.0, 0.0, turn])), X[:3, 3] + np.outer(s, way))


def test_each_pose_is_commanded_ahead_by_the_lag_of_the_servos(plant: ArmPlant, planner: CommandPlanner) -> None:
    X = along(plant, np.array([0.1, 0.1, -0.1]), 0.5)
    commands = planner.plan(X, np.full(FRAMES, 0.08), SEEN, T_S, START)
    assert commands.rejections == ()
    assert len(commands.q) == STEPS * (FRAMES - 1)
    ahead = round(LEAD_S / CONTROL_PERIOD_S)
    at_frames = commands.X_BG[STEPS - 1 - ahead :: STEPS][: FRAMES - 1]
    position, rotation = pose_difference(at_frames, X[1:])
    assert position.max() < 1e-5
    assert rotation.max() < 1e-4
    np.testing.assert_allclose(commands.X_BG[-1], X[-1], atol=1e-5)


def test_untracked_frames_are_bridged_and_reported_as_rejections(plant: ArmPlant, planner: CommandPlanner) -> None:
    X = along(plant, np.array([0.0, 0.12, 0.0]))
    broken = X.copy()
    tracked = SEEN.copy()
    broken[10:13] = np.nan
    tracked[10:13] = False
    commands = planner.plan(broken, np.full(FRAMES, 0.08), tracked, T_S, START)
    assert [(r.reason, r.frame_start, r.frame_end) for r in commands.rejections] == [
        (RejectionReason.NOT_TRACKED, 10, 12)
    ]
    whole = planner.plan(X, np.full(FRAMES, 0.08), SEEN, T_S, START)
    assert np.abs(commands.X_BG[:, :3, 3] - whole.X_BG[:, :3, 3]).max() < 2e-3


def test_commanded_joint_velocities_stay_within_limits(plant: ArmPlant, planner: CommandPlanner) -> None:
    X = along(plant, np.array([0.1, 0.0, 0.0]))
    X[12:, 1, 3] += 0.4  # a jump
    commands = planner.plan(X, np.full(FRAMES, 0.08), SEEN, T_S, START)
    rates = np.diff(np.concatenate([START_Q[None], commands.q]), axis=0) / CONTROL_PERIOD_S
    assert (np.abs(rates) <= plant.velocity_limits + 1e-9).all()
    assert {r.reason for r in commands.rejections} == {RejectionReason.SPEED}
    assert all(11 <= r.frame_start <= 14 for r in commands.rejections)
    np.testing.assert_allclose(commands.X_BG[-1], X[-1], atol=1e-4)


@pytest.mark.parametrize(
    ("way", "reason"),
    [((0.0, 0.0, -0.4), RejectionReason.TABLE_COLLISION), ((0.9, 0.0, 0.0), RejectionReason.UNREACHABLE)],
)
def test_unreachable_poses_and_table_collisions_are_rejected(
    plant: ArmPlant, planner: CommandPlanner, way: tuple[float, float, float], reason: RejectionReason
) -> None:
    commands = planner.plan(along(plant, np.array(way)), np.full(FRAMES, 0.08), SEEN, T_S, START)
    last = [r for r in commands.rejections if r.reason is reason]
    assert last
    assert last[-1].frame_end == FRAMES - 1
    assert commands.X_BG[:, 2, 3].min() > -0.05
    assert (commands.q >= plant.lower).all()
    assert (commands.q <= plant.upper).all()


def test_closed_fingers_squeeze_until_they_open(plant: ArmPlant, planner: CommandPlanner) -> None:
    X = along(plant, np.array([0.05, 0.0, 0.0]))
    gap = np.array([0.08] * 5 + [0.06, 0.042] + [0.04] * 10 + [0.06] + [0.08] * 7)
    noisy = gap + np.random.default_rng(0).normal(0.0, 5e-4, FRAMES)
    noisy[8] = np.nan
    commands = planner.plan(X, noisy, SEEN, T_S, START)
    held = commands.finger_width_m[8 * STEPS : 15 * STEPS]
    assert np.abs(held - (0.04 - SQUEEZE_M)).max() < 2e-3
    assert np.abs(commands.finger_width_m[20 * STEPS :] - 0.08).max() < 2e-3
    assert not commands.gripping
    assert planner.plan(X, np.full(FRAMES, 0.04), SEEN, T_S, START).gripping


def test_a_track_without_tracked_frames_is_refused(plant: ArmPlant, planner: CommandPlanner) -> None:
    X = along(plant, np.array([0.05, 0.0, 0.0]))
    with pytest.raises(UnmeasurableError, match="nothing to execute"):
        planner.plan(X, np.full(FRAMES, 0.08), np.zeros(FRAMES, dtype=bool), T_S, START)


def test_tracks_with_a_period_below_the_control_period_are_followed(plant: ArmPlant, planner: CommandPlanner) -> None:
    X = along(plant, np.array([0.05, 0.05, -0.05]))
    period = 1.0 / 30.0
    commands = planner.plan(X, np.full(FRAMES, 0.08), SEEN, period * np.arange(FRAMES), START)
    assert commands.rejections == ()
    assert commands.frame_steps[-1] == len(commands.q) == round(period * (FRAMES - 1) / CONTROL_PERIOD_S)
    np.testing.assert_allclose(commands.X_BG[-1], X[-1], atol=1e-5)


def test_an_opening_of_hidden_fingers_is_placed_where_the_hand_rests(plant: ArmPlant, planner: CommandPlanner) -> None:
    X = along(plant, np.array([0.0, 0.12, 0.0]))
    X = X[np.concatenate([np.arange(0, 12), np.full(5, 12), np.arange(13, 21)])]  # it waits in frames 12 to 16
    width = np.full(FRAMES, 0.04)
    width[8:22] = np.nan
    width[22:] = 0.08
    held = RobotState(q=START_Q, finger_width_m=0.04, gripping=False)
    commands = planner.plan(X, width, SEEN, T_S, held).finger_width_m
    at_s = CONTROL_PERIOD_S * np.arange(1, len(commands) + 1) + LEAD_S
    opening_s = at_s[np.flatnonzero(commands > 0.06)[0]]
    assert T_S[12] < opening_s <= T_S[17]
    assert commands.max() == pytest.approx(0.08)
    width[22:] = 0.042  # nothing happened
    assert planner.plan(X, width, SEEN, T_S, held).finger_width_m.max() < 0.043
