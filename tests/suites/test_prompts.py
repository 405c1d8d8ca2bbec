"""Prompts of runs: parts, texts by task, presets, and what is refused."""

import json
from pathlib import Path

import pytest

from kinebench_drake.cli.suite_run import run
from kinebench_drake.errors import UsageError
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.prompts import PRESETS, PromptTemplate, prompt_template


def test_an_empty_template_leaves_the_instruction_unchanged() -> None:
    for task in TASKS:
        episode = compose(task, 3)
        assert PromptTemplate().prompt(episode) == episode.prompt
    assert prompt_template() == PromptTemplate()
    assert not any(PromptTemplate().to_json().values())


def test_prefix_and_suffix_surround_the_text_of_the_task(tmp_path: Path) -> None:
    fruit, cube = compose("PickFruits-v1", 3), compose("StackCube-v1", 3)
    (tmp_path / "p.json").write_text(json.dumps({"PickFruits-v1": "{prompt} Slowly.", "StackCube-v1": " Pile up. "}))
    template = prompt_template(
        prompt_prefix=" Still camera. ",
        prompt_suffix="No cut.",
        prompts=tmp_path / "p.json",
        negative_prompt="blur",
    )
    assert template.prompt(fruit) == f"Still camera. {fruit.prompt} Slowly. No cut."
    assert template.prompt(cube) == "Still camera. Pile up. No cut."
    assert template.negative == "blur"
    assert prompt_template(prompts={"StackCube-v1": "Pile up."}).prompt(cube) == "Pile up."


def test_explicit_options_override_the_preset() -> None:
    locked, episode = PRESETS["visual-lock"], compose("StackCube-v1", 3)
    assert prompt_template(prompt_preset="visual-lock") == locked
    assert locked.prompt(episode) == f"{locked.prefix} {episode.prompt}"
    mixed = prompt_template(prompt_preset="visual-lock", negative_prompt="", prompt_suffix="End.")
    assert (mixed.prefix, mixed.suffix, mixed.negative) == (locked.prefix, "End.", "")


def test_the_command_offers_every_preset() -> None:
    [option] = [parameter for parameter in run.params if parameter.name == "prompt_preset"]
    assert list(option.type.choices) == list(PRESETS)


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
        prompt_template(prompts=tmp_path / "p.json")


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(UsageError, match="prompt_preset is 'lock', expected 'visual-lock'"):
        prompt_template(prompt_preset="lock")
