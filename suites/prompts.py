"""Prompts of world models: the episode's instruction, a text of its task in place of it, text before and after."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from kinebench_drake.errors import UsageError, cause
from kinebench_drake.formats.kinebench import read_prompts
from kinebench_drake.io.files import read_text
from kinebench_drake.io.jsonl import Json, parse_json
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.fruits.assets import FRUITS
from kinebench_drake.suites.families.registry import TASKS

_CLONE = "kinebench:"
INSTRUCTION = "{prompt}"
"""Placeholder for the episode's own instruction in the text of a task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptTemplate:
    """Template of the prompts of a run."""

    prefix: str = ""
    """Text before each prompt."""
    suffix: str = ""
    """Text after each prompt."""
    tasks: Mapping[str, str] = field(default_factory=dict)
    """Text by task, in place of the episode's instruction; `INSTRUCTION` in it is replaced by that."""
    negative: str = ""
    """Content to avoid, for every prompt."""

    def prompt(self, episode: Episode) -> str:
        """Return the prompt of an episode."""
        text = self.tasks.get(episode.task, INSTRUCTION)
        fruits = sorted((name for name in FRUITS if name in episode.prompt), key=episode.prompt.index)
        for placeholder, value in (
            (INSTRUCTION, episode.prompt),
            ("{fruit_name}", fruits[0] if fruits else ""),
            ("{fruit_sequence_text}", ", ".join(fruits)),
        ):
            text = text.replace(placeholder, value)
        return " ".join(part for part in (self.prefix, text, self.suffix) if part)

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json."""
        return {
            "prompt_prefix": self.prefix,
            "prompt_suffix": self.suffix,
            "prompts": dict(self.tasks) or None,
            "negative_prompt": self.negative,
        }


PRESETS: Mapping[str, PromptTemplate] = {
    "visual-lock": PromptTemplate(
        prefix=(
            "One continuous shot from a fixed camera. The view, the lighting, the table and the background never "
            "change. The robot arm with its two-finger gripper and every object keep exactly the shape, size, colour "
            "and number that they have in the first image; only the arm and what it touches move, smoothly and "
            "without jumps."
        ),
        negative=(
            "camera motion, zoom, cut, change of viewpoint, flicker, motion blur, a second robot, a second gripper, "
            "human hands, bent or melting gripper, fingers that grow or vanish, objects that appear, vanish, change "
            "colour or shape, objects that move without being touched, objects that pass through each other, text, "
            "watermark"
        ),
    )
}
"""Templates by name. visual-lock: a prefix and a negative prompt that ask for what grounding and execution assume."""


def prompt_template(
    *,
    prompt_preset: str | None = None,
    prompt_prefix: str | None = None,
    prompt_suffix: str | None = None,
    prompts: Path | Mapping[str, str] | None = None,
    negative_prompt: str | None = None,
) -> PromptTemplate:
    """Build the template of a run.

    Args:
        prompt_preset: name of one of `PRESETS`, of which the other arguments replace parts.
        prompt_prefix: text before each prompt.
        prompt_suffix: text after each prompt.
        prompts: text by task, the path of a JSON file with them, or "kinebench:" and the folder of a clone, whose
            texts, prefix and negative prompt are used.
        negative_prompt: content to avoid.

    Raises:
        UsageError: there is no such preset or task, or the file is not a JSON object of texts.
    """
    if prompt_preset is not None and prompt_preset not in PRESETS:
        raise UsageError(f"$prompt_preset is {prompt_preset!r}, expected {', '.join(map(repr, PRESETS))}")
    base = PromptTemplate() if prompt_preset is None else PRESETS[prompt_preset]
    if isinstance(prompts, Path) and str(prompts).startswith(_CLONE):
        if prompt_preset is not None:
            raise UsageError(
                f"$prompt_preset {prompt_preset}: {_CLONE} has a prefix and a negative prompt; leave it out"
            )
        read = read_prompts(Path(str(prompts).removeprefix(_CLONE)).expanduser())
        tasks = {task: text for task, text in read.tasks.items() if task in TASKS}
        base, prompts = PromptTemplate(prefix=read.prefix, negative=read.negative), tasks
    return PromptTemplate(
        prefix=(base.prefix if prompt_prefix is None else prompt_prefix).strip(),
        suffix=(base.suffix if prompt_suffix is None else prompt_suffix).strip(),
        tasks=_read_tasks(prompts) if isinstance(prompts, Path) else _checked("$prompts", prompts or {}),
        negative=(base.negative if negative_prompt is None else negative_prompt).strip(),
    )


def _read_tasks(file: Path) -> Mapping[str, str]:
    try:
        texts = parse_json(read_text(file))
    except (OSError, ValueError) as error:
        raise UsageError(f"$prompts {file}: {cause(error)}; expected a JSON object of texts by task") from None
    if not isinstance(texts, Mapping):
        raise UsageError(f"$prompts {file}: holds a {type(texts).__name__}, expected a JSON object of texts by task")
    return _checked(f"$prompts {file}", texts)


def _checked(source: str, texts: Mapping[str, object]) -> dict[str, str]:
    for task, text in texts.items():
        if task not in TASKS:
            raise UsageError(f"{source}: there is no task {task!r}, expected {', '.join(TASKS)}")
        if not isinstance(text, str) or not text.strip():
            raise UsageError(f"{source}: the prompt of {task} is {text!r}, expected a text")
    return {task: str(text).strip() for task, text in sorted(texts.items())}
