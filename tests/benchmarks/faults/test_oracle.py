"""Oracles that are wrong on purpose."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.faults.oracle import FaultyOracle
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.worldmodels.factory import create
from kinebench_drake.suites.worldmodels.reference import OracleModel
from kinebench_drake.suites.worldmodels.worldmodel import Request


@pytest.mark.parametrize(
    ("spec", "name"),
    [
        ("benchmarks.faults.oracle:FaultyOracle?kind=teleport&size=0.15", "oracle, teleport_15cm"),
    ],
)
def test_a_spec_determines_the_name_of_the_oracle(spec: str, name: str) -> None:
    assert create(spec).name == name


def test_an_unknown_fault_is_refused_with_the_valid_ones() -> None:
    with pytest.raises(UsageError, match="teleport"):
        FaultyOracle("jump", 1)


@pytest.mark.sapien
def test_a_faulty_oracle_differs_from_the_oracle_in_its_first_clip_alone(tmp_path: Path) -> None:
    episode = compose("StackCube-v1", 0)
    with Simulator(episode.task, camera=benchmark_camera().resized(96, 96)) as simulator:
        simulator.reset(episode)
        state = simulator.simulation_state()
        first = simulator.render().rgb

    def truth(model: OracleModel, number: int) -> np.ndarray:
        request = Request(
            episode=episode.id, task=episode.task, round=number, prompt="", negative_prompt="", seed=0,
            first_frame=first, num_frames=25, fps=17,
        )  # fmt: skip
        model.set_state(episode, state)
        model.generate(request, tmp_path / f"{model.name}_{number}")
        model.close()
        assert model.truth is not None
        return model.truth.X_CH

    perfect = truth(OracleModel(), 0)
    faulty = FaultyOracle("teleport", 0.1)
    moved = np.linalg.norm((truth(faulty, 0) - perfect)[:, :3, 3], axis=1)
    assert moved[0] == 0.0
    assert moved[-1] == pytest.approx(0.1, abs=1e-4)
    assert np.array_equal(truth(faulty, 1), perfect)
