"""What counts as input, in which order, and under which ids."""

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from tests.rows import make_row


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")


def test_a_folder_yields_all_trajectory_files_except_hidden_ones_and_run_outputs(
    tmp_path, archive, maniskill, dataset, t_s, q
):
    archive("b.npz", t_s=t_s, q=q)
    maniskill({"traj_0": {"obs/agent/qpos": q}, "traj_1": {"obs/agent/qpos": q}}, {})
    dataset({0: {"observation.qpos": q}}, {"observation.qpos": 7})
    touch(tmp_path, "sub/a.CSV", "notes.txt", "clip.mp4", ".hidden.npz", ".git/x.npz", "sub/deep/b.npz")
    touch(tmp_path, "old/samples.jsonl", "old/results.json", "old/tracks/c.npz", "out/tracks/d.npz")
    touch(tmp_path, "stopped/samples.jsonl", "stopped/run.json", "stopped/tracks/e.npz")
    samples = find_trajectories(tmp_path, TrajectoryOptions(), out=tmp_path / "out", model="m", task="t")
    assert [(s.id, s.video) for s in samples] == [
        ("b", "b.npz"),
        ("demo-traj_0", "demo.h5#traj_0"),
        ("demo-traj_1", "demo.h5#traj_1"),
        ("ds-episode_000000", "ds/data/chunk-000/episode_000000.parquet#episode_000000"),
        ("a", "sub/a.CSV"),
        ("sub-deep-b", "sub/deep/b.npz"),
    ]
    assert {(s.model, s.task) for s in samples} == {("m", "t")}
    assert samples == find_trajectories(tmp_path, TrajectoryOptions(), out=tmp_path / "out", model="m", task="t")


def test_tracks_of_an_output_folder_keep_the_labels_of_their_rows(tmp_path):
    row = make_row(
        **{"id": "a", "video": "a.mp4", "task": "T", "model": "M", "status": Status.OK, "reason": None},
        content_hash="0",
        extra={"seed": 4, "prompt": "p"},
    )
    with ResultStore(tmp_path) as store:
        store.append(row, 0.1)
    touch(tmp_path, "tracks/a.npz", "tracks/b.npz", "tracks/.4711.part.a.npz")
    for source in (tmp_path, tmp_path / "tracks"):
        a, b = find_trajectories(source, TrajectoryOptions(), task="other")
        assert (a.id, a.task, a.model, a.seed, a.prompt, a.video) == ("a", "T", "M", 4, "p", "tracks/a.npz")
        assert (b.id, b.task, b.model, b.seed) == ("b", "other", None, None)


def test_ids_are_unique_regardless_of_case(tmp_path):
    touch(tmp_path, "x/a.npz", "y/a.npz", "a.csv", "a.npz", "b.csv")
    ids = [s.id for s in find_trajectories(tmp_path, TrajectoryOptions())]
    assert len({i.casefold() for i in ids}) == 5
    assert {"x-a", "y-a", "b"} <= set(ids)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("absent", "no such file"),
        ("a.mp4", r"found a \.mp4 file, expected a trajectory"),
        ("plain", "found a nameless file"),
        ("empty", r"holds no trajectory \(found nothing\)"),
        ("films", r"holds no trajectory \(found 1 x \.mp4\)"),
    ],
)
def test_paths_without_trajectories_are_refused(tmp_path, name, told):
    touch(tmp_path, "a.mp4", "plain", "films/a.mp4")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match=told):
        find_trajectories(tmp_path / name, TrajectoryOptions())


def test_the_output_folder_of_the_run_is_refused_as_input(tmp_path):
    touch(tmp_path, "tracks/a.npz")
    with pytest.raises(UsageError, match="input folder itself"):
        find_trajectories(tmp_path, TrajectoryOptions(), out=tmp_path)
    for source in (tmp_path / "tracks", tmp_path / "tracks" / "a.npz"):
        with pytest.raises(UsageError, match=r"the run fills .*tracks"):
            find_trajectories(source, TrajectoryOptions(), out=tmp_path)


@pytest.mark.parametrize("rate", [0.0, -5.0, np.nan, np.inf, 1e-300, 1e300])
def test_rates_out_of_range_are_refused(rate):
    with pytest.raises(UsageError, match="rate_hz is"):
        TrajectoryOptions(rate_hz=rate)
