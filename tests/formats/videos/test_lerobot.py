"""Films of LeRobot datasets: the right frames of the right episode, the right camera."""

import io
import json

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest
from PIL import Image

from kinebench_drake.camera import CameraSource, benchmark_camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.reader import read_video
from tests.formats.videos.conftest import SIDE, frames_of, grey, levels, write_info, write_v3_episodes

LENGTHS = (5, 4, 6)
TWO = ("observation.images.front", "observation.images.wrist")


@pytest.mark.parametrize(("version", "codec"), [("v2.0", "h264"), ("v2.1", "h264"), ("v3.0", "h264"), ("v3.0", "av1")])
def test_every_episode_is_a_video_with_its_prompt_and_frames(lerobot, version, codec):
    samples = find_samples(lerobot(version, LENGTHS, codec=codec)).samples
    assert [s.id for s in samples] == [f"ds-episode_{k:06d}" for k in range(3)]
    assert [s.prompt for s in samples] == ["task 0", "task 1", "task 2"]
    assert all(s.video.endswith(f"#episode_{k:06d}") for k, s in enumerate(samples))
    for k, sample in enumerate(samples):
        assert (sample.problem, sample.camera_key) == (None, "observation.images.front")
        assert sample.dataset_period_s == pytest.approx(0.1)
        video = read_video(sample.path, sample.part)
        expected = [grey(k, frame) for frame in range(LENGTHS[k])]
        assert levels(video.frames) == pytest.approx(expected, abs=2.4)  # the next frame is 5 away


def test_a_video_file_of_several_episodes_is_split_also_by_its_own_name(lerobot):
    root = lerobot("v3.0", LENGTHS, keys=TWO)
    file = next(iter(sorted((root / "videos").rglob("*.mp4"))))
    for source in (file, file.parent):
        found = find_samples(source)
        assert [s.part.frames for s in found.samples] == list(LENGTHS)
        assert {s.camera_key for s in found.samples} == {TWO[0]}
        assert any("holds 3 episodes" in warning for warning in found.warnings)


def test_a_video_file_of_one_episode_is_a_plain_video(lerobot):
    root = lerobot("v2.1", LENGTHS)
    file = next(iter(sorted((root / "videos").rglob("*.mp4"))))
    (sample,) = find_samples(file).samples
    assert (sample.id, sample.camera_key) == (file.stem, None)


def test_several_cameras_require_an_unambiguous_camera_key(lerobot):
    root = lerobot("v3.0", keys=TWO)
    with pytest.raises(UsageError, match=r"2 cameras \(.*front, observation.images.wrist\).*camera_key"):
        find_samples(root)
    for wanted in ("wrist", TWO[1]):
        samples = find_samples(root, camera_key=wanted).samples
        assert {s.camera_key for s in samples} == {TWO[1]}
        assert all("wrist" in s.path.as_posix() for s in samples)
    for wanted, told in {
        "images": "fits observation.images.front, observation",
        "top": "is none of its cameras",
    }.items():
        with pytest.raises(UsageError, match=told):
            find_samples(root, camera_key=wanted)


def test_an_unusable_dataset_among_other_folders_is_one_bad_sample(lerobot, tmp_path):
    lerobot("v3.0", keys=TWO)
    (tmp_path / "a.mp4").touch()
    one, bad = find_samples(tmp_path).samples
    assert (one.id, bad.id) == ("a", "ds")
    assert "camera_key" in bad.problem
    assert len(find_samples(tmp_path, camera_key="front").samples) == 4


def test_a_camera_key_without_a_file_of_several_cameras_is_refused(tmp_path):
    (tmp_path / "a.mp4").touch()
    with pytest.raises(UsageError, match="nothing to choose from"):
        find_samples(tmp_path, camera_key="front")


def test_depth_videos_are_not_taken_as_cameras(lerobot):
    root = lerobot("v3.0", keys=TWO)
    info = json.loads((root / "meta" / "info.json").read_text())
    info["features"][TWO[1]]["info"] = {"video.is_depth_map": True}
    (root / "meta" / "info.json").write_text(json.dumps(info))
    assert {s.camera_key for s in find_samples(root).samples} == {TWO[0]}


def test_a_dataset_without_videos_is_refused_with_a_hint_at_audit(tmp_path):
    write_info(tmp_path / "ds", "v3.0", 10, {"action": {"dtype": "float32", "shape": [7]}})
    with pytest.raises(UsageError, match=r"LeRobot dataset has no video.*`audit`"):
        find_samples(tmp_path / "ds")


def test_the_camera_file_of_a_dataset_has_precedence(lerobot):
    root = lerobot("v3.0")
    assert find_samples(root).samples[0].camera_source is CameraSource.BENCHMARK
    save_camera(benchmark_camera().resized(192, 192), root / "meta" / "camera.json")
    save_camera(benchmark_camera().resized(96, 96), root.parent / "camera.json")
    for source in (root, root.parent):
        sample = find_samples(source).samples[0]
        assert (sample.camera.width, sample.camera_source) == (192, CameraSource.FOLDER)


def test_missing_frames_and_videos_are_errors_of_their_episodes(lerobot):
    root = lerobot("v3.0")
    write_v3_episodes(root, ("observation.images.front",), (5, 4, 9), 10)
    *_, last = find_samples(root).samples
    with pytest.raises(InputError, match=r"has 6 frames from 0.9 s to 1.8 s, its metadata says 9"):
        read_video(last.path, last.part)
    last.path.unlink()
    assert all("there is no such file" in s.problem for s in find_samples(root).samples)


@pytest.mark.parametrize(
    "pattern",
    ["../{video_key}.mp4", "/etc/{video_key}", "{video_key.__class__}.mp4", "{nobody}", f"{300 * 'x'}.mp4", "a\0.mp4"],
)
def test_video_path_patterns_that_leave_the_dataset_or_format_attributes_are_refused(lerobot, pattern):
    root = lerobot("v3.0")
    info = json.loads((root / "meta" / "info.json").read_text())
    (root / "meta" / "info.json").write_text(json.dumps({**info, "video_path": pattern}))
    assert all(s.problem for s in find_samples(root).samples)


def test_nan_time_stamps_are_errors_of_their_episodes(lerobot):
    root = lerobot("v3.0")
    file = root / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    name = "videos/observation.images.front/from_timestamp"
    rows = parquet.read_table(file).to_pylist()
    rows[1][name] = float("nan")
    parquet.write_table(pyarrow.Table.from_pylist(rows), file)
    first, second, third = find_samples(root).samples
    assert (first.problem, third.problem) == (None, None)
    assert "has no chunk, file and time stamps" in second.problem


def test_images_in_parquet_files_are_read_as_videos(tmp_path):
    def coded(image):
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, format="png")
        return {"bytes": buffer.getvalue(), "path": None}

    root = tmp_path / "ds"
    key = "observation.images.image"
    write_info(root, "v3.0", 10, {key: {"dtype": "image", "shape": [SIDE, SIDE, 3]}})
    write_v3_episodes(root, (), (3, 2), 10)
    rows = [{key: coded(image), "episode_index": k} for k, n in enumerate((3, 2)) for image in frames_of(k, n)]
    (root / "data" / "chunk-000").mkdir(parents=True)
    parquet.write_table(pyarrow.Table.from_pylist(rows), root / "data" / "chunk-000" / "file-000.parquet")
    first, second = find_samples(root).samples
    assert np.array_equal(read_video(first.path, first.part).frames, frames_of(0, 3))
    assert np.array_equal(read_video(second.path, second.part).frames, frames_of(1, 2))
