"""Runs on a Ray cluster of two nodes on this machine with a worker killed on the way, compared with local runs."""

import logging
import os
import shlex
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks import markdown
from benchmarks.equivalence import compare_values
from benchmarks.process import children, command_line, run_program
from kinebench_drake.errors import KinebenchError, SetupError
from kinebench_drake.executors.ray import RayWorker
from kinebench_drake.io.jsonl import read_json
from kinebench_drake.results.store import REPORT, RESULTS, SAMPLES, TIMINGS

NODES = 2
"""Nodes of the cluster, each with one CPU and so with one worker."""
SUITE = ("--suite", "0", "--world-model", "oracle", "--pixels-only", "--rounds", "1")
_STORE_BYTES = 100 * 2**20  # of a node's object store; messages are small
WORKER_TITLE = f"ray::{RayWorker.__name__}"  # of our workers' processes, followed by `.work` at a sample
_NOT_COMPARED = {TIMINGS, REPORT, RESULTS}  # wall times; written from results.json, which is compared by value


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterTrial:
    """One run, done locally and on the cluster."""

    command: tuple[str, ...]
    """Arguments of the program."""
    samples: int
    killed_node: int
    """Node of the worker that was killed, from 1."""
    killed_after: int
    """Samples finished before."""
    workers: tuple[int, ...]
    """Workers on each node at that time."""
    files: int
    """Number of files of either folder that were compared byte by byte."""
    different_files: tuple[str, ...]
    different_values: tuple[str, ...]
    """Keys of results.json, "outer.inner", whose values differ."""


@dataclass(slots=True)
class WorkerKiller:
    """Kills a busy worker once a number of samples is finished."""

    raylets: Sequence[int]
    """Processes that start the workers, one a node."""
    after: int
    node: int | None = None
    """Node of the worker that was killed, from 0."""
    workers: tuple[int, ...] = ()
    """Workers on each node at that time."""

    def __call__(self, finished: int) -> None:
        """Kill a worker the first time that enough samples are finished and a worker is busy."""
        if self.node is not None or finished < self.after:
            return
        workers = [[pid for pid in children(raylet) if WORKER_TITLE in command_line(pid)] for raylet in self.raylets]
        busy = [(k, pid) for k, pids in enumerate(workers) for pid in pids if ".work" in command_line(pid)]
        if busy:
            self.node, pid = busy[-1]
            self.workers = tuple(map(len, workers))
            os.kill(pid, signal.SIGKILL)


def compare_runs(commands: Sequence[Sequence[str]], work: Path, log: Callable[[str], None]) -> list[ClusterTrial]:
    """Do every run with one local process and on a cluster, where a worker is killed half-way.

    `commands` are arguments of the program, without `--out` and the options of executors.

    Raises:
        SetupError: Ray is not installed.
        KinebenchError: a run failed, or no worker could be killed.
    """
    if find_spec("ray") is None:
        raise SetupError("this needs the package ray: pip install 'kinebench-drake[ray]'")
    with two_nodes() as (address, raylets):
        return [_compare(tuple(command), work / str(k), address, raylets, log) for k, command in enumerate(commands, 1)]


@contextmanager
def two_nodes() -> Iterator[tuple[str, list[int]]]:
    """Start a cluster on this machine; yields its address and the process of each node that starts workers there."""
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "num_gpus": 0, "object_store_memory": _STORE_BYTES, "include_dashboard": False}
    logging.getLogger("ray").setLevel(logging.ERROR)
    cluster: Any = Cluster(initialize_head=True, head_node_args=node)
    try:
        for _ in range(NODES - 1):
            cluster.add_node(**node)
        cluster.wait_for_nodes()
        raylets = [each.all_processes["raylet"][0].process.pid for each in cluster.list_all_nodes()]
        yield cluster.address, raylets
    finally:
        cluster.shutdown()


def _compare(
    command: tuple[str, ...], work: Path, address: str, raylets: Sequence[int], log: Callable[[str], None]
) -> ClusterTrial:
    local = work / "local"
    ray = work / "ray"
    log(f"{shlex.join(command)}: one local process")
    run_program([*command, "--out", str(local), "--jobs", "1"])
    samples = len((local / SAMPLES).read_text().splitlines())
    killer = WorkerKiller(raylets=raylets, after=samples // 2)
    log(f"{shlex.join(command)}: on the cluster")
    on_cluster = ["--engine", "ray", "--address", address, "--jobs", str(len(raylets))]
    run_program([*command, "--out", str(ray), *on_cluster], on_finished=killer)
    if killer.node is None:
        raise KinebenchError(f"`{shlex.join(command)}`: no worker was at a sample after half of {samples} samples")
    files = _files(local)
    others = _files(ray)
    return ClusterTrial(
        command=command,
        samples=samples,
        killed_node=killer.node + 1,
        killed_after=killer.after,
        workers=killer.workers,
        files=len(files.keys() | others.keys()),
        different_files=tuple(sorted(n for n in files.keys() | others.keys() if files.get(n) != others.get(n))),
        different_values=tuple(
            line.partition(": ")[0] for line in compare_values(read_json(local / RESULTS), read_json(ray / RESULTS))
        ),
    )


def _files(out: Path) -> dict[str, bytes]:
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and path.name not in _NOT_COMPARED
    }


def section(trials: Sequence[ClusterTrial]) -> str:
    """Return the section of the document."""
    rows = [
        [
            f"`{shlex.join(trial.command)}`",
            str(trial.samples),
            " + ".join(map(str, trial.workers)),
            f"on node {trial.killed_node}, after {trial.killed_after} samples",
            f"{trial.files - len(trial.different_files)} of {trial.files}"
            + "".join(f", not `{name}`" for name in trial.different_files),
            ", ".join(f"`{name}`" for name in trial.different_values) or "nothing",
        ]
        for trial in trials
    ]
    head = ("run", "samples", "workers a node", "killed (SIGKILL)", "equal files", "results.json differs in")
    return markdown.section(
        "Tried on two nodes",
        "`python -m benchmarks cluster`: each run with one local process and on a Ray cluster of "
        f"{NODES} nodes on one machine, where a worker is killed at its sample half-way. Compared byte for byte: "
        "samples.jsonl, tracks, thumbnails, videos.",
        markdown.table(head, rows),
    )
