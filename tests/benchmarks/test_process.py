"""The program measured from outside: end of samples, memory of its processes, failures."""

import os
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.process import ProcessMemory, children, read_memory, run_program
from kinebench_drake.errors import KinebenchError


def test_memory_counts_a_process_and_its_workers_without_helpers():
    hold = "import sys; filled = b'x' * {} * 2**20; print(len(filled), flush=True); sys.stdin.read()"
    start = "import subprocess, sys; [subprocess.Popen([sys.executable, '-c', c]) for c in sys.argv[1:]]; "
    nested = [hold.format(60) + " # spawn_main", hold.format(60)]
    parent = subprocess.Popen(
        [sys.executable, "-c", start + hold.format(200), *nested], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        for _ in range(3):
            parent.stdout.readline()
        assert len(children(parent.pid)) == 2
        now = read_memory(parent.pid)
        assert 200.0 < now.main_mb < 260.0
        (worker,) = now.workers_mb
        assert 60.0 < worker < 120.0
    finally:
        parent.communicate(b"")
    assert read_memory(parent.pid) is None


def test_the_maximum_of_two_memory_readings_is_taken_per_process():
    one = ProcessMemory(main_mb=1.0, workers_mb=(5.0,))
    assert one.maximum(ProcessMemory(main_mb=2.0, workers_mb=(4.0, 3.0))) == ProcessMemory(
        main_mb=2.0, workers_mb=(5.0, 3.0)
    )


@pytest.mark.slow
def test_finished_samples_are_counted_and_timed_during_a_run(tmp_path):
    (tmp_path / "tracks").mkdir()
    for k in range(4):
        q = np.linspace(0.0, 0.1 * k, 9)[:, None] + [0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8]
        np.savez(tmp_path / "tracks" / f"{k}.npz", t_s=0.2 * np.arange(9), q=q)
    arguments = ["audit", str(tmp_path / "tracks"), "--out", str(tmp_path / "out"), "--jobs", "2"]
    run = run_program(arguments)
    assert len(run.finished_s) == 4
    assert sorted(run.finished_s) == list(run.finished_s)
    assert run.finished_s[0] > 0.0
    assert len(run.peak.workers_mb) == 2
    assert min(run.peak.workers_mb) > 50.0  # Drake's libraries alone are more


def test_a_failed_run_reports_exit_status_and_message_of_the_program(tmp_path):
    before = children(os.getpid())
    with pytest.raises(KinebenchError, match=r"status 2: .*nowhere"):
        run_program(["score", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")])
    assert children(os.getpid()) == before
