"""Expert demonstrations with ground truth: a number of successful ones of each task, resumable at any point.

A demonstration counts as soon as its line is in `demos.jsonl`, which is written after its files. A seed with which the
expert fails is recorded there as well and replaced by the next one; so the demonstrations of a task are those of its
first successful seeds, and a larger set begins with a smaller one.
"""

import os
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.executors.base import Executor, Observer, WorkerCrash
from kinebench_drake.io.atomic import disk_errors, lock_folder
from kinebench_drake.io.jsonl import append_line, read_json, read_lines, write_json, write_lines
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.demo_config import CLIP_STEPS, DemoConfig
from kinebench_drake.suites.demo_formats import FORMATS, PARTS, DemoFormat, Record
from kinebench_drake.suites.export import episode_facts
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker, failure_reason

RECORDS = "demos.jsonl"
SUMMARY = "demos.json"
EXTRA_TRIES = 10
"""A task is given up after twice the number of demonstrations plus this number of tries."""

Records = Mapping[tuple[str, int], Record]
"""Attempts by task and seed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoSummary:
    """Result of making demonstrations."""

    demonstrations: int
    """Successful attempts, including those of earlier runs."""
    failures: int
    """Seeds with which the expert failed."""
    short: dict[str, int]
    """Number of missing demonstrations of each task that was given up."""


def attempt_demo(simulator: Simulator, spec: EpisodeSpec, config: DemoConfig) -> Record:
    """Let the expert try an episode; write its part of the demonstrations if it succeeds."""
    episode = spec.episode()
    success = False
    progress = 0.0
    reason = ""
    clips = 0
    try:
        rollout = run_expert(simulator, find_expert(spec.task), episode, every=config.options.every)
        outcome = rollout.outcome
        clips = len(rollout.controls) // CLIP_STEPS
        success = outcome.success and clips > 0
        progress = outcome.progress
        reason = "" if success else outcome.reason or "done before anything moved"
    except Exception as error:
        reason = failure_reason(error)
    if success:
        FORMATS[config.kind].write_part(config.out, simulator, rollout, config.options)
    return Record(
        id=episode.id,
        task=episode.task,
        seed=episode.seed,
        prompt=episode.prompt,
        success=success,
        reason=reason,
        progress=progress,
        clips=clips,
        facts={name: fact for name, fact in episode_facts(episode).items() if name not in Record.__slots__},
    )


def make_demos(config: DemoConfig, executor: Executor, observer: Observer) -> DemoSummary:
    """Make demonstrations, continuing an earlier run in the same folder."""
    lock = lock_folder(config.out)
    try:
        records = _read_records(config)
        if not _is_complete(config, _read_summary(config, records)):
            form = FORMATS[config.kind]
            records = {
                key: record
                for key, record in records.items()
                if not record.success or all(path.is_file() for path in form.part_files(config.out, record))
            }
            write_json(config.out / SUMMARY, config.request())
            write_lines(config.out / RECORDS, [asdict(record) for record in records.values()])
            _run_attempts(config, records, executor, observer)
            _finish(config, form, records)
        counted = _counted(config, records)
        made = Counter(record.task for record in counted if record.success)
        return DemoSummary(
            demonstrations=made.total(),
            failures=len(counted) - made.total(),
            short={task: config.wanted - made[task] for task in config.tasks if made[task] < config.wanted},
        )
    finally:
        os.close(lock)


def _delete(out: Path, paths: Sequence[Path]) -> None:
    """Delete files below a folder and the subfolders that become empty."""
    top = out.resolve()
    for path in paths:
        if top not in path.resolve().parents:
            continue
        with disk_errors(path.name):
            path.unlink(missing_ok=True)
        for folder in path.parents[: len(path.parents) - len(out.parents) - 1]:
            with suppress(OSError):  # not empty
                folder.rmdir()


def _read_summary(config: DemoConfig, records: Records) -> dict[str, Any]:
    """Read the summary of an earlier run, whose demonstrations must be a subset of these; empty if there is none."""
    path = config.out / SUMMARY
    if not path.is_file():
        return {}
    try:
        before = read_json(path)
    except (OSError, ValueError):
        before = None
    if not isinstance(before, dict):
        raise UsageError(f"{path}: is damaged; name another $out")
    fix = "name another $out"
    for name, value in config.settings().items():
        if before.get(name) != value:
            raise UsageError(f"{config.out} holds demonstrations with {name} {before.get(name)}, not {value}: {fix}")
    for task, count in Counter(record.task for record in records.values() if record.success).items():
        wanted = config.wanted if task in config.tasks else 0
        if count > wanted:
            raise UsageError(
                f"{config.out} holds {count} demonstrations of {task}; asked for are {wanted}, which may only be more: "
                f"{fix}"
            )
    return before


def _read_records(config: DemoConfig) -> dict[tuple[str, int], Record]:
    """Read the attempts of an earlier run."""
    try:
        records = read_lines(config.out / RECORDS, Record.from_json)
    except (OSError, InputError):
        raise UsageError(f"{config.out / RECORDS}: is damaged; name another $out") from None
    return {(record.task, record.seed): record for record in records}


def _is_complete(config: DemoConfig, before: dict[str, Any]) -> bool:
    """Return whether an earlier run with the same configuration is complete and its parts are joined."""
    files: list[str] = before.get("files", [])
    same = all(before.get(name) == value for name, value in config.request().items())
    return same and bool(files) and all((config.out / name).is_file() for name in files)


def _plan_task(config: DemoConfig, records: Records, task: str) -> tuple[list[Record], list[EpisodeSpec]]:
    """Return the attempts that count, in order of seeds up to the last one needed, and those to be made next."""
    successes = 0
    counted: list[Record] = []
    todo: list[EpisodeSpec] = []
    for spec in config.attempts(task, 2 * config.wanted + EXTRA_TRIES if config.wanted else 0):
        if successes + len(todo) == config.wanted:
            break
        record = records.get((task, spec.seed))
        if record is None:
            todo.append(spec)
        else:
            counted.append(record)
            successes += record.success
    return counted, todo


def _counted(config: DemoConfig, records: Records) -> list[Record]:
    return [record for task in config.tasks for record in _plan_task(config, records, task)[0]]


def _run_attempts(
    config: DemoConfig, records: dict[tuple[str, int], Record], executor: Executor, observer: Observer
) -> None:
    """Make attempts until each task has its demonstrations or is given up."""
    completed = sum(record.success for record in _counted(config, records))
    observer.start(config.wanted * len(config.tasks), completed)
    simulators = SimulatorCache(Simulator, config.options.size)
    make_worker = partial(SimulatorWorker, partial(attempt_demo, config=config), simulators)
    while todo := [spec for task in config.tasks for spec in _plan_task(config, records, task)[1]]:
        crashes = []
        for done in executor.run(make_worker, todo):
            if isinstance(done, WorkerCrash):
                crashes.append(f"{done.item.task} seed {done.item.seed}: {done.reason}")
                continue
            record = done.result
            append_line(config.out / RECORDS, asdict(record))
            records[record.task, record.seed] = record
            observer.advance(f"{record.id}: {record.reason}" if record.reason else record.id, ok=record.success)
        if crashes:
            raise SetupError(f"{crashes[0]}; run the same command again, what is finished is kept")


def _finish(config: DemoConfig, form: DemoFormat, records: Records) -> None:
    """Write the files that concern all demonstrations; joined parts are deleted last."""
    counted = _counted(config, records)
    made = [record for record in counted if record.success]
    if made:
        files = form.finish(config, made)
        write_lines(config.out / RECORDS, [asdict(record) for record in counted])
        keys = {(record.task, record.seed) for record in counted}
        surplus = [record for key, record in records.items() if record.success and key not in keys]
        _delete(config.out, [path for record in surplus for path in form.part_files(config.out, record)])
        counts = {"demonstrations": len(made), "failures": len(counted) - len(made)}
        names = [file.relative_to(config.out).as_posix() for file in files]
        write_json(config.out / SUMMARY, {**config.request(), **counts, "files": names})
        shutil.rmtree(config.out / PARTS, ignore_errors=True)
