"""Commands for the robot: limits by finite differences, rest at both ends, the path of the track, or the reason."""

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.robot_commands import RobotCommands, limit_ratios, plan_commands
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.track import GripperTrack

RATE_HZ = 500.0
TUBE_M = 0.005


def swing(period_s: float, size_rad: float = 0.4, frames: int = 25) -> tuple[Array, Array]:
    """Times and postures of a motion that begins and ends at full speed."""
    x = np.linspace(0.0, 2.0 * np.pi, frames)
    return period_s * np.arange(frames), rest_q() + size_rad * np.sin(x)[:, None] * [1.0, 0.4, 0.7, 0.3, 1.0, 0.5, 1.0]


def commands_of(plant: ArmPlant, t_s: Array, q: Array, X_BG: Array | None = None) -> RobotCommands:
    X = plant.forward_path(q) if X_BG is None else X_BG
    n = len(q)
    track = GripperTrack(
        t_s=t_s, X_CH=np.full_like(X, np.nan), X_BG=X, tracked=np.ones(n, dtype=bool), confidence=np.ones(n),
        finger_width_m=np.linspace(0.0, 0.08, n),
    )  # fmt: skip
    return plan_commands(plant, CollisionModel(plant), track, q, rate_hz=RATE_HZ, tube_limit_m=TUBE_M)


@pytest.mark.parametrize("period_s", [0.2, 0.05, 0.01])
def test_commands_keep_limits_start_and_end_at_rest_and_reach_every_frame(plant: ArmPlant, period_s: float) -> None:
    t_s, q = swing(period_s)
    commands = commands_of(plant, t_s, q)
    c = commands.q
    dt = 1.0 / RATE_HZ
    assert (c >= plant.lower).all()
    assert (c <= plant.upper).all()
    padded = np.concatenate([np.repeat(c[:1], 3, axis=0), c, np.repeat(c[-1:], 3, axis=0)])
    limits = plant.robot.limits
    for order, limit in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        assert (np.abs(np.diff(padded, order, axis=0)) <= limit * dt**order).all()
    assert dict(limit_ratios(plant, c, RATE_HZ))["torque rate"].max() <= 1.0
    at = np.round(commands.frame_t_s * RATE_HZ).astype(int)
    position_m, _ = pose_difference(plant.forward_path(c[at]), plant.forward_path(q))
    assert position_m.max() < TUBE_M + 0.003  # frames lie between two commands
    assert (np.diff(commands.finger_width_m) >= -1e-12).all()


def test_a_motion_within_limits_is_not_slowed_and_one_beyond_them_is(plant: ArmPlant) -> None:
    assert commands_of(plant, *swing(0.2)).slower == 1.0
    assert commands_of(plant, *swing(0.01)).slower > 2.0


def test_ratios_are_those_of_the_derivatives_of_a_known_motion(plant: ArmPlant) -> None:
    rate_hz = 5000.0
    t = np.arange(0.0, 2.0 + 0.5 / rate_hz, 1.0 / rate_hz)[:, None]
    f = [np.sin(0.5 * np.pi * t) ** 8]  # smooth also at its ends, where the arm rests
    for _ in range(3):
        f.append(np.gradient(f[-1], 1.0 / rate_hz, axis=0))
    size = 0.2 * np.ones(7)
    q = rest_q() + f[0] * size
    v = f[1] * size
    a = f[2] * size
    torque = plant.chain.torques(q, v, a)
    limits = plant.robot.limits
    expected = {
        "velocity": np.abs(v).max(axis=0) / limits.velocity,
        "acceleration": np.abs(a).max(axis=0) / limits.acceleration,
        "jerk": np.abs(f[3] * size).max(axis=0) / limits.jerk,
        "torque": np.abs(torque).max(axis=0) / limits.torque,
        "torque rate": np.abs(np.gradient(torque, 1.0 / rate_hz, axis=0)).max(axis=0) / limits.torque_rate,
    }
    ratios = dict(limit_ratios(plant, q, rate_hz))
    for name, values in expected.items():
        np.testing.assert_allclose(ratios[name], values, rtol=1e-2)


def test_poses_out_of_reach_have_no_commands_and_the_reason_in_one_line(plant: ArmPlant) -> None:
    t_s, q = swing(0.2)
    X = plant.forward_path(q)
    X[10:15, :3, 3] += [0.0, 0.0, 0.9]
    with pytest.raises(InputError, match=r"no commands keep within 5 mm of the track: .*unreachable") as error:
        commands_of(plant, t_s, q, X)
    assert "\n" not in str(error.value)
