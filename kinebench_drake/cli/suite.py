"""`kinebench-drake suite`."""

import json
from pathlib import Path

import click

_TASKS = click.option("--tasks", help="Tasks, comma-separated.  [default: all]", metavar="A,B")
_EPISODES = click.option(
    "--episodes", type=click.IntRange(1), default=10, show_default=True, help="Episodes of each task.", metavar="K"
)
_SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the first episode.")
_JOBS = click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")


def _tasks(names: str | None) -> list[str]:
    from kinebench_drake.suites.tasks.registry import TASKS, find_task

    return list(TASKS) if names is None else [find_task(name.strip()).card.id for name in names.split(",")]


@click.group(epilog="\b\nExample:\n  kinebench-drake suite list")
def suite() -> None:
    """Work with the benchmark's tasks and suites."""


@suite.command("list", epilog="\b\nExample:\n  kinebench-drake suite list --json")
@click.option("--json", "as_json", is_flag=True, help="All that is known of each task, as JSON.")
def list_tasks(as_json: bool) -> None:
    """List the tasks, one plain id a line."""
    from dataclasses import asdict
    from enum import Enum

    from kinebench_drake.suites.tasks.registry import TASKS

    if not as_json:
        click.echo("\n".join(TASKS))
        return
    cards = [{**asdict(task.card), "horizon": task.card.horizon} for task in TASKS.values()]
    click.echo(json.dumps(cards, indent=1, default=lambda x: x.value if isinstance(x, Enum) else str(x)))


@suite.command(epilog="\b\nExample:\n  kinebench-drake suite check --tasks StackCube-v1 --episodes 100 --jobs 2")
@_TASKS
@_EPISODES
@_SEED
@click.option(
    "--policy", type=click.Choice(["expert", "still", "random"]), default="expert", show_default=True,
    help="Who moves the robot.",
)  # fmt: skip
@click.option("--variant", type=click.Choice(["plain", "obstacles"]), default="plain", show_default=True)
@click.option("--pool", type=click.Choice(["all", "seen", "unseen"]), default="all", show_default=True)
@click.option("--json", "json_out", type=click.Path(path_type=Path, dir_okay=False), help="Write the trials here, too.")
@_JOBS
def check(
    tasks: str | None, episodes: int, seed: int, policy: str, variant: str, pool: str, json_out: Path | None, jobs: int
) -> None:
    """Let a policy try tasks, and print success rates with 95 % intervals and the reasons of failures."""
    from kinebench_drake.engines import EngineKind, create_engine
    from kinebench_drake.suites.episode import compose
    from kinebench_drake.suites.split import Pool
    from kinebench_drake.suites.tasks.card import Variant
    from kinebench_drake.suites.tasks.registry import TASKS
    from kinebench_drake.suites.trial import Policy, interval, run_trials

    chosen = [t for t in _tasks(tasks) if Variant(variant) in TASKS[t].card.variants]
    trials = []
    for task in chosen:
        order = [compose(task, s, pool=Pool(pool), variant=Variant(variant)) for s in range(seed, seed + episodes)]
        own = sorted(
            run_trials(create_engine(EngineKind.LOCAL, jobs), order, Policy(policy)), key=lambda t: t.episode.seed
        )
        good = sum(trial.success for trial in own)
        low, high = interval(good, len(own))
        frames = max(trial.frames for trial in own)
        click.echo(
            f"{task:20} {good:4}/{len(own)}  {low:6.1%} to {high:6.1%}  progress {sum(t.progress for t in own) / len(own):.2f}  {frames} frames"
        )
        for trial in own:
            if not trial.success and policy == "expert":
                click.echo(f"    seed {trial.episode.seed}: {trial.reason} (progress {trial.progress:.2f})")
        trials += own
    if json_out is not None:
        records = [
            {"task": t.episode.task, "seed": t.episode.seed, "policy": policy, "success": t.success,
             "progress": t.progress, "reason": t.reason, "frames": t.frames}
            for t in trials
        ]  # fmt: skip
        json_out.write_text(json.dumps(records, indent=1) + "\n")


@suite.command(epilog="\b\nExample:\n  kinebench-drake suite sheet --out tasks.jpg --seed 3 --jobs 2")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Picture, PNG or JPEG.")
@_TASKS
@click.option("--looks", type=click.Choice(["table", "background", "light"]), help="Show all looks of a sort instead.")
@_SEED
@_JOBS
def sheet(out: Path, tasks: str | None, looks: str | None, seed: int, jobs: int) -> None:
    """Draw a contact sheet: how each task begins and how its expert ends it, or all tables, backgrounds or lights."""
    from kinebench_drake.engines import EngineKind, create_engine
    from kinebench_drake.errors import UsageError
    from kinebench_drake.suites.sheet import contact_sheet, look_shots, task_shots

    if out.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise UsageError(f"--out {out} should end in .png or .jpg")
    engine = create_engine(EngineKind.LOCAL, jobs)
    shots = task_shots(engine, _tasks(tasks), seed) if looks is None else look_shots(engine, looks, seed)
    contact_sheet(shots, columns=4 if looks is None else 6).save(out)
    click.echo(f"{out}: {len(shots)} shots, {sum(shot.failed for shot in shots)} failed")
