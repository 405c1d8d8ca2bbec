"""LeRobot datasets, read back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from kinebench_drake.formats.lerobot import list_lerobot_trajectories, read_lerobot
from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.trajectory import TrajectoryOptions
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.reader import read_video
from kinebench_drake.suites.formats.demo import Demo
from kinebench_drake.suites.formats.lerobot import CAMERA, STATE, LeRobot, _continuous
from tests.films import decoded
from tests.suites.formats.records import record_of


def test_quaternions_do_not_change_their_sign_along_an_episode() -> None:
    down = np.array([0.0, 0.995, 0.1, 0.0])
    w = np.array([1e-17, -1e-17, -0.01, 0.01, 0.0])
    q = np.where(w[:, None] < 0, -1.0, 1.0) * (np.outer(np.ones(5), down) + w[:, None] * [1.0, 0.0, 0.0, 0.0])
    smooth = _continuous(q)
    assert (smooth[:, 1] > 0.9).all()
    np.testing.assert_array_equal(np.abs(smooth), np.abs(q))


@pytest.mark.sapien
def test_a_lerobot_dataset_holds_what_was_performed(demo: Demo, tmp_path: Path) -> None:
    demo = replace(demo, options=replace(demo.options, fps=5.0))
    other = replace(demo.rollout, episode=replace(demo.rollout.episode, id="other"))
    form, both = LeRobot(), [demo, replace(demo, rollout=other)]
    for one in both:
        form.write_part(tmp_path, one)
    files = form.finish(tmp_path, [record_of(one) for one in both], demo.options, {})
    assert all(path.is_file() for path in files)
    info = json.loads((tmp_path / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, 98, 5)
    samples = list_lerobot_trajectories(tmp_path, "demos", TrajectoryOptions())
    assert [sample.prompt for sample in samples] == [demo.rollout.episode.prompt] * 2
    for k, sample in enumerate(samples):
        track = check(read_lerobot(sample.path, k, tmp_path / "meta" / "info.json", TrajectoryOptions()))
        assert track.q is not None
        assert np.allclose(track.q, [s.q for s in demo.rollout.snapshots], atol=1e-6)
        assert np.allclose(track.t_s, 0.2 * np.arange(49))
        assert track.finger_width_m.max() == pytest.approx(0.08, abs=2e-3)
    episodes = pq.read_table(tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"]) for e in episodes] == [(0, 49), (49, 98)]
    key = f"videos/{CAMERA}"
    spans = [(e[f"{key}/from_timestamp"], e[f"{key}/to_timestamp"]) for e in episodes]
    assert np.allclose(spans, [(0.0, 9.8), (9.8, 19.6)])
    times, pictures = decoded(files[-1])
    assert np.allclose(times, np.arange(98) / 5.0)
    assert np.array_equal(pictures[:49], pictures[49:])
    films = find_samples(tmp_path).samples
    assert [film.prompt for film in films] == [demo.rollout.episode.prompt] * 2
    assert films[0].camera.to_json() == demo.options.camera.to_json()
    for k, film in enumerate(films):
        assert film.dataset_period_s == pytest.approx(0.2)
        assert np.array_equal(read_video(film.path, film.part).frames, pictures[49 * k : 49 * (k + 1)])
    stats = json.loads((tmp_path / "meta" / "stats.json").read_text())
    assert set(stats) == set(info["features"])
    assert np.shape(stats[CAMERA]["mean"]) == (3, 1, 1)
    assert stats[STATE]["count"] == [98]
