"""`kinebench-drake suite`."""

import json
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from kinebench_drake.cli.click_options import PathParameter, check_parent, config_options
from kinebench_drake.errors import UsageError
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.suites.commands.suite_data import demos, export
from kinebench_drake.suites.commands.suite_run import plan, report, run
from kinebench_drake.suites.runs.suite_config import SuiteConfig

if TYPE_CHECKING:  # slow to import
    from kinebench_drake.suites.composition import Episode
    from kinebench_drake.suites.families.task import TaskVariant


@click.group(
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite list --suites\n"
    "  kinebench-drake suite export --suite 0 --episodes 10 --out suite0/\n"
    "  kinebench-drake suite demos --task StackCube-v1 --episodes 10 --out demos/"
)
def suite() -> None:
    """Work with the benchmark's tasks and suites."""


for command in (export, demos, run, plan, report):
    suite.add_command(command)


@suite.command(
    "list",
    epilog="\b\nExamples:\n  kinebench-drake suite list --json\n  kinebench-drake suite list --suites",
)
@click.option("--json", "as_json", is_flag=True, help="Full descriptions as JSON; prompt: that of seed 0.")
@click.option("--suites", is_flag=True, help="List the suites and their splits instead.")
def list_tasks(as_json: bool, suites: bool) -> None:
    """List the tasks, one plain id a line."""
    from kinebench_drake.suites.families.registry import TASKS

    if suites:
        _list_suites(as_json)
    elif as_json:
        from kinebench_drake.suites.composition import compose

        texts = {name: compose(name, 0).prompt for name in TASKS}
        _echo_json([{**asdict(t.card), "horizon": t.card.horizon, "prompt": texts[name]} for name, t in TASKS.items()])
    else:
        click.echo("\n".join(TASKS))


def _list_suites(as_json: bool) -> None:
    from kinebench_drake.suites.catalog import NUMBERS, load_suite

    loaded = [load_suite(number) for number in NUMBERS]
    if as_json:
        _echo_json([asdict(suite) for suite in loaded])
        return
    for suite in loaded:
        click.echo(f"{suite.number}  {suite.title}: {suite.about}")
        for name, split in suite.splits.items():
            judged = ", judged on" if name == suite.evaluated else ""
            facts = f"{len(suite.tasks_of(name))} tasks, assets and looks: {split.pool.value}{judged}"
            click.echo(f"   {name:7}{facts}. {split.about}")


def _echo_json(facts: list[dict[str, Any]]) -> None:
    click.echo(json.dumps(facts, indent=1, default=lambda x: x.value if isinstance(x, Enum) else str(x)))


@suite.command(epilog="\b\nExample:\n  kinebench-drake suite check --tasks StackCube-v1 --episodes 100 --jobs 2")
@click.option(
    "--suite", "number", type=click.IntRange(0, 3), metavar="N",
    help="Take tasks, seeds and assets from a suite's split.  [default: all tasks, seeds as they are, all assets]",
)  # fmt: skip
@click.option(
    "--split", type=click.Choice(["train", "test", "seen", "unseen"]), help="Split, with --suite.  [default: test]"
)
@config_options(SuiteConfig, "tasks", "episodes")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the first episode.")
@click.option(
    "--policy", type=click.Choice(["expert", "still", "random"]), default="expert", show_default=True,
    help="Policy that moves the robot.",
)  # fmt: skip
@config_options(SuiteConfig, "variant")
@click.option("--json", "json_out", type=PathParameter(dir_okay=False), help="Write the trials as JSON.")
@config_options(SuiteConfig, "jobs")
def check(
    number: int | None,
    split: str | None,
    tasks: str | None,
    episodes: int,
    seed: int,
    policy: str,
    variant: str,
    json_out: Path | None,
    jobs: int,
) -> None:
    """Run a scripted policy on tasks; print success rates with 95 % intervals and the reasons of failures."""
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.suites.expert_check import ExpertTrial, Policy, run_trials, task_lines
    from kinebench_drake.suites.families.task import TaskVariant

    if json_out is not None:
        check_parent("--json", json_out)
    todo = _episodes(number, split, tasks, episodes, seed, TaskVariant(variant))
    trials: dict[str, list[ExpertTrial]] = {task: [] for task in sorted({episode.task for episode in todo})}
    for trial in run_trials(create_executor(ExecutorKind.LOCAL, jobs), todo, Policy(policy)):
        own = trials[trial.episode.task]
        own.append(trial)
        if len(own) == episodes:
            own.sort(key=lambda t: t.episode.seed)
            click.echo("\n".join(task_lines(own)))
    if json_out is not None:
        records = [
            {"task": t.episode.task, "seed": t.episode.seed, "policy": policy, "success": t.success,
             "progress": t.progress, "reason": t.reason, "frames": t.frames}
            for own in trials.values()
            for t in own
        ]  # fmt: skip
        write_atomically(json_out, (json.dumps(records, indent=1) + "\n").encode())


def _episodes(
    number: int | None, split: str | None, tasks: str | None, count: int, seed: int, variant: "TaskVariant"
) -> "list[Episode]":
    """Return `count` episodes of each task, of a suite's split or of all tasks, in order."""
    from kinebench_drake.suites.catalog import chosen_tasks, load_suite, task_names, with_variant
    from kinebench_drake.suites.composition import compose
    from kinebench_drake.suites.families.registry import TASKS, find_task

    if number is None:
        if split is not None:
            raise UsageError(f"--split {split}: of which suite? add --suite N")
        names = task_names(tasks)
        chosen = list(TASKS) if names is None else [find_task(name).card.id for name in names]
        having = with_variant(chosen, variant, named=names is not None)
        return [compose(task, s, variant=variant) for task in having for s in range(seed, seed + count)]
    suite = load_suite(number)
    name = split or "test"
    tasks_of_split = chosen_tasks(suite, name, tasks, variant)
    return [spec.episode() for spec in suite.specs(name, count, tasks=tasks_of_split, offset=seed, variant=variant)]
