"""Expert demonstrations with ground truth: as many successful ones of each task as asked for, whatever stops the run.

A demonstration counts from the moment its line stands in `demos.jsonl`, after its files are there whole. A seed with
which the expert fails is told there, too, and the next one takes its place; so the demonstrations of a task are those
of its first successful seeds, and a larger set begins with a smaller one.
"""

import fcntl
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.executors.progress import Observer
from kinebench_drake.io.atomic import disk_errors, make_folder
from kinebench_drake.io.jsonl import append_line, read_lines, write_json, write_lines
from kinebench_drake.suites.clip import film
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.export import episode_facts
from kinebench_drake.suites.formats.demo import CLIP_STEPS, PARTS, Content, Demo, FormatKind, Record, Shots
from kinebench_drake.suites.formats.format import DemoFormat, find_format
from kinebench_drake.suites.order import DemoOrder
from kinebench_drake.suites.rollout import Rollout, rollout
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, failure
from kinebench_drake.suites.stills import take_stills
from kinebench_drake.suites.suite import EpisodeSpec

RECORDS, SUMMARY = "demos.jsonl", "demos.json"
PATIENCE = 10
"""A task is given up after twice as many tries as demonstrations are wanted, and so many more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivery:
    """What came of an order."""

    demonstrations: int
    """Successful ones, those from before included."""
    failures: int
    """Seeds with which the expert failed."""
    short: dict[str, int]
    """How many demonstrations are missing of each task that was given up."""


class _RecordingStage(Simulator):
    """A stage that remembers ManiSkill's state and the verdict after each step."""

    def reset(self, episode: Episode) -> None:
        """See `Stage.reset`."""
        super().reset(episode)
        self.states = [self.simulation_state()]
        self.successes: list[bool] = []

    def step(self, q: ArrayLike, finger_width_m: float) -> None:
        """See `Stage.step`."""
        super().step(q, finger_width_m)
        self.states.append(self.simulation_state())
        self.successes.append(self.outcome().success)


@dataclass(frozen=True, slots=True)
class _Experts:
    """Makes, in each process, what makes demonstrations."""

    kind: FormatKind
    shots: Shots
    out: Path

    def __call__(self) -> Callable[[EpisodeSpec], Record]:
        form = find_format(self.kind)
        content = form.content
        make = _RecordingStage if Content.STATES in content else Simulator
        hand = SimulatorCache(make, self.shots.size, renders=bool(content & (Content.FILM | Content.STILLS)))

        def demonstrate(draw: EpisodeSpec) -> Record:
            episode, stage = draw.episode(), hand.stage(draw.task, draw.variant)
            success, progress, reason, clips = False, 0.0, "", 0
            try:
                performance = rollout(stage, find_expert(draw.task), episode, every=self.shots.every)
                outcome, clips = performance.outcome, len(performance.controls) // CLIP_STEPS
                success, progress = outcome.success and clips > 0, outcome.progress
                reason = "" if success else outcome.reason or "done before anything moved"
            except Exception as error:
                reason = failure(error)
            if success:
                form.write_part(self.out, _demo(stage, performance, self.shots, form.content))
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

        return demonstrate


def _demo(stage: Simulator, performance: Rollout, shots: Shots, content: Content) -> Demo:
    from kinebench_drake.suites.tasks.environment import X_WB

    recording = stage if isinstance(stage, _RecordingStage) else None
    return Demo(
        performance=performance,
        shots=shots,
        film=film(stage, performance.snapshots) if Content.FILM in content else None,
        stills=take_stills(stage, performance, generator("stills", performance.episode.id))
        if Content.STILLS in content
        else (),
        X_WB=X_WB,
        states=recording.states if recording else (),
        successes=tuple(recording.successes) if recording else (),
    )


def make_demos(order: DemoOrder, engine: Executor, observer: Observer, *, overwrite: bool = False) -> Delivery:
    """Make demonstrations, or go on making them where a run before was stopped.

    Raises:
        UsageError: the folder holds demonstrations that are no part of this order.
        SetupError: writing or rendering failed, or a worker died.
    """
    with _claimed(order.out):
        if overwrite:
            _start_anew(order.out)
        records = _records(order)
        before = _begun(order, records)
        if not _joined(order, before):
            form = find_format(order.kind)
            records = {key: r for key, r in records.items() if _whole(form, order.out, r)}
            replaced = before.get("files", before.get("replaces", []))
            write_json(order.out / SUMMARY, {**order.request(), "replaces": replaced})
            write_lines(order.out / RECORDS, [asdict(record) for record in records.values()])
            _produce(order, records, engine, observer)
            _finish(order, form, records)
        tried = _tried(order, records)
        made = Counter(record.task for record in tried if record.success)
        return Delivery(
            demonstrations=made.total(),
            failures=len(tried) - made.total(),
            short={task: order.wanted() - made[task] for task in order.tasks if made[task] < order.wanted()},
        )


@contextmanager
def _claimed(out: Path) -> Iterator[None]:
    """The folder for one program at a time.

    Raises:
        UsageError: it cannot be made, or another program has it.
    """
    make_folder(out)
    try:
        lock = os.open(out, os.O_RDONLY)
    except OSError as error:
        raise UsageError(f"--out {out}: cannot be written ({error.strerror or error})") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise UsageError(f"--out {out}: another run is writing there; wait for it, or name another folder") from None
    finally:
        os.close(lock)


def _start_anew(out: Path) -> None:
    """Delete what an earlier run's summary and records name; damaged ones name nothing.

    Raises:
        SetupError: something cannot be deleted.
    """
    paths = [out / SUMMARY, out / RECORDS]
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, InputError):
        before = json.loads((out / SUMMARY).read_text())
        form = find_format(FormatKind(before["format"]))
        paths += [out / name for name in before.get("files", before.get("replaces", []))]
        paths += form.lists(out, before["tasks"])
        records = read_lines(out / RECORDS, Record.from_json)
        paths += [path for record in records if record.success for path in form.part_files(out, record)]
    _delete(out, paths)


def _delete(out: Path, paths: Sequence[Path]) -> None:
    """Delete files of a folder and the folders below it that this empties."""
    top = out.resolve()
    for path in paths:
        if top not in path.resolve().parents:
            continue
        with disk_errors(path.name):
            path.unlink(missing_ok=True)
        for folder in path.parents[: len(path.parents) - len(out.parents) - 1]:
            with suppress(OSError):  # others are in it
                folder.rmdir()


def _begun(order: DemoOrder, records: Mapping[tuple[str, int], Record]) -> dict[str, Any]:
    """The summary of an earlier run in the folder, whose demonstrations must be a part of this order.

    Raises:
        UsageError: it is neither.
    """
    path = order.out / SUMMARY
    if not path.is_file():
        return {}
    try:
        before: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError):
        raise UsageError(f"{path}: is damaged; --overwrite starts anew") from None
    if not isinstance(before, dict):
        raise UsageError(f"{path}: is damaged; --overwrite starts anew")
    fix = "name another --out, or --overwrite to start anew"
    for name, value in order.settings().items():
        if before.get(name) != value:
            raise UsageError(f"{order.out} holds demonstrations with {name} {before.get(name)}, not {value}: {fix}")
    for task, held in Counter(record.task for record in records.values() if record.success).items():
        wanted = order.wanted() if task in order.tasks else 0
        if held > wanted:
            raise UsageError(
                f"{order.out} holds {held} demonstrations of {task}; asked for are {wanted}, which may only be more: "
                f"{fix}"
            )
    return before


def _records(order: DemoOrder) -> dict[tuple[str, int], Record]:
    """Attempts told by the folder, by task and seed."""
    try:
        records = read_lines(order.out / RECORDS, Record.from_json)
    except (OSError, InputError):
        raise UsageError(f"{order.out / RECORDS}: is damaged; --overwrite starts anew") from None
    return {(record.task, record.seed): record for record in records}


def _joined(order: DemoOrder, before: dict[str, Any]) -> bool:
    """Whether all of this order is there already, its parts joined and gone."""
    files: list[str] = before.get("files", [])
    same = all(before.get(name) == value for name, value in order.request().items())
    return same and bool(files) and all((order.out / name).is_file() for name in files)


def _whole(form: DemoFormat, out: Path, record: Record) -> bool:
    return not record.success or all(path.is_file() for path in form.part_files(out, record))


def _tries(
    order: DemoOrder, records: Mapping[tuple[str, int], Record], task: str
) -> tuple[list[Record], list[EpisodeSpec]]:
    """Attempts that count, in the order of seeds up to the last one needed, and those to be made next."""
    wanted, good = order.wanted(), 0
    tried: list[Record] = []
    todo: list[EpisodeSpec] = []
    for draw in order.draws(task, 2 * wanted + PATIENCE if wanted else 0):
        if good + len(todo) == wanted:
            break
        record = records.get((task, draw.seed))
        if record is None:
            todo.append(draw)
        else:
            tried.append(record)
            good += record.success
    return tried, todo


def _tried(order: DemoOrder, records: Mapping[tuple[str, int], Record]) -> list[Record]:
    return [record for task in order.tasks for record in _tries(order, records, task)[0]]


def _produce(order: DemoOrder, records: dict[tuple[str, int], Record], engine: Executor, observer: Observer) -> None:
    """Make attempts until each task has its demonstrations, or too many have failed."""
    kept = sum(record.success for record in _tried(order, records))
    observer.start(order.wanted() * len(order.tasks), kept)
    while todo := [draw for task in order.tasks for draw in _tries(order, records, task)[1]]:
        died = []
        for done in engine.run(_Experts(order.kind, order.shots, order.out), todo):
            if isinstance(done, WorkerCrash):
                died.append(f"{done.item.task} seed {done.item.seed}: {done.reason}")
                continue
            record = done.result
            append_line(order.out / RECORDS, asdict(record))
            records[record.task, record.seed] = record
            observer.advance(f"{record.id}: {record.reason}" if record.reason else record.id, ok=record.success)
        if died:
            raise SetupError(f"{died[0]}; run the same command again, what is finished is kept")


def _finish(order: DemoOrder, form: DemoFormat, records: Mapping[tuple[str, int], Record]) -> None:
    """Write what speaks of all demonstrations; only then parts that were joined may go."""
    tried = _tried(order, records)
    made = [record for record in tried if record.success]
    if made:
        files = form.finish(order.out, made, order.shots, order.settings())
        write_lines(order.out / RECORDS, [asdict(record) for record in tried])
        counted = {(record.task, record.seed) for record in tried}
        spare = [record for key, record in records.items() if record.success and key not in counted]
        _delete(order.out, [path for record in spare for path in form.part_files(order.out, record)])
        counts = {"demonstrations": len(made), "failures": len(tried) - len(made)}
        names = [file.relative_to(order.out).as_posix() for file in files]
        write_json(order.out / SUMMARY, {**order.request(), **counts, "files": names})
        shutil.rmtree(order.out / PARTS, ignore_errors=True)
