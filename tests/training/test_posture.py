import numpy as np
import pytest

from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import panda
from training.posture import PostureSampler

PERIOD_S = 0.1
PAYLOAD_M = 0.021


@pytest.fixture(scope="module")
def postures() -> PostureSampler:
    arm = ArmPlant(panda())
    return PostureSampler(lower=arm.lower, upper=arm.upper, link_poses=arm.link_poses, table_z=-0.1)


@pytest.mark.parametrize("seed", range(6))
def test_training_motions_stay_within_limits_and_above_the_table(postures: PostureSampler, seed: int) -> None:
    motion = postures.draw_motion(np.random.default_rng(seed), PERIOD_S, PAYLOAD_M)
    assert (motion.q >= postures.lower).all()
    assert (motion.q <= postures.upper).all()
    assert np.mean([postures.clears_table(q) for q in motion.q]) > 0.95
    assert np.abs(np.diff(motion.q, axis=0)).max() < 1.5 * 1.5 * PERIOD_S + 1e-6
    assert (motion.finger_m >= 0).all()
    assert (motion.finger_m <= 0.04).all()


def test_fingers_stay_at_the_payload_width_while_grasping(postures: PostureSampler) -> None:
    motions = [postures.draw_motion(np.random.default_rng(seed), PERIOD_S, PAYLOAD_M) for seed in range(8)]
    held = [motion for motion in motions if motion.holds.any()]
    assert held
    for motion in held:
        np.testing.assert_allclose(motion.finger_m[motion.holds], PAYLOAD_M, atol=1e-12)
        assert (np.diff(np.flatnonzero(motion.holds)) == 1).all()
