"""Folders of other benchmarks and of Hugging Face: whose videos they are, and what they show."""

import csv
import json

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest
from PIL import Image

from kinebench_drake.formats.videos.find import find_samples
from tests.formats.videos.conftest import touch

ROWS = [
    {"file_name": "a.mp4", "text": "close the box", "seed": 3, "frame_period_s": 0.125, "task": "CloseBox-v1"},
    {"file_name": "deep/b.mp4", "text": "open the drawer", "seed": 4, "frame_period_s": 0.2, "task": "OpenDrawer-v1"},
]


def write_metadata(folder, name, rows):
    path = folder / name
    if name.endswith("csv"):
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    elif name.endswith("jsonl"):
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    else:
        parquet.write_table(pyarrow.Table.from_pylist(rows), path)


@pytest.mark.parametrize("name", ["metadata.csv", "metadata.jsonl", "metadata.parquet"])
def test_metadata_label_the_videos_of_a_folder(tmp_path, name):
    touch(tmp_path, "a.mp4", "deep/b.mp4", "c.mp4", "a.png")
    write_metadata(tmp_path, name, ROWS)
    told = {s.id: (s.prompt, s.seed, s.task, s.dataset_period_s) for s in find_samples(tmp_path).samples}
    assert told == {
        "a": ("close the box", 3, "CloseBox-v1", 0.125),
        "b": ("open the drawer", 4, "OpenDrawer-v1", 0.2),
        "c": (None, None, None, None),
    }
    assert [s.id for s in find_samples(tmp_path / name).samples] == ["a", "b"]
    assert find_samples(tmp_path).samples[0].first_frame == tmp_path / "a.png"


@pytest.mark.parametrize("name", [f"{300 * 'x'}.mp4", f"{300 * 'x'}/b.mp4", "\ud800.mp4"])
def test_metadata_with_an_impossible_file_name_is_one_bad_sample(tmp_path, name):
    touch(tmp_path, "a.mp4")
    write_metadata(tmp_path, "metadata.jsonl", [{"file_name": name, "text": "long"}])
    good, bad = find_samples(tmp_path).samples
    assert (good.id, good.problem) == ("a", None)
    assert "cannot be followed" in bad.problem


def test_the_metadata_file_nearest_to_a_video_has_precedence(tmp_path):
    touch(tmp_path, "train/a.mp4")
    write_metadata(tmp_path, "metadata.jsonl", [{"file_name": "train/a.mp4", "text": "above"}])
    write_metadata(tmp_path / "train", "metadata.csv", [{"file_name": "a.mp4", "text": "near"}])
    assert find_samples(tmp_path).samples[0].prompt == "near"


def test_symbolic_links_of_the_hugging_face_cache_are_followed(tmp_path):
    touch(tmp_path, "blobs/1234")
    (tmp_path / "snapshot").mkdir()
    (tmp_path / "snapshot" / "a.mp4").symlink_to(tmp_path / "blobs" / "1234")
    write_metadata(tmp_path / "snapshot", "metadata.csv", [{"file_name": "a.mp4", "text": "go"}])
    (sample,) = find_samples(tmp_path / "snapshot").samples
    assert (sample.id, sample.prompt, sample.problem) == ("a", "go", None)


def test_unusable_metadata_exclude_no_video(tmp_path):
    touch(tmp_path, "a.mp4", "metadata.parquet")
    write_metadata(
        tmp_path, "metadata.csv", [{"file_name": "gone.mp4"}, {"file_name": "../b.mp4"}, {"file_name": "x.png"}]
    )
    inputs = find_samples(tmp_path)
    problems = {s.id: s.problem for s in inputs.samples}
    assert problems["a"] is None
    assert "no such file" in problems["gone"]
    assert "inside" in problems["b"]
    unread, images = inputs.warnings
    assert "metadata.parquet is not read" in unread + images
    assert "1 of its rows name no video" in unread + images
    assert str(tmp_path) not in "".join(inputs.warnings)


def test_metadata_columns_of_unexpected_types_are_ignored(tmp_path):
    touch(tmp_path, "a.mp4")
    write_metadata(
        tmp_path,
        "metadata.jsonl",
        [{"file_name": "a.mp4", "task": 7, "seed": "x", "frame_period_s": -3, "caption": "go"}],
    )
    (sample,) = find_samples(tmp_path).samples
    assert (sample.task, sample.seed, sample.dataset_period_s, sample.prompt) == (None, None, None, "go")


def write_frames(folder):
    folder.mkdir(parents=True)
    for k in range(2):
        Image.fromarray(np.full((96, 96, 3), 50 * k, np.uint8)).save(folder / f"frame_{k:05d}.jpg")


@pytest.mark.parametrize("text", ["introduction.txt", "prompt.txt"])
def test_ewmbench_folders_have_model_task_and_prompt(tmp_path, text):
    write_frames(tmp_path / "gt_dataset" / "task_1" / "episode_1" / "video")
    for take in (1, 2):
        write_frames(tmp_path / "wan_dataset" / "task_1" / "episode_1" / str(take) / "video")
    touch(tmp_path, "wan_dataset/task_1/episode_1/1/gripper_detection/video.mp4")
    told = tmp_path / "gt_dataset" / "task_1" / "episode_1" / "prompt"
    touch(told, "init_frame.png")
    (told / text).write_text("pick it up\n")
    samples = find_samples(tmp_path).samples
    assert [(s.id, s.model, s.task) for s in samples] == [
        ("gt-task_1-episode_1", "gt", "task_1"),
        ("wan-task_1-episode_1-1", "wan", "task_1"),
        ("wan-task_1-episode_1-2", "wan", "task_1"),
    ]
    assert {s.prompt for s in samples} == {"pick it up"}
    assert {s.first_frame.name for s in samples} == {"init_frame.png"}
    assert [s.id for s in find_samples(tmp_path / "wan_dataset").samples] == [s.id for s in samples[1:]]


def test_worldarena_folders_have_model_task_prompt_and_first_frame(tmp_path):
    touch(tmp_path, "wan_test/stack_episode_7.mp4", "wan_test/stack_episode_12.mp4", "wan_test_1/stack_episode_7.mp4")
    touch(tmp_path, "first_frame/stack/episode7.png")
    (tmp_path / "instructions" / "stack").mkdir(parents=True)
    (tmp_path / "instructions" / "stack" / "episode12.json").write_text('{"instruction": "stack them"}')
    summary = [{"gt_path": "/gt/stack/episode7.mp4", "image": "/gt/episode7.png", "prompt": ["put it there"]}]
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    wan = {s.id: s for s in find_samples(tmp_path / "wan_test").samples}
    assert {id: (s.prompt, s.model, s.task, s.seed) for id, s in wan.items()} == {
        "stack_episode_7": ("put it there", "wan", "stack", None),
        "stack_episode_12": ("stack them", "wan", "stack", None),
    }
    assert wan["stack_episode_7"].first_frame.name == "episode7.png"
    (changed,) = find_samples(tmp_path / "wan_test_1").samples
    assert (changed.prompt, changed.model) == (None, "wan")


def test_folder_names_alone_do_not_make_a_benchmark_layout(tmp_path):
    touch(tmp_path, "unit_test/a.mp4", "my_dataset/b.mp4")
    assert {(s.id, s.model, s.task) for s in find_samples(tmp_path).samples} == {("a", None, None), ("b", None, None)}


def test_a_submission_to_track_1_of_worldarena_names_its_model(tmp_path):
    touch(tmp_path, "videos/episode_000001.mp4", "videos/episode_000002.mp4")
    (tmp_path / "model_readme.md").write_text("---\nmodel_name: mine \nversion: v1.2\n---\n# mine\n")
    samples = find_samples(tmp_path).samples
    assert [(s.id, s.model) for s in samples] == [("episode_000001", "mine v1.2"), ("episode_000002", "mine v1.2")]
