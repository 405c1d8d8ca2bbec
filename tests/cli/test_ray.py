"""Runs on a Ray cluster of two local nodes: the same bytes as here, and nothing lost with a worker or a node."""

import os
import signal
from contextlib import ExitStack
from pathlib import Path

import pytest

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.runner import NullRunObserver
from kinebench_drake.runs.score import score_videos
from tests.fakes.behavior import VARIABLE, Fakes
from tests.fakes.records import content
from tests.fakes.resources import fail_to_load

ray = pytest.importorskip("ray", reason="ray is not installed: pip install 'kinebench-drake[ray]'")
pytestmark = pytest.mark.slow

WITHOUT = ("timings.jsonl", "results.json", "report.html")
"""Files that state jobs and engine."""
NODE = {"num_cpus": 1, "object_store_memory": 80 * 2**20}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two nodes of one CPU each, whose workers import the fakes."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
        folder = tmp_path_factory.mktemp("fakes")
        patch.setenv(VARIABLE, str(folder))
        small = {**NODE, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=small)
        cluster.fakes = Fakes(folder)
        cluster.add_node(**small)
        yield cluster
        cluster.shutdown()


@pytest.fixture
def fakes(cluster):
    """Behaviors and calls of the workers, which have the environment of the cluster's start."""
    cluster.fakes.take_calls()
    return cluster.fakes


@pytest.fixture
def scored(cluster, config):
    """Scores the videos on the cluster."""

    def run(observer=None, **changes):
        return score_videos(config(engine=ExecutorKind.RAY, address=cluster.address, jobs=2, **changes), observer)

    return run


class AtFirst(NullRunObserver):
    """Does something when the first sample is finished."""

    def __init__(self, act):
        self._act = act

    def finish(self, row, wall_s):
        act, self._act = self._act, None
        if act:
            act()


def test_ray_runs_equal_local_runs_byte_by_byte_and_load_models_once_per_worker(film, config, fakes, tmp_path, scored):
    behaviors = ({}, {"feasible": False}, {"has_gripper": False}, {"raises": RuntimeError()}, {}, {})
    for k, behavior in enumerate(behaviors):
        film(f"videos/v{k}.mp4", **behavior)
    score_videos(config(out=tmp_path / "local", overlay=True))
    fakes.take_calls()
    scored(overlay=True)
    assert content(tmp_path / "out", WITHOUT) == content(tmp_path / "local", WITHOUT)
    assert 1 <= len(set(fakes.take_calls())) <= 2
    assert not ray.is_initialized()


def test_a_sample_that_kills_its_worker_twice_becomes_an_error_row(film, fakes, tmp_path, scored):
    for k in range(3):
        film(f"videos/v{k}.mp4", kills_worker=k == 1)
    scored()
    rows = read_rows(tmp_path / "out")
    assert [rows[f"v{k}"].status for k in range(3)] == [Status.OK, Status.ERROR, Status.OK]
    assert "lost twice over this sample" in rows["v1"].reason
    assert len(fakes.take_calls()) == 4


@pytest.fixture
def waiting(film, gate):
    """Six films; once the first is finished, the grounding of the others waits until this context is closed."""
    for k in range(6):
        film(f"videos/v{k}.mp4", waits_for=gate if k else None)
    with ExitStack() as closed:
        closed.enter_context(gate.closed())
        yield closed


def test_samples_of_a_killed_worker_are_computed_by_another(config, fakes, waiting, tmp_path, scored):
    processes = []

    def kill():
        processes.extend(fakes.take_calls())
        os.kill(processes[-1], signal.SIGKILL)
        waiting.close()

    assert scored(AtFirst(kill)).counts[Status.OK] == 6
    processes += fakes.take_calls()
    assert 2 <= len(set(processes)) <= 3  # the replacement may come too late for a sample
    score_videos(config(out=tmp_path / "local"))
    assert content(tmp_path / "out", WITHOUT) == content(tmp_path / "local", WITHOUT)


def test_samples_of_a_lost_node_are_computed_on_another(cluster, waiting, scored):
    node = cluster.add_node(**NODE)

    def lose():
        cluster.remove_node(node, allow_graceful=False)
        waiting.close()

    assert scored(AtFirst(lose)).counts[Status.OK] == 6


def test_an_interrupted_run_keeps_finished_rows_and_resumes(film, tmp_path, scored):
    for k in range(4):
        film(f"videos/v{k}.mp4")

    def interrupt():
        raise KeyboardInterrupt

    handler = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        scored(AtFirst(interrupt))
    assert not ray.is_initialized()
    assert signal.getsignal(signal.SIGTERM) is handler
    assert len(read_rows(tmp_path / "out")) == 1
    assert scored().counts[Status.OK] == 4


def test_missing_dependencies_of_workers_stop_the_run_with_a_setup_error(film, scored):
    film("videos/a.mp4")
    with pytest.raises(SetupError, match="doctor"):
        scored(make_resources=fail_to_load)
