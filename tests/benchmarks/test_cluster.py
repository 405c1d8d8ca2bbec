"""Report of runs on a cluster; tests/cli/test_ray.py tests the runs themselves."""

import os
import signal
import subprocess
import sys
import time

from benchmarks.cluster import WORKER_TITLE, ClusterTrial, WorkerKiller, section
from benchmarks.process import children, command_line

STAND_IN = """
import subprocess, sys
for name in sys.argv[1:]:
    subprocess.Popen(["bash", "-c", f"exec -a '{name}' sleep 60"])
print(flush=True)
sys.stdin.read()
"""


def test_the_section_names_files_that_differ_between_cluster_and_local_run():
    def told(unlike=()):
        trial = ClusterTrial(
            command=("score", "a b"),
            samples=7,
            killed_node=2,
            killed_after=3,
            workers=(1, 1),
            files=15,
            different_files=unlike,
            different_values=("config.engine",),
        )
        return section([trial])

    assert "| `score 'a b'` | 7 | 1 + 1 | on node 2, after 3 samples | 15 of 15 | `config.engine` |" in told()
    assert "| 14 of 15, not `samples.jsonl` |" in told(("samples.jsonl",))


def test_one_busy_worker_is_killed_after_half_of_the_samples():
    nodes = [
        subprocess.Popen([sys.executable, "-c", STAND_IN, *names], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for names in ([WORKER_TITLE, "ray::IDLE"], [f"{WORKER_TITLE}.work"])
    ]
    try:
        for node in nodes:
            node.stdout.readline()
        started = [children(node.pid) for node in nodes]
        while not all(command_line(pid).startswith("ray::") for pids in started for pid in pids):
            time.sleep(0.01)  # they take their names a moment after they are started
        killer = WorkerKiller(raylets=[node.pid for node in nodes], after=2)
        killer(1)
        assert killer.node is None
        killer(2)
        killer(3)
        assert (killer.node, killer.workers) == (1, (1, 1))
        assert gone(started[1][0])
        assert not any(map(gone, started[0]))
    finally:
        for pid in (pid for pids in started for pid in pids):
            os.kill(pid, signal.SIGKILL)
        for node in nodes:
            node.communicate(b"")


def gone(pid):
    """Whether a process ends within moments: killed, it waits for its parent to be told."""
    for _ in range(50):
        if not command_line(pid):
            return True
        time.sleep(0.01)
    return False
