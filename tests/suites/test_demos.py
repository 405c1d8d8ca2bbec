"""Demonstrations: which ones count, and what their formats hold."""

import json
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest

from kinebench_drake.camera import Camera
from kinebench_drake.engines import Crashed, Done, EngineKind, create_engine
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.inputs import find_samples
from kinebench_drake.mp4 import join_videos, write_video
from kinebench_drake.shard import Shard
from kinebench_drake.suites import demos
from kinebench_drake.suites.demos import Delivery, make_demos
from kinebench_drake.suites.export import episode_facts
from kinebench_drake.suites.formats.demo import FRAME_CHOICES, Content, Demo, FormatKind, Record, Shots
from kinebench_drake.suites.formats.lerobot import CAMERA, STATE, LeRobot
from kinebench_drake.suites.formats.statistics import of_histograms, of_rows
from kinebench_drake.suites.formats.videofolder import VideoFolder
from kinebench_drake.suites.order import Order
from kinebench_drake.suites.rollout import Clip, Performance, Stage
from kinebench_drake.suites.stagehand import Stagehand
from kinebench_drake.suites.suite import Draw, load_suite
from kinebench_drake.suites.tasks.card import Variant
from kinebench_drake.suites.tasks.registry import TASKS
from kinebench_drake.trajectories.check import check
from kinebench_drake.trajectories.lerobot import list_lerobot, read_lerobot
from kinebench_drake.trajectories.maniskill import list_maniskill, read_maniskill
from kinebench_drake.trajectories.trajectory import Choice

Filmed = tuple[Stage, Performance, Clip]
TASK = "StackCube-v1"
FIRST = 1_000_000


class Watcher:
    """A watcher that remembers."""

    def __init__(self) -> None:
        self.kept = 0
        self.lines: list[str] = []

    def started(self, total: int, kept: int) -> None:
        self.kept = kept

    def advanced(self, line: str, *, good: bool = True) -> None:
        self.lines.append(line)


class FakeFormat:
    """A format whose parts are empty files."""

    content = Content.FILM

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        return [folder / f"{record.id}.mp4"]

    def finish(self, folder: Path, records: Sequence[Record], shots: Shots, about: dict[str, Any]) -> list[Path]:
        (folder / "all.txt").write_text("".join(f"{record.seed - FIRST} " for record in records))
        return []

    def lists(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        return [folder / "all.txt"]


class FakeEngine:
    """Makes attempts at once: those of some seeds fail, and after so many of them the program is killed."""

    def __init__(self, out: Path, failing: set[int], *, until: int | None = None) -> None:
        self.out, self.failing, self.until = out, failing, until
        self.tried: list[int] = []

    def run(
        self, make_worker: Callable[[], Callable[[Draw], Record]], items: Sequence[Draw]
    ) -> Generator[Done[Draw, Record] | Crashed[Draw], None, None]:
        for draw in reversed(items):
            if self.until is not None and len(self.tried) == self.until:
                yield Crashed(item=draw, reason="killed")
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
            yield Done(item=draw, result=record)


@pytest.fixture
def deliver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Delivery, FakeEngine, list[int]]]:
    """Carries out an order with the fakes; returns what came of it, the engine and the seeds delivered."""
    monkeypatch.setattr(demos, "find_format", lambda kind: FakeFormat())

    def call(
        episodes: int, failing: set[int] | None = None, until: int | None = None, **changes: Any
    ) -> tuple[Delivery, FakeEngine, list[int]]:
        overwrite = changes.pop("overwrite", False)
        order = replace(an_order(tmp_path, FormatKind.MP4, episodes), **changes)
        engine = FakeEngine(order.out, failing or set(), until=until)
        delivery = make_demos(order, engine, Watcher(), overwrite=overwrite)
        return delivery, engine, [int(word) for word in (order.out / "all.txt").read_text().split()]

    return call


def an_order(out: Path, kind: FormatKind, episodes: int, shots: Shots | None = None) -> Order:
    return Order(
        suite=load_suite(0),
        split="train",
        tasks=(TASK,),
        episodes=episodes,
        seed=0,
        variant=Variant.PLAIN,
        shots=shots or Shots(size=96),
        kind=kind,
        out=out,
    )


def test_failed_seeds_are_told_and_replaced_by_the_next(deliver: Any, tmp_path: Path) -> None:
    delivery, engine, seeds = deliver(4, failing={1, 4})
    assert seeds == [0, 2, 3, 5]
    assert delivery == Delivery(demonstrations=4, failures=2, short={})
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


def test_finished_demonstrations_survive_a_kill(deliver: Any, tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="what is finished is kept"):
        deliver(5, {2}, until=3)
    with (tmp_path / "demos.jsonl").open("a") as file:
        file.write('{"id": "torn')
    _, engine, seeds = deliver(5, {2})
    assert seeds == [0, 1, 3, 4, 5]
    assert len(engine.tried) == 6 - 3


def test_a_demonstration_without_its_files_is_made_again(deliver: Any, tmp_path: Path) -> None:
    deliver(2)
    (tmp_path / f"{TASK}_s{FIRST + 1}.mp4").unlink()
    assert deliver(2)[1].tried == [1]


def test_a_task_is_given_up_when_its_expert_hardly_succeeds(deliver: Any) -> None:
    delivery, _, seeds = deliver(5, failing=set(range(3, 100)))
    assert seeds == [0, 1, 2]
    assert delivery.short == {TASK: 2}
    assert delivery.failures == 2 * 5 + demos.PATIENCE - 3


def broken_worker(out: Path, monkeypatch: pytest.MonkeyPatch, error: Exception) -> tuple[Order, Callable[..., Any]]:
    """What would make demonstrations, were it not for an error."""

    def fail(*args: object, **kwargs: object) -> None:
        raise error

    monkeypatch.setattr(demos, "perform", fail)
    monkeypatch.setattr(Stagehand, "stage", lambda self, task, variant: None)
    order = an_order(out, FormatKind.MANISKILL, 1)
    return order, demos._Experts(order.kind, order.shots, order.out)()


def test_an_error_of_a_seed_is_a_failed_attempt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order, work = broken_worker(tmp_path, monkeypatch, ZeroDivisionError("by zero"))
    record = work(order.draws(TASK, 1)[0])
    assert (record.success, record.reason) == (False, "unexpected ZeroDivisionError: by zero")


def test_an_error_of_the_machine_stops_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order, work = broken_worker(tmp_path, monkeypatch, SetupError("no driver"))
    with pytest.raises(SetupError, match="no driver"):
        work(order.draws(TASK, 1)[0])


def test_shards_share_the_work(deliver: Any, tmp_path: Path) -> None:
    parts = [
        deliver(5, failing={1}, out=tmp_path / str(index), shard=Shard(index=index, count=2))[2] for index in (1, 2)
    ]
    assert parts == [[0, 2, 4], [3, 5]]


def test_a_folder_takes_only_more_of_the_same(deliver: Any) -> None:
    deliver(3)
    with pytest.raises(UsageError, match="size 96, not 128"):
        deliver(3, shots=Shots(size=128))
    with pytest.raises(UsageError, match="may only be more"):
        deliver(2)
    assert deliver(2, overwrite=True)[2] == [0, 1]


def test_what_is_held_counts_and_not_what_was_asked_for(deliver: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has 1000000 seeds"):
        deliver(1_000_001)
    assert not list(tmp_path.iterdir())
    with pytest.raises(SetupError):
        deliver(9, until=2)  # 8 and 7 are there
    assert deliver(3)[2] == [0, 1, 2]
    assert sorted(path.name[-5] for path in tmp_path.glob("*.mp4")) == ["0", "1", "2"]


def test_all_seeds_of_a_split_can_be_asked_for(tmp_path: Path) -> None:
    order = replace(an_order(tmp_path, FormatKind.MP4, 2), seed=999_998)
    assert [draw.seed for draw in order.draws(TASK, 14)] == [1_999_998, 1_999_999]


def test_starting_anew_deletes_what_was_made_and_nothing_else(deliver: Any, tmp_path: Path) -> None:
    deliver(3)
    (tmp_path / "mine.mp4").touch()
    rows = (tmp_path / "demos.jsonl").read_text()
    (tmp_path / "demos.jsonl").write_text(rows + rows.splitlines()[0].replace(TASK, f"../{TASK}") + "\n")
    outside = tmp_path.parent / f"{TASK}_s{FIRST}.mp4"
    outside.touch()
    assert deliver(1, overwrite=True)[2] == [0]
    assert outside.is_file()
    assert {path.name for path in tmp_path.iterdir()} == {
        "demos.json", "demos.jsonl", "all.txt", "mine.mp4", f"{TASK}_s{FIRST}.mp4",
    }  # fmt: skip


@pytest.mark.parametrize("damage", [b"\xff\xfe\n", b"1\n"])
def test_damaged_records_are_told(deliver: Any, tmp_path: Path, damage: bytes) -> None:
    deliver(1)
    (tmp_path / "demos.jsonl").write_bytes(damage)
    with pytest.raises(UsageError, match="is damaged"):
        deliver(1)
    assert deliver(1, overwrite=True)[2] == [0]


def test_clips_are_filmed_at_control_steps() -> None:
    assert {25, 49, 97, 193} <= set(FRAME_CHOICES)
    for frames in FRAME_CHOICES:
        shots = Shots(frames=frames)
        assert shots.every * (frames - 1) == 192
        assert shots.frame_period_s * (frames - 1) == pytest.approx(9.6)
    with pytest.raises(UsageError, match="25, 33, 49"):
        Shots(frames=50)


def test_statistics_of_histograms_are_those_of_the_pixels() -> None:
    pixels = np.random.default_rng(0).integers(3, 250, (1000, 3))
    counts = np.stack([np.bincount(pixels[:, c], minlength=256) for c in range(3)])
    rows, levels = of_rows(pixels / 255.0), of_histograms(counts, 7)
    assert levels["count"] == [7]
    for name in ("min", "max", "mean", "std", "q01", "q50", "q99"):
        assert np.allclose(np.ravel(levels[name]), rows[name], atol=1.0 / 255.0)


def decoded(path: Path) -> tuple[list[float], np.ndarray]:
    with av.open(path) as file:
        frames = list(file.decode(video=0))
    return [float(frame.time) for frame in frames], np.stack([frame.to_ndarray(format="rgb24") for frame in frames])


def test_joined_films_play_one_after_the_other(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    coarse = [rng.integers(0, 255, (n, 8, 8, 3), dtype=np.uint8) for n in (9, 5, 14)]
    films = [np.kron(film, np.ones((1, 16, 16, 1), np.uint8)) for film in coarse]
    paths = [tmp_path / f"{k}.mp4" for k in range(3)]
    for path, film in zip(paths, films, strict=True):
        write_video(path, film, 5, keyframe_every=4)
    join_videos(tmp_path / "all.mp4", paths)
    times, pictures = decoded(tmp_path / "all.mp4")
    assert np.allclose(times, np.arange(28) / 5.0)
    assert np.array_equal(pictures, np.concatenate([decoded(path)[1] for path in paths]))


@pytest.fixture
def demo(filmed: Filmed) -> Demo:
    from kinebench_drake.suites.tasks.environment import X_WB

    _, performance, clip = filmed
    return Demo(performance=performance, shots=Shots(size=96), film=clip, X_WB=X_WB)


def record_of(demo: Demo) -> Record:
    episode = demo.performance.episode
    return Record(
        id=episode.id, task=episode.task, seed=episode.seed, prompt=episode.prompt, success=True, reason="",
        progress=1.0, clips=demo.clips, facts=episode_facts(episode),
    )  # fmt: skip


@pytest.mark.sapien
def test_truth_holds_things_where_the_scene_had_them(demo: Demo) -> None:
    truth = demo.truth()
    placements = demo.performance.episode.layout().placements
    for k, name in enumerate(truth["objects"]):
        assert np.allclose(truth["base_from_object"][0, k], placements[name].X_BM, atol=1e-3)
    assert np.allclose(truth["control_q"][-1], truth["q"][-1], atol=0.01)  # the servos have caught up
    assert truth["t_s"][-1] == pytest.approx(9.6)


@pytest.mark.sapien
def test_a_video_folder_names_each_clip_with_its_caption(demo: Demo, tmp_path: Path) -> None:
    form, record = VideoFolder(), record_of(demo)
    form.write_part(tmp_path, demo)
    assert all(path.is_file() for path in form.part_files(tmp_path, record))
    form.finish(tmp_path, [record], demo.shots, {"suite": 0, "split": "train"})
    [row] = [json.loads(line) for line in (tmp_path / "metadata.jsonl").read_text().splitlines()]
    assert (tmp_path / row["file_name"]).is_file()
    assert row["text"] == record.prompt
    with np.load(tmp_path / row["truth"]) as truth:
        assert len(truth["t_s"]) == row["frames"] == 49
        X_BG = truth["base_from_tcp"]
    inputs = find_samples(tmp_path / "manifest.jsonl")
    assert not inputs.warnings
    [sample] = inputs.samples
    assert sample.frame_period_s == 0.2
    assert sample.first is not None
    assert np.allclose(sample.first.X_BG, X_BG[0], atol=1e-6)
    assert sample.first.finger_width_m == pytest.approx(0.08, abs=1e-6)
    assert Camera.load(tmp_path / "camera.json").to_json() == demo.shots.camera.to_json()


def doubled(demo: Demo) -> Demo:
    """The demonstration twice in a row, as one of a task that may take so long."""
    p, film = demo.performance, demo.film
    assert film is not None
    episode = replace(p.episode, task=next(task for task in TASKS if TASKS[task].card.clips > 1))
    return replace(
        demo,
        performance=replace(
            p, episode=episode, snapshots=(*p.snapshots, *p.snapshots[1:]), controls=np.tile(p.controls, (2, 1))
        ),
        film=replace(film, **{n: np.concatenate([getattr(film, n), getattr(film, n)[1:]])
                              for n in Clip.__dataclass_fields__ if n != "camera"}),
    )  # fmt: skip


@pytest.mark.sapien
def test_clips_of_a_long_demonstration_meet(demo: Demo) -> None:
    long = doubled(demo)
    assert long.clips == 2
    first, second = long.clip(0), long.clip(1)
    for clip in (first, second):
        assert len(clip.performance.snapshots) == 49
        assert len(clip.performance.controls) == 192
        assert clip.truth()["t_s"][0] == 0.0
    assert first.film is not None
    assert second.film is not None
    assert np.array_equal(first.film.rgb[-1], second.film.rgb[0])


@pytest.mark.sapien
def test_each_clip_is_told_with_the_frame_it_begins_with(demo: Demo, tmp_path: Path) -> None:
    long, form = doubled(demo), VideoFolder()
    form.write_part(tmp_path, long)
    form.finish(tmp_path, [record_of(long)], long.shots, {"suite": 0, "split": "train"})
    film = long.film
    assert film is not None
    for k, sample in enumerate(find_samples(tmp_path / "manifest.jsonl").samples):
        assert sample.first is not None
        assert np.allclose(sample.first.X_BG, film.X_BG[48 * k], atol=1e-6)
    assert not np.allclose(film.X_BG[0], film.X_BG[48], atol=1e-3)


@pytest.mark.sapien
def test_a_lerobot_dataset_holds_what_was_performed(demo: Demo, tmp_path: Path) -> None:
    demo = replace(demo, shots=replace(demo.shots, fps=5.0))
    other = replace(demo.performance, episode=replace(demo.performance.episode, id="other"))
    form, both = LeRobot(), [demo, replace(demo, performance=other)]
    for one in both:
        form.write_part(tmp_path, one)
    files = form.finish(tmp_path, [record_of(one) for one in both], demo.shots, {})
    assert all(path.is_file() for path in files)
    info = json.loads((tmp_path / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, 98, 5)
    samples = list_lerobot(tmp_path, "demos", Choice())
    assert [sample.prompt for sample in samples] == [demo.performance.episode.prompt] * 2
    for k, sample in enumerate(samples):
        track = check(read_lerobot(sample.path, k, tmp_path / "meta" / "info.json", Choice()))
        assert track.q is not None
        assert np.allclose(track.q, [s.q for s in demo.performance.snapshots], atol=1e-6)
        assert np.allclose(track.t_s, 0.2 * np.arange(49))
        assert track.finger_width_m.max() == pytest.approx(0.08, abs=2e-3)
    episodes = pq.read_table(tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"]) for e in episodes] == [(0, 49), (49, 98)]
    key = f"videos/{CAMERA}"
    spans = [(e[f"{key}/from_timestamp"], e[f"{key}/to_timestamp"]) for e in episodes]
    assert np.allclose(spans, [(0.0, 9.8), (9.8, 19.6)])
    times, pictures = decoded(files[-1])
    assert np.allclose(times, np.arange(98) / 5.0)
    assert np.array_equal(pictures[:49], pictures[49:])
    stats = json.loads((tmp_path / "meta" / "stats.json").read_text())
    assert set(stats) == set(info["features"])
    assert np.shape(stats[CAMERA]["mean"]) == (3, 1, 1)
    assert stats[STATE]["count"] == [98]


@pytest.mark.sapien
def test_maniskill_trajectories_hold_states_and_lead_to_success(tmp_path: Path) -> None:
    order = an_order(tmp_path, FormatKind.MANISKILL, 1)
    make_demos(order, create_engine(EngineKind.LOCAL, 1), Watcher())
    path = tmp_path / f"{TASK}.h5"
    assert not (tmp_path / ".parts").exists()
    [sample] = list_maniskill(path, path.name)
    assert (sample.task, sample.seed, sample.success, sample.rate_hz) == (f"KineBench/{TASK}", FIRST, True, 20.0)
    track = check(read_maniskill(path, "traj_0", sample.rate_hz, Choice()))
    assert len(track.t_s) == 193
    with h5py.File(path) as file:
        group = file["traj_0"]
        assert group["actions"].shape == (192, 8)
        assert group["success"][-1]
        assert group["env_states/actors/green"].shape == (193, 13)
        actions = np.asarray(group["actions"])
    with Stage(TASK, renders=False) as stage:  # the commands alone lead to the same end
        [draw] = order.draws(TASK, 1)
        stage.reset(draw.episode())
        for action in actions:
            stage._env.step(action)
        assert stage.outcome().success
        assert track.q is not None
        assert np.allclose(stage.snapshot().q, track.q[-1], atol=1e-6)
