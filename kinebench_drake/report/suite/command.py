"""Commands of runs that would fill gaps of a report."""

import hashlib
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace

from kinebench_drake.report.suite.episode_result import SuitePart
from kinebench_drake.report.suite.pooling import SuiteRun

_SPEC = "SPEC"
"""Placeholder of a world model's spec, of which results keep a hash only."""
_OPTIONS = {
    "samples_per_episode": ("--samples", 1),
    "rounds": ("--rounds", 3),
    "control": ("--control", "pd_joint_pos"),
    "action_repeat": ("--action-repeat", None),
    "frame_period_s": ("--frame-period", 0.2),
    "clip_timing": ("--clip-timing", None),
    "prompt_prefix": ("--prompt-prefix", ""),
    "prompt_suffix": ("--prompt-suffix", ""),
    "negative_prompt": ("--negative-prompt", ""),
    "condition": ("--condition", None),
}
"""Options of `suite run` and their defaults, by key of the configuration."""


def run_command(
    part: SuitePart,
    like: SuiteRun | None,
    runs: Sequence[SuiteRun],
    *,
    tasks: Sequence[str] | None = None,
    tags: Mapping[str, object] | None = None,
) -> str:
    """Return the command of a model's run on a part, with the settings of another run of the model.

    Args:
        part: suite, split and variant to run.
        like: another run of the model; None: the model is a placeholder.
        runs: all runs: one on the same part, or on the other split of suite 2, determines tasks, episodes and seed,
            so that episodes are paired.
        tasks: tasks to run; None: those of that run, or all.
        tags: tags in place of those of `like`.
    """
    config = {} if like is None else like.config
    paired = {replace(part, split=split) for split in ("seen", "unseen")} if part.suite == 2 else {part}
    reference = next((run.config for run in sorted(runs, key=lambda run: run.part != part) if run.part in paired), None)
    episodes = config if reference is None else reference
    chosen = episodes.get("tasks") if tasks is None and reference is not None else tasks
    words: list[object] = ["kinebench-drake", "suite", "run", "--suite", part.suite]
    words += [] if part.split == "test" else ["--split", part.split]
    words += [] if part.variant == "plain" else ["--variant", part.variant]
    words += ["--tasks", ",".join(map(str, chosen))] if isinstance(chosen, Sequence) and chosen else []
    words += ["--episodes", episodes.get("episodes_per_task") or 10]
    words += ["--seed", seed] if (seed := episodes.get("seed")) else []
    words += ["--world-model", _find_spec(config)]
    model = "MODEL" if like is None else like.models[0]
    words += [] if like is not None and model == config.get("world_model") else ["--model", model]
    for key, (option, default) in _OPTIONS.items():
        words += [option, config[key]] if config.get(key) not in (None, "", default) else []
    words += ["--pixels-only"] if config.get("pixels_only") is True else []
    words += ["--prompts", "FILE"] if config.get("prompts") else []
    labels = ({} if like is None else like.tags) if tags is None else tags
    for key, value in labels.items():
        words += ["--tag", f"{key}={value}"]
    name = "-".join([model, part.slug, *(f"{key}{value}" for key, value in (tags or {}).items())])
    name += "" if tasks is None else "-tasks"
    folder = re.sub(r"[^\w.+-]+", "-", name)
    return shlex.join(map(str, [*words, "--out", f"runs/{folder}/"]))


def _find_spec(config: Mapping[str, object]) -> str:
    """Return the world model's spec if its name is one of the hash that the run has; else the placeholder."""
    from kinebench_drake.errors import UsageError
    from kinebench_drake.suites.worldmodels.spec import parse

    name = str(config.get("world_model"))
    try:
        identity = parse(name).identity
    except UsageError:
        return _SPEC
    digest = hashlib.sha256(identity.encode(errors="surrogateescape")).hexdigest()
    return name if digest == config.get("world_model_sha256") else _SPEC
