import json

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest

from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.geometry import make_pose, rotation_exp, to_quaternion

N = 12


@pytest.fixture
def t_s():
    return 0.05 * np.arange(N)


@pytest.fixture
def q(t_s):
    rest = np.pi * np.array([0.0, 1 / 8, 0.0, -5 / 8, 0.0, 3 / 4, 1 / 4])
    return rest + 0.3 * np.sin(t_s)[:, None] * np.linspace(1.0, 0.2, 7)


@pytest.fixture
def X_BG(t_s):
    p = np.stack([0.5 + 0.1 * t_s, 0.05 * np.sin(t_s), 0.3 + 0.02 * t_s], axis=1)
    return make_pose(rotation_exp(np.outer(0.4 * t_s, [1.0, 0.5, -0.2])) @ np.diag([1.0, -1.0, -1.0]), p)


@pytest.fixture
def quaternion(X_BG):
    return to_quaternion(X_BG[:, :3, :3])


@pytest.fixture
def archive(tmp_path):
    def write(name="a.npz", **arrays):
        np.savez(tmp_path / name, **arrays)
        return tmp_path / name

    return write


@pytest.fixture
def csv_file(tmp_path):
    def write(header, rows, name="a.csv"):
        lines = [",".join(header), *(",".join(str(v) for v in row) for row in rows)]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return tmp_path / name

    return write


@pytest.fixture
def maniskill(tmp_path):
    """Writes a ManiSkill file: one dict of data sets a trajectory, numbers as given; `about` is the json beside it."""

    def write(trajectories, about=None, name="demo.h5"):
        with h5py.File(tmp_path / name, "w") as file:
            for key, sets in trajectories.items():
                group = file.create_group(key)
                for path, data in sets.items():
                    group[path] = data
        if about is not None:
            (tmp_path / name).with_suffix(".json").write_text(json.dumps(about))
        return tmp_path / name

    return write


@pytest.fixture
def dataset(tmp_path):
    """Writes a LeRobot dataset of episodes {number: {column: rows}}, v2 a file an episode, v3 all in one."""

    def write(episodes, features, *, version="v2.1", fps=20, stamps=None, folder="ds", describe=True):
        root = tmp_path / folder
        for sub in ("meta/episodes/chunk-000", "data/chunk-000"):
            (root / sub).mkdir(parents=True, exist_ok=True)
        features = {
            **{
                k: {"dtype": "float32", "shape": [len(names) if isinstance(names, list) else names], "names": names}
                if isinstance(names, list)
                else {"dtype": "float32", "shape": [names], "names": None}
                for k, names in features.items()
            },
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            "observation.images.top": {"dtype": "video", "shape": [3, 8, 8], "names": ["c", "h", "w"]},
        }
        info = {"codebase_version": version, "fps": fps, "features": features}
        (root / "meta" / "info.json").write_text(json.dumps(info))
        tables = {}
        for number, columns in episodes.items():
            n = len(next(iter(columns.values())))
            times = (np.arange(n) / fps if stamps is None else stamps).astype(np.float32)
            data = {key: [np.asarray(row, dtype=np.float32) for row in rows] for key, rows in columns.items()}
            own = {"timestamp": times, "frame_index": np.arange(n), "episode_index": np.full(n, number)}
            tables[number] = pyarrow.table({**data, **own})
        if version.startswith("v2"):
            for number, table in tables.items():
                parquet.write_table(table, root / "data" / "chunk-000" / f"episode_{number:06d}.parquet")
            lines = [json.dumps({"episode_index": k, "tasks": [f"task {k}"]}) for k in tables]
            (root / "meta" / "episodes.jsonl").write_text("\n".join(lines))
        else:
            parquet.write_table(
                pyarrow.concat_tables(tables.values()), root / "data" / "chunk-000" / "file-000.parquet"
            )
            if describe:
                about = {"episode_index": list(tables), "tasks": [[f"task {k}"] for k in tables]}
                about |= {"data/chunk_index": [0] * len(tables), "data/file_index": [0] * len(tables)}
                parquet.write_table(pyarrow.table(about), root / "meta/episodes/chunk-000/file-000.parquet")
        return root

    return write


def read_all(path, rate_hz=None, **keys):
    """Return the samples of a source and their trajectories, read with these keys."""
    chosen = TrajectoryOptions(rate_hz=rate_hz, reading=Reading(**keys) if keys else None)
    samples = find_trajectories(path, chosen)
    return samples, [read_trajectory(sample, chosen) for sample in samples]
