"""Joints of lids, drawers and handles: pushed, they stop soon."""

from collections.abc import Sequence

import numpy as np
import pytest

from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.simulator import Simulator

FAUCETS = [
    next(seed for seed in range(200) if int(compose("OpenFaucet-v1", seed).assets["faucet"][-2:]) % 6 == shape)
    for shape in range(6)
]
"""Seeds of faucets of each shape."""


@pytest.mark.sapien
@pytest.mark.parametrize(
    ("task", "name", "seeds", "speeds", "farthest", "tolerance"),  # rad/s and rad, of drawers m/s and m
    [
        ("OpenBoxEasy-v1", "box", [0], [2.0, -0.5], 0.5, 0.005),
        ("CloseDrawer-v1", "cabinet", [3], [0.2, -0.2], 0.02, 0.001),
        ("OpenFaucet-v1", "faucet", FAUCETS, [1.0, -1.0], 0.1, 0.005),
        ("OpenLaptopEasy-v1", "laptop", [4], [1.0, -1.0], 0.1, 0.005),
    ],
)
def test_a_pushed_joint_stops_soon_without_bouncing_back(
    task: str, name: str, seeds: Sequence[int], speeds: Sequence[float], farthest: float, tolerance: float
) -> None:
    with Simulator(task, renders=False) as simulator:
        for seed in seeds:
            simulator.reset(compose(task, seed))
            q = simulator.snapshot().q
            for speed in speeds:
                before = simulator.scene().joints[name]
                simulator.env.objects[name].set_qvel(np.array([[speed]], dtype=np.float32))
                ways = []
                for _ in range(20):
                    simulator.step(q, 0.08)
                    ways.append(np.sign(speed) * (simulator.scene().joints[name] - before))
                assert 0.0 < ways[-1] < farthest
                assert ways[-1] > 0.95 * max(ways)
                assert np.ptp(ways[10:]) < tolerance
