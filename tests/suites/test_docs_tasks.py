"""docs/tasks.md: the example runs; tasks of one's own, as in examples/push_cube.py."""

import pickle
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import ExecutorKind, create_executor
from kinebench_drake.suites.catalog import load_suite, task_names
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.expert_check import run_trials
from kinebench_drake.suites.families.registry import EXPERTS, TASKS, OwnTask, find_expert, load_task

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/tasks.md").read_text()
PUSH_CUBE = f"{ROOT / 'examples' / 'push_cube.py'}:PushCube"
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
OWN = "PushCube-v1"


@pytest.fixture
def unregistered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Remove what the example registers."""
    monkeypatch.delitem(TASKS, OWN, raising=False)
    monkeypatch.delitem(EXPERTS, OWN, raising=False)
    yield
    TASKS.pop(OWN, None)
    EXPERTS.pop(OWN, None)
    from gymnasium import registry
    from mani_skill.utils.registration import REGISTERED_ENVS

    for environments in (registry, REGISTERED_ENVS):
        environments.pop(f"KineBench/{OWN}", None)


def _run(code: str, space: dict[str, Any]) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(code, "docs/tasks.md", "exec"), space)
    return space


@pytest.mark.sapien
def test_the_environment_example_of_the_docs_runs() -> None:
    space = _run(EXAMPLES[0], {"__name__": "docs"})
    assert space["frame"].shape == (1, 384, 384, 3)
    assert not space["info"]["success"]


@pytest.mark.sapien
@pytest.mark.usefixtures("unregistered")
def test_the_expert_of_the_example_task_succeeds_in_another_process() -> None:
    [trial] = run_trials(create_executor(ExecutorKind.LOCAL, 2), [compose(load_task(PUSH_CUBE), 3)])
    assert (trial.success, trial.reason) == (True, "")


@pytest.mark.usefixtures("unregistered")
def test_a_task_of_ones_own_stands_beside_those_of_a_split() -> None:
    suite = load_suite(0)
    names = task_names(f"{PUSH_CUBE},PullCube-v1")
    assert suite.tasks_of("test", names) == ("PullCube-v1", OWN)
    specs = suite.specs("test", 2, tasks=names)
    assert [spec.id for spec in specs if isinstance(spec.task, OwnTask)] == [f"{OWN}_s{k:04d}" for k in range(2)]
    TASKS.pop(OWN)
    again = pickle.loads(pickle.dumps(specs[-1]))
    assert (again, type(again.task)) == (specs[-1], OwnTask)
    assert again.episode().assets.keys() == {"cube", "target"}
    assert find_expert(OWN)(again.episode().layout().scene(np.eye(4)))


@pytest.mark.usefixtures("unregistered")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no Own"),
        ("class Own: pass", r"expected a class with a method layout"),
        ("class Own:\n    def layout(self): pass", "expected a subclass of .*Task"),
        ("import nowhere_at_all", "there is no module 'nowhere_at_all'"),
        ("1 / 0", "cannot be imported .ZeroDivisionError"),
        (
            "from kinebench_drake.suites.families.blocks.task import StackCube as Own",
            "a shipped task has the id StackCube-v1",
        ),
    ],
)
def test_an_unusable_task_of_ones_own_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "own.py"
    file.write_text(text)
    with pytest.raises(UsageError, match=message) as caught:
        load_task(f"{file}:Own")
    assert str(caught.value).startswith("$tasks ")
    with pytest.raises(UsageError, match=r"absent\.py:Own: "):
        load_task(f"{tmp_path / 'absent.py'}:Own")
