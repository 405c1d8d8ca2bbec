"""Small LeRobot data sets of any arms."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

FPS = 30


def write_episodes(folder: Path, robot_type: str | None, names: Sequence[str], episodes: Sequence[np.ndarray]) -> None:
    """Write a LeRobot v2.1 data set whose episodes have the states (T, n) with these names."""
    (folder / "data/chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    lines = []
    for k, state in enumerate(episodes):
        n = len(state)
        columns = {
            "observation.state": pa.array(state.tolist(), pa.list_(pa.float64())),
            "timestamp": np.arange(n) / FPS,
            "frame_index": np.arange(n),
            "episode_index": np.full(n, k),
            "index": np.arange(n),
            "task_index": np.zeros(n, dtype=int),
        }
        parquet.write_table(pa.table(columns), folder / f"data/chunk-000/episode_{k:06d}.parquet")
        lines.append(json.dumps({"episode_index": k, "tasks": ["t"], "length": n}))
    features = {"observation.state": {"dtype": "float32", "shape": [len(names)], "names": [*names]}}
    info = {"codebase_version": "v2.1", "robot_type": robot_type, "fps": FPS, "features": features}
    info |= {"data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet", "chunks_size": 1000}
    info |= {"total_episodes": len(episodes)}
    (folder / "meta/info.json").write_text(json.dumps(info))
    (folder / "meta/episodes.jsonl").write_text("\n".join([*lines, ""]))


def minimum_jerk(q0: np.ndarray, q1: np.ndarray, n: int) -> np.ndarray:
    """Return a path (n, J) from one posture to another."""
    s = np.linspace(0.0, 1.0, n)[:, None]
    return np.asarray(q0 + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * (q1 - q0))
