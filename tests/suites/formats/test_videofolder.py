"""Videos with captions, and their manifest."""

import json
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.suites.formats.demo import Demo
from kinebench_drake.suites.formats.videofolder import VideoFolder
from tests.suites.formats.records import doubled, record_of


@pytest.mark.sapien
def test_a_video_folder_names_each_clip_with_its_caption(demo: Demo, tmp_path: Path) -> None:
    form, record = VideoFolder(), record_of(demo)
    form.write_part(tmp_path, demo)
    assert all(path.is_file() for path in form.part_files(tmp_path, record))
    form.finish(tmp_path, [record], demo.options, {"suite": 0, "split": "train"})
    [row] = [json.loads(line) for line in (tmp_path / "metadata.jsonl").read_text().splitlines()]
    assert (tmp_path / row["file_name"]).is_file()
    assert row["text"] == record.prompt
    with np.load(tmp_path / row["truth"]) as truth:
        assert len(truth["t_s"]) == row["frames"] == 49
        X_BG = truth["base_from_tcp"]
    inputs = find_samples(tmp_path / "manifest.jsonl")
    assert not inputs.warnings
    [sample] = inputs.samples
    assert sample.frame_period_s == 0.2
    assert sample.initial_state is not None
    assert np.allclose(sample.initial_state.X_BG, X_BG[0], atol=1e-6)
    assert sample.initial_state.finger_width_m == pytest.approx(0.08, abs=1e-6)
    [labelled] = find_samples(tmp_path).samples  # without the manifest, by the metadata
    assert (labelled.prompt, labelled.task, labelled.dataset_period_s) == (record.prompt, record.task, 0.2)
    assert load_camera(tmp_path / "camera.json").camera.to_json() == demo.options.camera.to_json()


@pytest.mark.sapien
def test_each_clip_is_told_with_the_frame_it_begins_with(demo: Demo, tmp_path: Path) -> None:
    long, form = doubled(demo), VideoFolder()
    form.write_part(tmp_path, long)
    form.finish(tmp_path, [record_of(long)], long.options, {"suite": 0, "split": "train"})
    film = long.video
    assert film is not None
    for k, sample in enumerate(find_samples(tmp_path / "manifest.jsonl").samples):
        assert sample.initial_state is not None
        assert np.allclose(sample.initial_state.X_BG, film.X_BG[48 * k], atol=1e-6)
    assert not np.allclose(film.X_BG[0], film.X_BG[48], atol=1e-3)
