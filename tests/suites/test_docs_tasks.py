"""docs/tasks.md: the table matches the cards, the examples run, and the example's expert succeeds."""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kinebench_drake.suites.contact_sheet import task_table
from kinebench_drake.suites.families.registry import EXPERTS, TASKS

PAGE = (Path(__file__).parents[2] / "docs/tasks.md").read_text()
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


def test_the_task_table_of_the_docs_equals_the_task_cards() -> None:
    assert task_table(list(TASKS)) in PAGE, (
        "write the output of `kinebench-drake suite list --markdown` to docs/tasks.md"
    )


def test_the_custom_task_of_the_docs_has_under_100_lines() -> None:
    [own] = [code for code in EXAMPLES if "(Task)" in code]
    assert len(own.splitlines()) < 100


@pytest.mark.sapien
def test_the_environment_example_of_the_docs_runs() -> None:
    space = _run(EXAMPLES[0], {"__name__": "docs"})
    assert space["frame"].shape == (1, 384, 384, 3)
    assert not space["info"]["success"]


@pytest.mark.sapien
@pytest.mark.usefixtures("unregistered")
def test_the_expert_of_the_custom_task_succeeds() -> None:
    space = _run(EXAMPLES[2], _run(EXAMPLES[1], {"__name__": "docs"}))
    assert space["result"].outcome.success
