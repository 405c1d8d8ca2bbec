"""Attempts that count as demonstrations, and resumption of interrupted runs."""

import json
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.executors.base import ItemResult, WorkerCrash
from kinebench_drake.results.metadata import Shard
from kinebench_drake.suites import demos
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.demo_config import DemoConfig, FormatKind, RenderOptions
from kinebench_drake.suites.demo_formats import FORMATS, DemoFormat, Record
from kinebench_drake.suites.demos import DemoSummary, make_demos
from kinebench_drake.suites.rollout import Rollout
from kinebench_drake.suites.simulator import Simulator
from tests.suites.orders import FIRST, TASK, Recorder, an_order


class FakeFormat(DemoFormat):
    """A format whose parts are empty files."""

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        return [folder / f"{record.id}.mp4"]

    def write_part(self, folder: Path, simulator: Simulator, rollout: Rollout, options: RenderOptions) -> None:
        raise NotImplementedError

    def finish(self, config: DemoConfig, records: Sequence[Record]) -> list[Path]:
        (config.out / "all.txt").write_text("".join(f"{record.seed - FIRST} " for record in records))
        return []


class FakeEngine:
    """Makes attempts at once: those of some seeds fail, and after so many of them the program is killed."""

    def __init__(self, out: Path, failing: set[int], *, until: int | None = None) -> None:
        self.out = out
        self.failing = failing
        self.until = until
        self.tried: list[int] = []

    def run(
        self, make_worker: Callable[[], Callable[[EpisodeSpec], Record]], items: Sequence[EpisodeSpec]
    ) -> Generator[ItemResult[EpisodeSpec, Record] | WorkerCrash[EpisodeSpec], None, None]:
        for draw in reversed(items):
            if self.until is not None and len(self.tried) == self.until:
                yield WorkerCrash(item=draw, reason="killed")
                return
            number = draw.seed - FIRST
            self.tried.append(number)
            good = number not in self.failing
            record = Record(
                id=f"{draw.task}_s{draw.seed}", task=draw.task, seed=draw.seed, prompt="", success=good,
                reason="" if good else "not on_top", progress=float(good), clips=1, facts={},
            )  # fmt: skip
            if good:
                (self.out / f"{record.id}.mp4").touch()
            yield ItemResult(item=draw, result=record)


@pytest.fixture
def deliver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[DemoSummary, FakeEngine, list[int]]]:
    """Carries out an order with the fakes; returns what came of it, the engine and the seeds delivered."""
    monkeypatch.setitem(FORMATS, FormatKind.MP4, FakeFormat())

    def call(
        episodes: int, failing: set[int] | None = None, until: int | None = None, **changes: Any
    ) -> tuple[DemoSummary, FakeEngine, list[int]]:
        order = replace(an_order(tmp_path, FormatKind.MP4, episodes), **changes)
        engine = FakeEngine(order.out, failing or set(), until=until)
        delivery = make_demos(order, engine, Recorder())
        return delivery, engine, [int(word) for word in (order.out / "all.txt").read_text().split()]

    return call


def test_failed_seeds_are_recorded_and_replaced_by_the_next(deliver: Any, tmp_path: Path) -> None:
    delivery, engine, seeds = deliver(4, failing={1, 4})
    assert seeds == [0, 2, 3, 5]
    assert delivery == DemoSummary(demonstrations=4, failures=2, short={})
    assert sorted(engine.tried) == [0, 1, 2, 3, 4, 5]
    rows = [json.loads(line) for line in (tmp_path / "demos.jsonl").read_text().splitlines()]
    assert [(row["seed"] - FIRST, row["success"]) for row in rows] == [
        (0, True), (1, False), (2, True), (3, True), (4, False), (5, True),
    ]  # fmt: skip


def test_a_larger_set_begins_with_the_smaller_one(deliver: Any, tmp_path: Path) -> None:
    failing = {0, 3, 7}
    _, _, few = deliver(3, failing)
    _, engine, more = deliver(6, failing)  # in the same folder: nothing is made twice
    assert more[:3] == few
    assert not set(engine.tried) & {0, *few}
    assert deliver(6, failing, out=tmp_path / "anew")[2] == more


def test_finished_demonstrations_survive_a_crash_and_a_torn_last_line(deliver: Any, tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="what is finished is kept"):
        deliver(5, {2}, until=3)
    with (tmp_path / "demos.jsonl").open("a") as file:
        file.write('{"id": "torn')
    _, engine, seeds = deliver(5, {2})
    assert seeds == [0, 1, 3, 4, 5]
    assert len(engine.tried) == 6 - 3


def test_a_demonstration_whose_files_are_missing_is_made_again(deliver: Any, tmp_path: Path) -> None:
    deliver(2)
    (tmp_path / f"{TASK}_s{FIRST + 1}.mp4").unlink()
    assert deliver(2)[1].tried == [1]


def test_a_task_whose_expert_rarely_succeeds_is_abandoned(deliver: Any) -> None:
    delivery, _, seeds = deliver(5, failing=set(range(3, 100)))
    assert seeds == [0, 1, 2]
    assert delivery.short == {TASK: 2}
    assert delivery.failures == 2 * 5 + demos.EXTRA_TRIES - 3


def attempt(out: Path, monkeypatch: pytest.MonkeyPatch, error: Exception) -> Record:
    """An attempt at a demonstration that an error ends."""

    def fail(*args: object, **kwargs: object) -> None:
        raise error

    monkeypatch.setattr(demos, "run_expert", fail)
    order = an_order(out, FormatKind.MP4, 1)
    return demos.attempt_demo(None, order.attempts(TASK, 1)[0], order)


def test_an_error_during_a_seed_is_a_failed_attempt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = attempt(tmp_path, monkeypatch, ZeroDivisionError("by zero"))
    assert (record.success, record.reason) == (False, "unexpected ZeroDivisionError: by zero")


def test_a_setup_error_stops_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SetupError, match="no driver"):
        attempt(tmp_path, monkeypatch, SetupError("no driver"))


def test_shards_partition_the_demonstrations(deliver: Any, tmp_path: Path) -> None:
    parts = [
        deliver(5, failing={1}, out=tmp_path / str(index), shard=Shard(index=index, count=2))[2] for index in (1, 2)
    ]
    assert parts == [[0, 2, 4], [3, 5]]


def test_a_folder_is_extended_only_with_the_same_options_and_more_demonstrations(deliver: Any) -> None:
    deliver(3)
    with pytest.raises(UsageError, match="size 96, not 128"):
        deliver(3, options=RenderOptions(size=128))
    with pytest.raises(UsageError, match="may only be more"):
        deliver(2)


def test_an_interrupted_larger_request_may_be_followed_by_a_smaller_one(deliver: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has 1000000 seeds"):
        deliver(1_000_001)
    assert not list(tmp_path.iterdir())
    with pytest.raises(SetupError):
        deliver(9, until=2)  # 8 and 7 are there
    assert deliver(3)[2] == [0, 1, 2]
    assert sorted(path.name[-5] for path in tmp_path.glob("*.mp4")) == ["0", "1", "2"]


def test_attempts_end_with_the_last_seed_of_the_split(tmp_path: Path) -> None:
    order = replace(an_order(tmp_path, FormatKind.MP4, 2), seed=999_998)
    assert [draw.seed for draw in order.attempts(TASK, 14)] == [1_999_998, 1_999_999]


@pytest.mark.parametrize("damage", [b"\xff\xfe\n", b"1\n"])
def test_a_damaged_demos_file_is_a_usage_error(deliver: Any, tmp_path: Path, damage: bytes) -> None:
    deliver(1)
    (tmp_path / "demos.jsonl").write_bytes(damage + b"{}\n")  # an invalid last line counts as torn
    with pytest.raises(UsageError, match="is damaged"):
        deliver(1)
