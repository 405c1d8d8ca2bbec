"""Runs on a Ray cluster of two local nodes: the same bytes as here, and nothing lost with a worker or a node."""

import os
import signal

import pytest
from fake_tools import LOG, Act, broken

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.runner import NullRunObserver
from kinebench_drake.runs.score import score_videos

ray = pytest.importorskip("ray", reason="ray is not installed: pip install 'kinebench-drake[ray]'")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two nodes of one CPU each, whose workers know the fake analyzer and write to `cluster.log`."""
    from ray.cluster_utils import Cluster

    here = os.path.dirname(__file__)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([here, os.path.dirname(os.path.dirname(here))]))
        log = tmp_path_factory.mktemp("log") / "log"
        patch.setenv(LOG, str(log))
        small = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=small)
        cluster.log = log
        cluster.add_node(**small)
        yield cluster
        cluster.shutdown()


@pytest.fixture
def scored(cluster, config):
    """Scores the videos on the cluster; `cluster.log` then tells of that run alone."""

    def run(observer=None, **changes):
        cluster.log.write_text("")
        return score_videos(config(engine=ExecutorKind.RAY, address=cluster.address, jobs=2, **changes), observer)

    return run


def calls(cluster):
    """Names of the acts and processes, one pair for each time that a video was worked on."""
    return [line.split() for line in cluster.log.read_text().splitlines()]


def content(out):
    """All that does not tell of jobs and engine."""
    skipped = ("timings.jsonl", "results.json", "report.html")
    return {
        p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file() and p.name not in skipped
    }


class AtFirst(NullRunObserver):
    """Does something when the first sample is finished."""

    def __init__(self, act):
        self._act = act

    def finish(self, row, wall_s):
        act, self._act = self._act, None
        if act:
            act()


def test_ray_runs_equal_local_runs_byte_by_byte_and_load_models_once_per_worker(
    film, config, tmp_path, cluster, scored
):
    for k, act in enumerate([Act.SLOW, Act.INFEASIBLE, Act.NO_ROBOT, Act.RAISE, Act.SLOW, Act.SLOW]):
        film(f"videos/v{k}.mp4", act)
    score_videos(config(out=tmp_path / "local", overlay=True))
    scored(overlay=True)
    assert content(tmp_path / "out") == content(tmp_path / "local")
    assert 1 <= len({process for _, process in calls(cluster)}) <= 2
    assert not ray.is_initialized()


def test_a_sample_that_kills_its_worker_twice_becomes_an_error_row(film, tmp_path, cluster, scored):
    for k, act in enumerate([Act.FEASIBLE, Act.DIE, Act.FEASIBLE]):
        film(f"videos/v{k}.mp4", act)
    scored()
    rows = read_rows(tmp_path / "out")
    assert [rows[f"v{k}"].status for k in range(3)] == [Status.OK, Status.ERROR, Status.OK]
    assert "lost 2 times over this sample" in rows["v1"].reason
    assert [act for act, _ in calls(cluster)].count("DIE") == 2


def test_samples_of_a_killed_worker_are_computed_by_another(film, config, tmp_path, cluster, scored):
    for k in range(6):
        film(f"videos/v{k}.mp4", Act.SLOW)
    score_videos(config(out=tmp_path / "local"))

    def kill():
        os.kill(int(calls(cluster)[-1][1]), signal.SIGKILL)

    assert scored(AtFirst(kill)).counts[Status.OK] == 6
    assert content(tmp_path / "out") == content(tmp_path / "local")
    assert 2 <= len({process for _, process in calls(cluster)}) <= 3  # the replacement may come too late for a sample


def test_samples_of_a_lost_node_are_computed_on_another(film, config, tmp_path, cluster, scored):
    for k in range(6):
        film(f"videos/v{k}.mp4", Act.SLOW)
    node = cluster.add_node(num_cpus=1, object_store_memory=80 * 2**20)
    summary = scored(AtFirst(lambda: cluster.remove_node(node, allow_graceful=False)))
    assert summary.counts[Status.OK] == 6


def test_an_interrupted_run_keeps_finished_rows_and_resumes(film, tmp_path, scored):
    for k in range(4):
        film(f"videos/v{k}.mp4", Act.SLOW)

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
        scored(make_resources=broken)
