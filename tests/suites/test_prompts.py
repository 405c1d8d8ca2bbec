"""Prompts of runs: texts by task, and what is refused."""

import json
from pathlib import Path

import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.prompts import PromptTemplate


def test_an_empty_template_leaves_the_instruction_unchanged() -> None:
    for task in TASKS:
        episode = compose(task, 3)
        assert PromptTemplate().prompt(episode) == episode.prompt
    assert PromptTemplate.parse(None) == PromptTemplate()
    assert not any(PromptTemplate().to_json().values())


def test_a_text_replaces_the_instruction_of_its_task_or_of_all_others(tmp_path: Path) -> None:
    fruit = compose("PickFruits-v1", 3)
    cube = compose("StackCube-v1", 3)
    texts = {"*": "Still camera. {prompt} Slowly.", "StackCube-v1": " Pile up. ", "negative_prompt": "blur"}
    (tmp_path / "p.json").write_text(json.dumps(texts))
    template = PromptTemplate.parse(tmp_path / "p.json")
    assert template == PromptTemplate.parse(texts)
    assert template.prompt(fruit) == f"Still camera. {fruit.prompt} Slowly."
    assert template.prompt(cube) == "Pile up."
    assert template.negative == "blur"
    assert PromptTemplate.parse({**(stored := template.to_json())["prompts"], "negative_prompt": "blur"}) == template
    assert stored["negative_prompt"] == "blur"


def test_the_example_is_a_template() -> None:
    template = PromptTemplate.parse(Path(__file__).parents[2] / "examples" / "prompts" / "visual-lock.json")
    episode = compose("StackCube-v1", 3)
    assert template.prompt(episode).endswith(episode.prompt)
    assert template.negative


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "p.json: No such file or directory; expected a JSON object of texts by task"),
        ("[]", "p.json: holds a list, expected a JSON object of texts by task"),
        ("{", "p.json: .*; expected a JSON object of texts by task"),
        ('{"StackCubes": "a"}', "p.json: there is no task 'StackCubes', expected CloseBox-v1, "),
        ('{"StackCube-v1": " "}', "p.json: the prompt of StackCube-v1 is ' ', expected a text"),
        ('{"StackCube-v1": 3}', "p.json: the prompt of StackCube-v1 is 3, expected a text"),
    ],
)
def test_unusable_prompt_files_are_usage_errors(tmp_path: Path, text: str | None, message: str) -> None:
    if text is not None:
        (tmp_path / "p.json").write_text(text)
    with pytest.raises(UsageError, match=message):
        PromptTemplate.parse(tmp_path / "p.json")
