"""`kinebench-drake suite`."""

import json
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from kinebench_drake.cli.click_options import config_options
from kinebench_drake.suites.commands.suite_data import EPISODES, demos, export, read_dataset
from kinebench_drake.suites.commands.suite_run import plan, report, run
from kinebench_drake.suites.runs.suite_config import SuiteConfig

if TYPE_CHECKING:  # slow to import
    pass


@click.group(
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite list --json\n"
    "  kinebench-drake suite export --suite 0 --episodes 10 --out suite0/\n"
    "  kinebench-drake suite demos --task StackCube-v1 --episodes 10 --out demos/"
)
def suite() -> None:
    """Work with the benchmark's tasks and suites."""


for command in (export, demos, run, plan, report):
    suite.add_command(command)


@suite.command(
    "list",
    epilog="\b\nExample:\n  kinebench-drake suite list --json",
)
@click.option("--json", "as_json", is_flag=True, help="Full descriptions as JSON; prompt: that of seed 0.")
def list_tasks(as_json: bool) -> None:
    """List the tasks, one plain id a line."""
    from kinebench_drake.suites.families.registry import TASKS

    if as_json:
        from kinebench_drake.suites.composition import compose

        texts = {name: compose(name, 0).prompt for name in TASKS}
        facts = [{**asdict(t.card), "horizon": t.card.horizon, "prompt": texts[name]} for name, t in TASKS.items()]
        click.echo(json.dumps(facts, indent=1, default=lambda x: x.value if isinstance(x, Enum) else str(x)))
    else:
        click.echo("\n".join(TASKS))


@suite.command(epilog="\b\nExample:\n  kinebench-drake suite check --tasks StackCube-v1 --episodes 100 --jobs 2")
@config_options(SuiteConfig, *EPISODES, "jobs", defaults={"suite": 0})
def check(jobs: int, **dataset: Any) -> None:
    """Let the experts do their tasks; print success rates with 95 % intervals and the reasons of failures."""
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.suites.expert_check import ExpertTrial, run_trials, task_lines
    from kinebench_drake.suites.export import DatasetConfig

    config = DatasetConfig(**read_dataset(**dataset), out=Path())
    trials: dict[str, list[ExpertTrial]] = {task: [] for task in config.tasks}
    episodes = [spec.episode() for spec in config.specs()]
    for trial in run_trials(create_executor(ExecutorKind.LOCAL, jobs), episodes):
        own = trials[trial.episode.task]
        own.append(trial)
        if len(own) == config.episodes:
            own.sort(key=lambda t: t.episode.seed)
            click.echo("\n".join(task_lines(own)))
