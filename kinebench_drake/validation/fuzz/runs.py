"""Small output folders, as trees: what is resumed, merged, reported and compared."""

import tempfile
from pathlib import Path

import numpy as np

from kinebench_drake.header import RunHeader
from kinebench_drake.measure import SCHEMA_VERSION
from kinebench_drake.products import GripperTrack, IkStatus, JointTrack
from kinebench_drake.row import Json, SampleRow, Status, dump
from kinebench_drake.trackfile import write_track
from kinebench_drake.validation.fuzz.films import coded, pictures
from kinebench_drake.validation.fuzz.motions import joints, poses, times
from kinebench_drake.validation.fuzz.tree import Tree


def track() -> bytes:
    """A file of tracks/."""
    n, X = len(times()), poses()
    whole = GripperTrack(
        t_s=times(),
        X_CH=X,
        X_BG=X,
        tracked=np.ones(n, dtype=bool),
        confidence=np.full(n, 0.9),
        finger_width_m=np.full(n, 0.04),
    )
    found = JointTrack(
        t_s=times(),
        q=joints(),
        status=(IkStatus.OK,) * n,
        position_error_m=np.zeros(n),
        rotation_error_rad=np.zeros(n),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.npz"
        write_track(path, whole, found, {"manipulability": np.full(n, 0.05), "torque": joints()})
        return path.read_bytes()


def _row(id: str, **changes: object) -> SampleRow:
    fields: dict[str, object] = {
        "video": f"{id}.mp4",
        "task": "StackCube-v1",
        "model": "wan",
        "status": Status.OK,
        "reason": None,
        "content_hash": "0" * 64,
        "feasible": True,
        "metrics": {
            **{"sparc": -2.1, "ldlj": None, "manipulability_mean": 0.05, "manipulability_cost_mean": 8.1},
            **{"tracked_fraction": 1.0, "slowdown_min": 0.4, "time_scale": 0.5, "trajopt_feasible": True},
            **{"anomalies": [{"kind": "freeze", "frame_start": 2, "frame_end": 4, "severity": 3.0}]},
        },
        "null_reasons": {"ldlj": "nothing moves"},
        "details": {
            "noise": {"position_m": 0.001, "rotation_rad": 0.02},
            "limits": [{"joint": 1, "velocity": 0.4}, {"joint": 2, "velocity": 0.2}],
            "slowdown": {"joint": 2, "frame": 3, "kind": "velocity"},
        },
        "extra": {
            "frames": 12,
            "width": 96,
            "height": 96,
            "fps": 10.0,
            "frame_period_s": 0.1,
            "seed": 3,
            "prompt": "go",
        },
    }
    return SampleRow(id=id, **{**fields, **changes})  # type: ignore[arg-type]


def _header(kind: str, config: dict[str, Json]) -> dict[str, Json]:
    return RunHeader(
        schema_version=SCHEMA_VERSION,
        suite_version=None if kind != "suite" else "1",
        kind=kind,
        samples_found=4,
        config={"kind": kind, "limit": None, "jobs": 1, "engine": "local", "seed": 0, "model": None, **config},
        tags={"run": "7"},
        bootstrap_seed=0,
        versions={"kinebench_drake": "0.1.0", "numpy": "2"},
        code_sha256="0" * 64,
        weights_sha256="0" * 64,
        host={"cpu": "x"},
    ).to_json()


def _folder(rows: list[SampleRow], header: dict[str, Json], *, under: str = "") -> dict[str, bytes]:
    timings = "".join(dump({"id": row.id, "wall_s": 1.5}) for row in rows)
    picture = coded(pictures()[0], "jpeg")
    return {
        f"{under}samples.jsonl": "".join(dump(row.to_json()) for row in rows).encode(),
        f"{under}results.json": dump(header, indent=1).encode(),
        f"{under}timings.jsonl": timings.encode(),
        **{f"{under}tracks/{row.id}.npz": track() for row in rows if row.status is Status.OK},
        **{f"{under}thumbnails/{row.id}.jpg": picture for row in rows[:1]},
    }


def _judged(names: str) -> list[SampleRow]:
    fault: dict[str, Json] = {
        "kind": "velocity",
        "frame_start": 3,
        "frame_end": 5,
        "joint": 2,
        "value": 1.7,
        "limit": 1.0,
    }
    rows = [_row(name) for name in names]
    rows[-1] = _row(names[-1], feasible=False, violations=(fault,))
    return rows


def result_trees() -> list[Tree]:
    """Output folders of runs over videos and trajectories, one of them interrupted."""
    rows = [*_judged("abc"), _row("d", status=Status.ERROR, reason="it is broken", metrics={}, feasible=None)]
    score = _folder(rows, _header("score", {"source": "videos", "shard": None}))
    audit = _folder(_judged("ab"), _header("audit", {"source": "tracks", "shard": None}))
    stopped = {name if name != "results.json" else "run.json": data for name, data in audit.items()}
    stopped["samples.jsonl"] += b'{"id": "torn'
    return [score, audit, stopped]


def shard_trees() -> list[Tree]:
    """Two shards of a run."""
    first, second = (_header("audit", {"source": "tracks", "shard": f"{k}/2"}) for k in (1, 2))
    return [{**_folder(_judged("ab"), first, under="one/"), **_folder(_judged("cd"), second, under="two/")}]


def suite_trees() -> list[Tree]:
    """Two suite runs of different models."""
    config: dict[str, Json] = {"suite": 0, "split": "test", "variant": "plain", "rounds": 3, "world_model": "wan"}
    tree: dict[str, bytes] = {}
    for model, successes in (("wan", (True, False, True)), ("hailuo", (False, False, True))):
        rows = [
            _row(
                f"StackCube-v1_s{seed:04d}",
                model=model,
                extra={
                    **{"success": success, "progress": 0.5 + 0.5 * success, "rounds": 2, "seed": seed, "pool": "all"},
                    **{"variant": "plain", "verdict": None if success else "task", "frames": 12},
                    "cause": None if success else {"verdict": "task", "text": "it fell"},
                },
            )
            for seed, success in enumerate(successes)
        ]
        tree |= _folder(rows, _header("suite", config), under=f"{model}/")
    return [tree]
