"""World models in runs of a suite: how many are made, what is freed, what the results tell of them."""

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from kinebench_drake.closed_loop.loop import LoopOptions
from kinebench_drake.errors import InputError
from kinebench_drake.evaluation import episode
from kinebench_drake.evaluation.suite import SuiteConfig, run_suite
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.suites.prompts import PromptTemplate
from kinebench_drake.suites.suite import load_suite
from tests.cli.fake_analyzer import FakeAnalyzer

did: Counter[str] = Counter()


class Model:
    name = "mine"

    def __init__(self) -> None:
        did["made"] += 1
        did["alive"] += 1
        did["most alive"] = max(did["most alive"], did["alive"])

    def generate(self, request: object, out: Path) -> Path:
        return out

    def close(self) -> None:
        did["alive"] -= 1


class Stored(Model):
    def files(self, episode: str, task: str, round: int) -> list[Path]:
        did["asked for files"] += 1
        return []


class Stage:
    """A stage on which nothing can be done."""

    def __init__(self, *_: object, **__: object) -> None:
        did["simulators"] += 1

    def reset(self, episode: object) -> None:
        raise InputError("the curtain stays down")

    def close(self) -> None:
        did["simulators"] -= 1


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., SuiteConfig]:
    """A run of two episodes on that stage."""
    did.clear()
    module = ModuleType("my_models")
    module.Model, module.Stored = Model, Stored
    monkeypatch.setitem(sys.modules, "my_models", module)
    monkeypatch.setattr(episode, "Simulator", Stage)

    def make(world_model: str, **changes: object) -> SuiteConfig:
        told = {"suite": load_suite(0), "split": "test", "tasks": ("PullCube-v1",), "episodes": 2}
        told |= {"out": tmp_path / "out", "make_analyzer": FakeAnalyzer, "world_model": world_model}
        return SuiteConfig(**{**told, **changes})

    return make


@pytest.mark.parametrize("name", ["Model", "Stored"])
def test_a_run_makes_one_model_and_frees_all_it_made(config: Callable[..., SuiteConfig], name: str) -> None:
    rows = run_suite(config(f"my_models:{name}")).rows
    assert [(row.model, row.reason) for row in rows] == [("mine", "the curtain stays down")] * 2
    assert (did["made"], did["alive"], did["simulators"]) == (1, 0, 0)
    assert bool(did["asked for files"]) is (name == "Stored")


def test_results_tell_what_differs_between_runs_and_no_address(config: Callable[..., SuiteConfig]) -> None:
    specs = ("http://10.0.0.1/a?key_env=K", "http://10.0.0.2/a?key_env=K")
    one, other = (config(spec, model_name="wan").to_json() for spec in specs)
    assert [name for name in one if one[name] != other[name]] == ["world_model_sha256"]
    assert "10.0.0" not in f"{one} {other}"
    named = config(specs[0], model_name="wan", loop=LoopOptions(prompts=PromptTemplate(negative="blur"))).to_json()
    assert [name for name in one if one[name] != named[name]] == ["negative_prompt"]
    moved, here, changed = (
        config(f"http://{address}/a?name=wan&{options}", model_name="wan").to_json()
        for address, options in (("10.0.0.1", "key_env=K"), ("10.0.0.2", "key_env=K"), ("10.0.0.1", "key_env=L"))
    )
    assert moved == here != changed
    everywhere = config(specs[0], model_name="wan", out=Path("elsewhere")).to_json()
    assert everywhere == one


class Ledger:
    """A worker that writes down when it is closed."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __call__(self, item: int) -> int:
        return item

    def close(self) -> None:
        with self._path.open("a") as file:
            file.write("closed\n")


class Hire:
    """Makes it, in whatever process."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __call__(self) -> Ledger:
        return Ledger(self._path)


@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_are_closed(tmp_path: Path, jobs: int) -> None:
    outcomes = list(LocalExecutor(jobs=jobs).run(Hire(tmp_path / "ledger"), range(3)))
    assert sorted(outcome.result for outcome in outcomes) == [0, 1, 2]
    assert (tmp_path / "ledger").read_text() == "closed\n" * jobs
