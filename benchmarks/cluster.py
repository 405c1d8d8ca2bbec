"""Runs on a Ray cluster of two nodes on this machine, a worker killed on the way, beside the same runs without Ray."""

import json
import logging
import os
import shlex
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.markdown import table
from benchmarks.watched import children, command_line, watch
from kinebench_drake.errors import KinebenchError, SetupError
from kinebench_drake.results.store import REPORT, RESULTS, SAMPLES, TIMINGS
from kinebench_drake.types import Json

HEADING = "## Tried on two nodes"
"""Heading of the section that is written into the document."""
NODES = 2
"""Nodes of the cluster, each with one CPU and so with one worker."""
SUITE = ("--suite", "0", "--world-model", "oracle", "--pixels-only", "--rounds", "1")
_STORE_BYTES = 100 * 2**20  # of a node's object store; what is sent is small
_WORKER = "ray::_Servant"
"""What Ray calls our workers in the list of processes; while they are at a sample `.work` follows."""
_NOT_COMPARED = {TIMINGS, REPORT, RESULTS}  # wall times; written from results.json, which is looked into


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One run, done on this machine alone and on the cluster."""

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
    """Files of either folder whose bytes were compared."""
    unlike: tuple[str, ...]
    """Those of them that were not the same."""
    told_apart: tuple[str, ...]
    """Entries of results.json that were not the same."""


@dataclass(slots=True)
class _Killer:
    """Kills a busy worker once so many samples are finished."""

    raylets: Sequence[int]
    """Processes that start the workers, one a node."""
    after: int
    node: int | None = None
    """Node of the worker that was killed, from 0."""
    workers: tuple[int, ...] = field(default=())

    def __call__(self, finished: int) -> None:
        if self.node is not None or finished < self.after:
            return
        found = [[pid for pid in children(raylet) if _WORKER in command_line(pid)] for raylet in self.raylets]
        busy = [(k, pid) for k, pids in enumerate(found) for pid in pids if ".work" in command_line(pid)]
        if busy:
            self.node, pid = busy[-1]
            self.workers = tuple(map(len, found))
            os.kill(pid, signal.SIGKILL)


def try_out(commands: Sequence[Sequence[str]], work: Path, note: Callable[[str], None]) -> list[Trial]:
    """Do every run with one local process and on a cluster, where a worker is killed half-way.

    Args:
        commands: arguments of the program, without `--out` and all that tells where work is done.
        work: folder for results.
        note: told what is done.

    Raises:
        SetupError: Ray is not installed.
        KinebenchError: a run failed, or no worker could be killed.
    """
    if find_spec("ray") is None:
        raise SetupError("this needs the package ray: pip install 'kinebench-drake[ray]'")
    with two_nodes() as (address, raylets):
        return [_try(tuple(command), work / str(k), address, raylets, note) for k, command in enumerate(commands, 1)]


@contextmanager
def two_nodes() -> Iterator[tuple[str, list[int]]]:
    """A cluster on this machine: its address, and the process of each node that starts workers there."""
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


def _try(
    command: tuple[str, ...], work: Path, address: str, raylets: Sequence[int], note: Callable[[str], None]
) -> Trial:
    here, there = work / "local", work / "ray"
    note(f"{shlex.join(command)}: one local process")
    watch([*command, "--out", str(here), "--jobs", "1"])
    samples = len((here / SAMPLES).read_text().splitlines())
    killer = _Killer(raylets=raylets, after=samples // 2)
    note(f"{shlex.join(command)}: on the cluster")
    on_cluster = ["--engine", "ray", "--address", address, "--jobs", str(len(raylets))]
    watch([*command, "--out", str(there), *on_cluster], finished=killer)
    if killer.node is None:
        raise KinebenchError(f"`{shlex.join(command)}`: no worker was at a sample after half of {samples} samples")
    mine, theirs = _files(here), _files(there)
    return Trial(
        command=command,
        samples=samples,
        killed_node=killer.node + 1,
        killed_after=killer.after,
        workers=killer.workers,
        files=len(mine.keys() | theirs.keys()),
        unlike=tuple(sorted(n for n in mine.keys() | theirs.keys() if mine.get(n) != theirs.get(n))),
        told_apart=tuple(differences(*(json.loads((out / RESULTS).read_text()) for out in (here, there)))),
    )


def _files(out: Path) -> dict[str, bytes]:
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and path.name not in _NOT_COMPARED
    }


def differences(one: Json, other: Json, name: str = "") -> Iterator[str]:
    """Names of entries, "outer.inner", in which two JSON objects differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(one.keys() | other.keys()):
            yield from differences(one.get(key), other.get(key), f"{name}.{key}" if name else key)
    elif one != other:
        yield name


def section(trials: Sequence[Trial]) -> str:
    """The document's section."""
    rows = [
        [
            f"`{shlex.join(trial.command)}`",
            str(trial.samples),
            " + ".join(map(str, trial.workers)),
            f"on node {trial.killed_node}, after {trial.killed_after} samples",
            f"{trial.files - len(trial.unlike)} of {trial.files}" + "".join(f", not `{name}`" for name in trial.unlike),
            ", ".join(f"`{name}`" for name in trial.told_apart) or "nothing",
        ]
        for trial in trials
    ]
    head = ("run", "samples", "workers a node", "killed (SIGKILL)", "files the same", "results.json differs in")
    return "\n".join(
        [
            HEADING,
            "",
            "Written by `python -m benchmarks cluster`: each run with one local process and on a Ray "
            f"cluster of {NODES} nodes on one machine, where a worker is killed at its sample half-way. Compared byte "
            "for byte: samples.jsonl, tracks, thumbnails, films; not timings.jsonl and report.html.",
            "",
            *table(head, rows),
            "",
        ]
    )
