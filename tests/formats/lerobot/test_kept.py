"""Datasets with fewer episodes: the rows, videos and metadata of those that are left."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError
from kinebench_drake.formats.lerobot.dataset import LeRobotDataset
from kinebench_drake.formats.lerobot.kept import write_kept
from kinebench_drake.formats.lerobot.reader import list_lerobot_trajectories, open_lerobot_table
from kinebench_drake.formats.lerobot.writer import CAMERA, STATES, join_parts, write_part
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.io.container import write_video

LENGTHS = (12, 9, 15, 7)
KEPT = (1, 3)


def _columns(k: int) -> dict[str, np.ndarray]:
    return {name: k + np.arange(LENGTHS[k] * len(e)).reshape(-1, len(e)) / 100.0 for name, e in STATES.items()}


@pytest.fixture
def v3(tmp_path: Path) -> Path:
    parts = tmp_path / "parts"
    folder = tmp_path / "v3"
    parts.mkdir()
    for k, n in enumerate(LENGTHS):
        write_part(parts, str(k), np.full((n, 32, 32, 3), 40 * k, dtype=np.uint8), _columns(k), fps=10, crf=10)
    prompts = {str(k): f"task {k % 2}" for k in range(len(LENGTHS))}
    join_parts(folder, parts, prompts, 10, benchmark_camera(), size=(32, 32))
    return folder


@pytest.fixture
def v2(v3: Path, tmp_path: Path) -> Path:
    """The same in files of each episode."""
    folder = tmp_path / "v2"
    (folder / "meta").mkdir(parents=True)
    info = json.loads((v3 / "meta" / "info.json").read_text())
    info |= {"codebase_version": "v2.1", "chunks_size": 1000, "total_videos": 4, "data_path": None, "video_path": None}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    table = pq.read_table(v3 / "data" / "chunk-000" / "file-000.parquet")
    rows = []
    stats = []
    for k, n in enumerate(LENGTHS):
        data = folder / "data" / "chunk-000" / f"episode_{k:06d}.parquet"
        video = folder / "videos" / "chunk-000" / CAMERA / f"episode_{k:06d}.mp4"
        for path in (data, video):
            path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table.slice(sum(LENGTHS[:k]), n), data)
        write_video(video, np.full((n, 32, 32, 3), 40 * k, dtype=np.uint8), 10, crf=10)
        rows.append(json.dumps({"episode_index": k, "tasks": [f"task {k % 2}"], "length": n}))
        stats.append(json.dumps({"episode_index": k, "stats": {"action": {"min": [float(k)], "count": [n]}}}))
    (folder / "meta" / "episodes.jsonl").write_text("\n".join([*rows, ""]))
    (folder / "meta" / "episodes_stats.jsonl").write_text("\n".join([*stats, ""]))
    return folder


@pytest.mark.parametrize("version", ["v2", "v3"])
def test_kept_episodes_have_their_rows_videos_and_prompts(
    version: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    source = request.getfixturevalue(version)
    target = tmp_path / "kept"
    write_kept(source, target, KEPT)
    dataset = LeRobotDataset.open(target)
    episodes = list(dataset.episodes(CAMERA))
    assert [episode.number for episode in episodes] == [0, 1]
    assert [episode.length for episode in episodes] == [LENGTHS[k] for k in KEPT]
    assert [episode.tasks for episode in episodes] == [f"task {k % 2}" for k in KEPT]
    samples = list_lerobot_trajectories(target, "kept", TrajectoryOptions())
    for k, sample in zip(KEPT, samples, strict=True):
        with open_lerobot_table(sample) as table:
            for name, values in _columns(k).items():
                np.testing.assert_allclose(table.load(name), values.astype(np.float32))
    begin = 0
    for number, (k, episode) in enumerate(zip(KEPT, episodes, strict=True)):
        rows = pq.read_table(episode.data).to_pydict()
        own = [i for i, e in enumerate(rows["episode_index"]) if e == number]
        assert [rows["index"][i] for i in own] == list(range(begin, begin + LENGTHS[k]))
        begin += LENGTHS[k]
        path, part = dataset.video_part(episode, CAMERA)
        old_path, old_part = LeRobotDataset.open(source).video_part(
            list(LeRobotDataset.open(source).episodes(CAMERA))[k], CAMERA
        )
        assert path.read_bytes() == old_path.read_bytes()
        assert (part.from_s, part.to_s) == (old_part.from_s, old_part.to_s)
    info = json.loads((target / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["splits"]) == (2, begin, {"train": "0:2"})


def test_statistics_are_those_of_the_episodes_that_are_left(v3: Path, tmp_path: Path) -> None:
    write_kept(v3, tmp_path / "kept", KEPT)
    statistics = json.loads((tmp_path / "kept" / "meta" / "stats.json").read_text())
    rows = np.concatenate([_columns(k)["action"] for k in KEPT]).astype(np.float32)
    for kind, value in (("min", rows.min(0)), ("max", rows.max(0)), ("mean", rows.mean(0)), ("std", rows.std(0))):
        np.testing.assert_allclose(statistics["action"][kind], value, rtol=1e-5)
    assert statistics["index"]["max"] == [len(rows) - 1]


def test_per_episode_lists_are_renumbered(v2: Path, tmp_path: Path) -> None:
    write_kept(v2, tmp_path / "kept", KEPT)
    lines = [json.loads(line) for line in (tmp_path / "kept/meta/episodes_stats.jsonl").read_text().splitlines()]
    assert [(line["episode_index"], line["stats"]["action"]["min"]) for line in lines] == [(0, [1.0]), (1, [3.0])]


def test_no_episode_left_is_an_error_and_writes_nothing(v3: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no episode is left"):
        write_kept(v3, tmp_path / "kept", ())
    assert not (tmp_path / "kept").exists()
