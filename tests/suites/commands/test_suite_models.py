"""World models in suite runs: how many are created, that they are closed, and how results identify them."""

import hashlib
import json
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.results.metadata import Shard
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.runs.merge import merge_folders
from kinebench_drake.runs.runner import NullRunObserver
from kinebench_drake.suites.closed_loop.following import ACTION_METRICS, ActionSource
from kinebench_drake.suites.report.pooling import pool_episodes, read_suite_runs
from kinebench_drake.suites.runs import episodes
from kinebench_drake.suites.runs.episodes import EpisodeEvaluator, EpisodeSample, run_suite
from kinebench_drake.suites.runs.suite_config import SuiteConfig
from kinebench_drake.suites.simulator import Snapshot, TaskOutcome
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack
from kinebench_drake.track import GripperTrack
from tests.fakes.resources import FakeResources

did: Counter[str] = Counter()


class Model:
    name = "mine"

    def __init__(self) -> None:
        did["made"] += 1
        did["alive"] += 1
        did["most alive"] = max(did["most alive"], did["alive"])

    def generate(self, request: object, out: Path) -> Path:
        return out

    def close(self) -> None:
        did["alive"] -= 1


class Stored(Model):
    def files(self, episode: str, task: str, round: int) -> list[Path]:
        did["asked for files"] += 1
        return []


class Stage:
    """A stage on which nothing can be done."""

    def __init__(self, *_: object, **__: object) -> None:
        did["simulators"] += 1

    def reset(self, episode: object) -> None:
        raise InputError("the curtain stays down")

    def close(self) -> None:
        did["simulators"] -= 1


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., SuiteConfig]:
    """A run of two episodes on that stage."""
    did.clear()
    module = ModuleType("my_models")
    module.Model = Model
    module.Stored = Stored
    monkeypatch.setitem(sys.modules, "my_models", module)
    monkeypatch.setattr(episodes, "Simulator", Stage)

    def make(world_model: str, **changes: object) -> SuiteConfig:
        told = {"suite": 0, "tasks": ("PullCube-v1",), "episodes": 2, "replays": None}
        told |= {"out": tmp_path / "out", "make_resources": FakeResources, "world_model": world_model}
        return SuiteConfig(**{**told, **changes})

    return make


@pytest.mark.parametrize("name", ["Model", "Stored"])
def test_a_run_creates_one_world_model_and_closes_model_and_simulators(
    config: Callable[..., SuiteConfig], name: str
) -> None:
    rows = run_suite(config(f"my_models:{name}")).rows
    assert [(row.model, row.reason) for row in rows] == [("mine", "the curtain stays down")] * 2
    assert (did["made"], did["alive"], did["simulators"]) == (1, 0, 0)
    assert bool(did["asked for files"]) is (name == "Stored")


def test_a_server_that_does_not_listen_ends_the_run_before_the_first_episode(
    config: Callable[..., SuiteConfig],
) -> None:
    with pytest.raises(SetupError, match=r"the world model at 127\.0\.0\.1:1 cannot be reached"):
        run_suite(config("http://127.0.0.1:1/make"))
    assert not did["simulators"]


def test_videos_that_a_folder_lacks_are_counted_before_the_first_episode(config: Callable[..., SuiteConfig]) -> None:
    class Listener(NullRunObserver):
        def warn(self, message: str) -> None:
            assert not did["simulators"]
            warnings.append(message)

    warnings: list[str] = []
    run_suite(config("my_models:Stored"), Listener())
    assert warnings[0].startswith("mine has no video of 2 of 2 episodes, such as PullCube-v1_s0000")


def test_the_stored_configuration_identifies_the_world_model_without_server_addresses(
    config: Callable[..., SuiteConfig],
) -> None:
    specs = ("http://10.0.0.1/a?key_env=K", "http://10.0.0.2/a?key_env=K")
    one, other = (config(spec, model_name="wan").to_json() for spec in specs)
    assert [name for name in one if one[name] != other[name]] == ["world_model_sha256"]
    assert "10.0.0" not in f"{one} {other}"
    named = config(specs[0], model_name="wan", prompts={"negative_prompt": "blur"}).to_json()
    assert [name for name in one if one[name] != named[name]] == ["negative_prompt"]
    moved, here, changed = (
        config(f"http://{address}/a?name=wan&{options}", model_name="wan").to_json()
        for address, options in (("10.0.0.1", "key_env=K"), ("10.0.0.2", "key_env=K"), ("10.0.0.1", "key_env=L"))
    )
    assert moved == here != changed
    assert config("http:http://10.0.0.3/a?name=wan&key_env=K", model_name="wan").to_json() == moved
    everywhere = config(specs[0], model_name="wan", out=Path("elsewhere")).to_json()
    assert everywhere == one


class Ledger:
    """A worker that writes down when it is closed."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __call__(self, item: int) -> int:
        return item

    def close(self) -> None:
        with self._path.open("a") as file:
            file.write("closed\n")


class Hire:
    """Makes it, in whatever process."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __call__(self) -> Ledger:
        return Ledger(self._path)


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_worker_is_closed_once(tmp_path: Path, jobs: int) -> None:
    outcomes = list(LocalExecutor(jobs=jobs).run(Hire(tmp_path / "ledger"), range(3)))
    assert sorted(outcome.result for outcome in outcomes) == [0, 1, 2]
    assert (tmp_path / "ledger").read_text() == "closed\n" * jobs


@pytest.fixture
def luck(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes without a simulator, whose outcome depends on the id of the sample."""

    def evaluate(self: EpisodeEvaluator, sample: EpisodeSample, resources: object, row: SampleRow) -> SampleRow:
        did[sample.id] += 1
        success = hashlib.sha256(sample.id.encode()).digest()[0] % 2 == 0
        write_track(artifact_path(self.config.out, "tracks", sample.id), *made_track())
        return row.extended(success=success, progress=float(success), rounds=1)

    monkeypatch.setattr(EpisodeEvaluator, "evaluate", evaluate)
    monkeypatch.setattr(EpisodeEvaluator, "artifacts", ("tracks",))


def made_track() -> tuple[GripperTrack, None, dict[str, object]]:
    pose = np.tile(np.eye(4), (2, 1, 1))
    yes = np.ones(2, dtype=bool)
    track = GripperTrack(
        t_s=np.arange(2.0), X_CH=pose, X_BG=pose, tracked=yes, confidence=np.ones(2), finger_width_m=np.zeros(2)
    )
    return track, None, {}


def test_more_samples_extend_a_run_and_merged_shards_equal_it_byte_by_byte(
    config: Callable[..., SuiteConfig], tmp_path: Path, luck
) -> None:
    """Four samples after one, or two shards merged, are the run of four samples, byte by byte."""

    def run(name: str, samples: int, **options: object) -> Path:
        run_suite(config("my_models:Model", out=tmp_path / name, episodes=3, samples=samples, replays=None, **options))
        return tmp_path / name

    once = run("whole", 1)
    before = {row.id: row for row in read_rows(once).values()}
    assert [row.sample_index for row in before.values()] == [0] * 3
    did.clear()
    whole = run("whole", 4)
    assert sum(n for id, n in did.items() if id.startswith("PullCube")) == 9
    rows = read_rows(whole)
    assert {id: rows[id] for id in before} == before
    assert list(rows)[:5] == ["PullCube-v1_s0000", *(f"PullCube-v1_s0000_k{k}" for k in (1, 2, 3)), "PullCube-v1_s0001"]
    parts = [run(f"part{k}", 4, shard=Shard(index=k, count=2)) for k in (1, 2)]
    merge_folders(parts, tmp_path / "merged")
    fresh = run("fresh", 4)
    for name in ("samples.jsonl", "results.json"):
        assert (whole / name).read_bytes() == (fresh / name).read_bytes() == (tmp_path / "merged" / name).read_bytes()
    metrics = json.loads((whole / "results.json").read_text())["aggregates"]["metrics"]
    assert metrics["pass_at_1"]["mean"] == pytest.approx(metrics["success"]["mean"])
    assert (metrics["pass_at_4"]["n"], metrics["pass_at_4"]["total"], metrics["success"]["n"]) == (3, 3, 12)
    assert pool_episodes(read_suite_runs(parts))[0].model == "mine"  # shards of an episode's samples are one run
    with pytest.raises(UsageError, match="9 of its 12 results would be lost"):
        run("whole", 1)


def test_zero_samples_are_refused(config: Callable[..., SuiteConfig]) -> None:
    with pytest.raises(UsageError, match="samples is 0, expected 1 or more"):
        config("my_models:Model", samples=0)


class Scene(Stage):
    """A stage in which the robot waits."""

    camera = benchmark_camera()

    def reset(self, episode: object) -> None:
        return None

    def snapshot(self) -> Snapshot:
        return Snapshot(q=np.zeros(7), fingers_m=np.full(2, 0.04), objects={}, joints={})

    def render(self) -> SimpleNamespace:
        return SimpleNamespace(rgb=np.zeros((384, 384, 3), np.uint8))

    def simulation_state(self) -> dict[str, object]:
        return {}

    def link_pose(self, link: str) -> np.ndarray:
        return np.eye(4)

    def outcome(self) -> TaskOutcome:
        return TaskOutcome(success=False, progress=0.0, conditions={})


def test_an_offline_model_receives_the_action_files_of_the_first_round(
    config: Callable[..., SuiteConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    commanded = ActionTrack(
        t_s=np.arange(2.0), X_BG=np.tile(np.eye(4), (2, 1, 1)), finger_width_m=np.zeros(2), q=np.zeros((2, 7))
    )
    monkeypatch.setattr(episodes, "Simulator", Scene)
    monkeypatch.setattr(ActionSource, "track", lambda *_: commanded)
    run = config("my_models:Stored", episodes=1, condition="actions", frame_period_s=0.1)
    summary = run_suite(run)
    [row] = summary.rows
    assert (
        row.reason
        == "waits for the video of round 1: generate PullCube-v1_s0000_r0.mp4 from ask/PullCube-v1_s0000_r0.png"
    )
    [asked] = summary.pending
    assert asked["actions"] == "PullCube-v1_s0000_r0.json"
    assert asked["frame_period_s"] == 0.1
    assert json.loads((run.out / "ask" / asked["actions"]).read_text()) == commanded.to_json()
    assert (run.out / "ask" / asked["first_frame"]).is_file()
    assert run.to_json()["condition"] == "actions"
    assert config("my_models:Stored").to_json()["condition"] is None
    assert set(ACTION_METRICS) <= set(row.metrics)
