"""Audit of RoboWM-Bench's recordings: time, memory and verdicts.

Its `replay_json` holds a file a recording, a line a frame: seven joint angles and two finger joints, at 20 Hz.
"""

import json
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.process import run_program
from benchmarks.record import machine_text
from kinebench_drake.results.store import read_rows

_RATE_HZ = 20


def audit_recordings(source: Path, work: Path, count: int | None, jobs: int) -> list[str]:
    """Return the figures of an audit of the first `count` recordings, by the command line."""
    tracks = work / "tracks"
    out = work / "out"
    frames = 0
    tracks.mkdir()
    files = sorted(source.glob("*.json"))[:count]
    for file in files:
        q = np.array([json.loads(line) for line in file.read_text().splitlines()])
        frames += len(q)
        np.savez(tracks / f"{file.stem}.npz", t_s=np.arange(len(q)) / _RATE_HZ, q=q)
    run = run_program(["audit", str(tracks), "--out", str(out), "--jobs", str(jobs), "--replays", "0"])
    memory_mb = run.peak.main_mb + sum(run.peak.workers_mb)
    rows = read_rows(out)
    kinds = Counter(kind for row in rows.values() for kind in {str(v["kind"]) for v in row.violations})
    return [
        f"{len(files)} recordings, {frames} frames: {run.wall_s:.0f} s with {jobs} processes, "
        f"{memory_mb:.0f} MB at most. {machine_text()}",
        "",
        f"Feasible: {sum(row.feasible is True for row in rows.values())}; violations: "
        + ", ".join(f"{kind} {n}" for kind, n in kinds.most_common()),
    ]
