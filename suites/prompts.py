"""Prompts of world models: the episode's instruction, or texts in place of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from kinebench_drake.errors import UsageError, cause
from kinebench_drake.io.files import read_text
from kinebench_drake.io.jsonl import Json, parse_json
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.fruits.assets import FRUITS
from kinebench_drake.suites.families.registry import TASKS

INSTRUCTION = "{prompt}"
"""Placeholder for the episode's own instruction in a text."""
OTHERS = "*"
NEGATIVE = "negative_prompt"
"""Keys of the text of all tasks that have none, and of what to avoid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptTemplate:
    """Template of the prompts of a run."""

    texts: Mapping[str, str] = field(default_factory=dict)
    """Text by task or `OTHERS`, in place of the episode's instruction; `INSTRUCTION` in it is replaced by that."""
    negative: str = ""
    """Content to avoid, for every prompt."""

    @classmethod
    def parse(cls, source: Path | Mapping[str, object] | None) -> "PromptTemplate":
        """Read texts by task, `OTHERS` and `NEGATIVE`; None: no texts.

        Args:
            source: the texts, or the path of a JSON file with them.

        Raises:
            UsageError: there is no such task, or the file is not a JSON object of texts.
        """
        name = "$prompts"
        texts = cast(object, source or {})
        if isinstance(source, Path):
            name = f"$prompts {source}"
            try:
                texts = parse_json(read_text(source))
            except (OSError, ValueError) as error:
                raise UsageError(f"{name}: {cause(error)}; expected a JSON object of texts by task") from None
        if not isinstance(texts, Mapping):
            raise UsageError(f"{name}: holds a {type(texts).__name__}, expected a JSON object of texts by task")
        for key, text in texts.items():
            if key not in (*TASKS, OTHERS, NEGATIVE):
                raise UsageError(f"{name}: there is no task {key!r}, expected {', '.join((*TASKS, OTHERS, NEGATIVE))}")
            if not isinstance(text, str) or not text.strip():
                raise UsageError(f"{name}: the prompt of {key} is {text!r}, expected a text")
        own = {key: str(text).strip() for key, text in sorted(texts.items())}
        return cls(negative=own.pop(NEGATIVE, ""), texts=own)

    def prompt(self, episode: Episode) -> str:
        """Return the prompt of an episode."""
        text = self.texts.get(episode.task, self.texts.get(OTHERS, INSTRUCTION))
        fruits = sorted((name for name in FRUITS if name in episode.prompt), key=episode.prompt.index)
        for placeholder, value in (
            (INSTRUCTION, episode.prompt),
            ("{fruit_name}", fruits[0] if fruits else ""),
            ("{fruit_sequence_text}", ", ".join(fruits)),
        ):
            text = text.replace(placeholder, value)
        return text

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json."""
        return {"prompts": dict(self.texts) or None, NEGATIVE: self.negative}
