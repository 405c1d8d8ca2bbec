import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.camera import CameraSource, benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.geometry import make_pose, rotation_exp
from tests.formats.videos.conftest import touch


def write_manifest(folder, *lines):
    path = folder / "manifest.jsonl"
    path.write_text("".join((line if isinstance(line, str) else json.dumps(line)) + "\n" for line in lines))
    return path


def test_a_folder_yields_video_files_and_frame_folders_only(tmp_path):
    touch(tmp_path, "b.mp4", "a.MOV", "c.gif", "d.webm", "e.mkv", "f.avi", "g.npy", "h.npz", "i.txt", ".j.mp4")
    touch(tmp_path, "frames/0.png", "frames/1.png", "deep/er/k.mp4", "deep/er/preview.png")
    found = find_samples(tmp_path).samples
    assert sorted(s.video for s in found) == [
        *("a.MOV", "b.mp4", "c.gif", "d.webm", "deep/er/k.mp4", "e.mkv", "f.avi", "frames")
    ]
    assert {s.id for s in found} == {"a", "b", "c", "d", "e", "f", "k", "frames"}


def test_single_inputs_are_named_by_their_stem(tmp_path):
    touch(tmp_path, "v/one.mp4", "v/two.npy", "still/0.png")
    for name, id in {"v/one.mp4": "one", "v/two.npy": "two", "still": "still"}.items():
        (sample,) = find_samples(tmp_path / name).samples
        assert (sample.id, sample.problem) == (id, None)


def test_output_folders_of_this_and_other_runs_are_ignored(tmp_path):
    touch(tmp_path, "a.mp4", "out/overlays/a.mp4", "old/samples.jsonl", "old/results.json", "old/overlays/b.mp4")
    assert [s.video for s in find_samples(tmp_path, out=tmp_path / "out").samples] == ["a.mp4"]


@pytest.mark.parametrize("left", ["results.json", "run.json"])
def test_files_written_by_finished_and_unfinished_runs_are_ignored(tmp_path, left):
    touch(tmp_path, "a.mp4", "old/samples.jsonl", f"old/{left}", "old/overlays/b.mp4", "old/thumbnails/b.jpg")
    touch(tmp_path, "mine/samples.jsonl", "mine/c.mp4")  # a name that others use, too
    assert [s.video for s in find_samples(tmp_path).samples] == ["a.mp4", "mine/c.mp4"]


def test_an_output_folder_that_contains_inputs_is_refused(tmp_path):
    touch(tmp_path, "out/overlays/b.mp4", "out/tracks/b.npz", "out/c.mp4", "in/a.mp4")
    out = tmp_path / "out"
    with pytest.raises(UsageError, match="input folder itself"):
        find_samples(out, out=out)
    for source in (out / "overlays", out / "overlays" / "b.mp4"):
        with pytest.raises(UsageError, match=r"the run fills .*overlays"):
            find_samples(source, out=out)
    for other, told in ((out, "itself"), (out / "tracks", r"the run fills .*tracks")):
        with pytest.raises(UsageError, match=told):
            find_samples(tmp_path / "in", out=out, others=[other])
    with pytest.raises(UsageError, match=r"the folder of .*c\.mp4"):
        find_samples(out / "c.mp4", out=out)


def outputs(folder):
    """Make a folder the output folder of a run that wrote overlays, thumbnails, replays and the clips of a model."""
    touch(folder, "samples.jsonl", "results.json", "overlays/a.mp4", "thumbnails/a.jpg", "replays/a.html")
    touch(folder, "videos/a_r0.mp4")


def test_an_output_folder_as_source_yields_only_clips_and_not_drawings_of_a_run(tmp_path):
    outputs(tmp_path)
    touch(tmp_path, "clips/a.mp4")
    assert [s.video for s in find_samples(tmp_path).samples] == ["clips/a.mp4", "videos/a_r0.mp4"]


@pytest.mark.parametrize("name", ["overlays", "overlays/a.mp4", "thumbnails"])
def test_a_file_or_folder_written_by_a_run_is_refused_as_input(tmp_path, name):
    outputs(tmp_path / "run")
    with pytest.raises(UsageError, match=r"was written by a run \(output folder run\); name the videos"):
        find_samples(tmp_path / "run" / name)
    (tmp_path / "run" / "results.json").unlink()
    assert find_samples(tmp_path / "run" / name).samples


def test_an_output_folder_without_clips_is_refused(tmp_path):
    touch(tmp_path, "samples.jsonl", "run.json", "overlays/a.mp4")
    with pytest.raises(UsageError, match="output folder of a run and holds no input"):
        find_samples(tmp_path)


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ((), "found nothing"),
        (("a.txt", "b.txt", "c.npy"), r"found 2 x \.txt"),
        (("meta/info.json", "data/a.parquet"), "LeRobot"),
    ],
)
def test_folders_without_video_are_refused_with_their_content(tmp_path, names, told):
    touch(tmp_path, *names)
    with pytest.raises(UsageError, match=told) as caught:
        find_samples(tmp_path)
    assert "expected" in str(caught.value)


def test_array_files_in_a_source_folder_are_ignored_with_a_warning(tmp_path):
    touch(tmp_path, "a.mp4", "broken.npy")
    np.save(tmp_path / "b.npy", np.zeros((2, 64, 64, 3), np.uint8))
    np.savez(tmp_path / "c.npz", frames=np.zeros((2, 64, 64, 3), np.uint8), t_s=np.zeros(2))
    np.savez(tmp_path / "masks.npz", masks=np.zeros((2, 64, 64), bool))
    found = find_samples(tmp_path)
    assert [s.id for s in found.samples] == ["a"]
    arrays, others = found.warnings
    assert "videos in npy or npz files ignored (2, such as b.npy)" in arrays
    assert "2 files ignored: 1 x .npy, 1 x .npz, such as broken.npy" in others


def test_broken_links_urls_missing_files_and_other_file_types_are_refused(tmp_path):
    touch(tmp_path, "a.txt")
    (tmp_path / "link.mp4").symlink_to("gone.mp4")
    with pytest.raises(UsageError, match=r"link\.mp4: is a symlink to gone\.mp4, which does not exist"):
        find_samples(tmp_path / "link.mp4")
    with pytest.raises(UsageError, match="URLs are not read: download it first"):
        find_samples(Path("https://example.org/a.mp4"))
    with pytest.raises(UsageError, match="no such file"):
        find_samples(tmp_path / "absent")
    with pytest.raises(UsageError, match=r"found a \.txt file, expected a video"):
        find_samples(tmp_path / "a.txt")


def test_equal_stems_have_unique_reproducible_ids(tmp_path):
    touch(tmp_path, "x/a.mp4", "y/a.mp4", "a.mp4", "a.gif", "b.mp4")
    first = find_samples(tmp_path).samples
    ids = {s.video: s.id for s in first}
    assert ids["b.mp4"] == "b"
    assert (ids["x/a.mp4"], ids["y/a.mp4"]) == ("x-a", "y-a")
    assert len({i.casefold() for i in ids.values()}) == 5
    assert [s.id for s in find_samples(tmp_path).samples] == list(ids.values())


def test_ids_are_safe_as_file_names(tmp_path):
    (tmp_path / "v.mp4").touch()
    evil = ["../../etc/passwd", "a/b", ".hidden", "", "x" * 400, "nul\x00l", "con:*?", "ä b"]
    path = write_manifest(tmp_path, *({"video": "v.mp4", **({"id": e} if e else {})} for e in evil))
    samples = find_samples(path).samples
    assert len({s.id for s in samples}) == len(evil)
    for sample in samples:
        assert "v" in sample.id
        assert not set(sample.id) & set('/\\:*?"<>|\0')
        assert not sample.id.startswith(".")
        assert len(f".{sample.id}.npz.1234567.part".encode()) < 200
        (tmp_path / f"{sample.id}.npz").touch()


@pytest.mark.parametrize("key", ["video", "first_frame", "camera"])
def test_a_manifest_line_with_a_too_long_file_name_is_one_bad_sample(tmp_path, key):
    touch(tmp_path, "v.mp4", f"{251 * 'y'}.mp4")
    for name in (f"{300 * 'x'}.mp4", f"{300 * 'x'}/v.mp4"):
        line = {"video": "v.mp4", key: name}
        good, bad = find_samples(write_manifest(tmp_path, {"video": f"{251 * 'y'}.mp4"}, line)).samples
        assert good.problem is None  # although that of a picture beside it would be too long
        assert "line 2" in bad.problem
        assert "File name too long" in bad.problem


def test_explicit_ids_are_made_unique_and_contain_the_stem(tmp_path):
    touch(tmp_path, "clips/v1.mp4")
    video = {"video": "clips/v1.mp4"}
    path = write_manifest(tmp_path, {**video, "id": "run-v1"}, {**video, "id": "run-v1"}, {**video, "id": "episode 7"})
    assert [s.id for s in find_samples(path).samples] == ["run-v1", "run-v1-2", "episode 7-v1"]


def test_a_numbered_id_never_equals_the_stem_of_another_file(tmp_path):
    touch(tmp_path, "a.mp4", "a.gif", "a-2.mp4")
    assert len({s.id for s in find_samples(tmp_path).samples}) == 3


def test_a_manifest_sets_labels_and_times_of_its_videos(tmp_path):
    touch(tmp_path, "v.mp4")
    line = {"video": "v.mp4", "task": "StackCube-v1", "seed": 3, "model": "m", "prompt": "p", "fps": 17, "id": "v3"}
    path = write_manifest(tmp_path, {**line, "frame_period_s": 0.2}, {"video": "v.mp4"})
    full, bare = find_samples(path, model="other", task="T").samples
    assert (full.task, full.seed, full.model, full.prompt, full.fps) == ("StackCube-v1", 3, "m", "p", 17.0)
    assert full.frame_period_s == 0.2
    assert (bare.task, bare.model, bare.frame_period_s) == ("T", "other", None)


def test_a_manifest_sets_the_initial_pose_and_finger_width(tmp_path):
    touch(tmp_path, "v.mp4")
    X_BG = make_pose(rotation_exp([3.0, 0.2, -0.1]), [0.43, 0.0, 0.27])
    line = {"video": "v.mp4", "first_base_from_tcp": X_BG.tolist()}
    lines = [{**line, "first_finger_width_m": width} for width in (0.03, -0.001, 0.081)]
    *whole, pose, bare = find_samples(write_manifest(tmp_path, *lines, line, {"video": "v.mp4"})).samples
    assert [sample.initial_state.finger_width_m for sample in whole] == [0.03, 0.0, 0.08]
    assert np.allclose([sample.initial_state.X_BG for sample in (*whole, pose)], X_BG)
    assert np.isnan(pose.initial_state.finger_width_m)
    assert bare.initial_state is None


def test_unknown_manifest_keys_are_warned_about(tmp_path):
    touch(tmp_path, "v.mp4")
    path = write_manifest(tmp_path, {"video": "v.mp4", "frame_periods": 0.2}, {"video": "v.mp4"})
    inputs = find_samples(path)
    assert all(s.problem is None for s in inputs.samples)
    (warning,) = inputs.warnings
    assert "'frame_periods'" in warning


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('{"video": "v.mp4", "frame_period_s": NaN}', "frame_period_s"),
        ('{"video": "v.mp4", "fps": Infinity}', "fps"),
        ({"video": "v.mp4", "fps": 0}, "fps"),
        ({"video": "v.mp4", "fps": "17"}, "fps is '17'"),
        ({"video": "v.mp4", "fps": True}, "fps"),
        ({"video": "v.mp4", "seed": 1.5}, "seed"),
        ('{"video": "v.mp4", "first_base_from_tcp": [[NaN, 0, 0, 0]]}', "first_base_from_tcp"),
        ({"video": "v.mp4", "first_base_from_tcp": np.eye(4)[:3].tolist()}, "first_base_from_tcp"),
        ({"video": "v.mp4", "first_base_from_tcp": np.diag([1, 1, -1, 1]).tolist()}, "not a rigid pose"),
        ({"video": "v.mp4", "first_base_from_tcp": (2 * np.eye(4)).tolist()}, "not a rigid pose"),
        ({"video": "v.mp4", "first_finger_width_m": 80}, "first_finger_width_m is 80"),
        ('{"video": "v.mp4", "first_finger_width_m": NaN}', "first_finger_width_m"),
        ({"video": 7}, "video is 7"),
        ({"task": "x"}, "video is missing"),
        ({"video": "v.mp4", "camera": {"width": 3}}, "missing keys"),
        ({"video": "v.mp4", "camera": "absent.json"}, "absent.json"),
        ({"video": "v.mp4", "camera": "../camera.json"}, "relative path inside"),
        ({"video": "../v.mp4"}, "relative path inside"),
        ({"video": "a/../../v.mp4"}, "relative path inside"),
        ({"video": "/etc/passwd"}, "relative path inside"),
        ({"video": "link.mp4"}, "leads out"),
        ({"video": "linked/v.mp4"}, "leads out"),
        ("[1, 2]", "is a list"),
        ('{"video": ', "not JSON"),
        ("[" * 100_000, "not JSON"),
    ],
)
def test_an_invalid_manifest_line_is_one_bad_sample(tmp_path, line, told):
    touch(tmp_path, "elsewhere/v.mp4", "in/v.mp4")
    (tmp_path / "in" / "link.mp4").symlink_to(tmp_path / "elsewhere" / "v.mp4")
    (tmp_path / "in" / "linked").symlink_to(tmp_path / "elsewhere")
    path = write_manifest(tmp_path / "in", {"video": "v.mp4", "id": "good v"}, line)
    good, bad = find_samples(path).samples
    assert good.problem is None
    assert told in bad.problem
    assert "line 2" in bad.problem
    assert bad.id


def test_an_empty_or_binary_manifest_is_a_usage_error(tmp_path):
    path = write_manifest(tmp_path, "  ")
    with pytest.raises(UsageError, match="is empty"):
        find_samples(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="cannot be read as text"):
        find_samples(path)


def test_the_nearest_camera_file_has_precedence_over_the_benchmark_camera(tmp_path):
    touch(tmp_path, "v.mp4", "sub/w.mp4", "own/x.mp4")
    benchmark = benchmark_camera()
    assert {s.camera_source for s in find_samples(tmp_path).samples} == {CameraSource.BENCHMARK}
    other = benchmark.resized(192, 192)
    third = benchmark.resized(96, 96)
    save_camera(other, tmp_path / "camera.json")
    save_camera(third, tmp_path / "own" / "camera.json")
    widths = {s.video: (s.camera.width, s.camera_source) for s in find_samples(tmp_path).samples}
    assert widths == {
        "v.mp4": (192, CameraSource.FOLDER),
        "sub/w.mp4": (192, CameraSource.FOLDER),
        "own/x.mp4": (96, CameraSource.FOLDER),
    }
    given = [{"video": "v.mp4", "camera": third.to_json()}, {"video": "v.mp4", "camera": "own/camera.json"}]
    samples = find_samples(write_manifest(tmp_path, *given, {"video": "v.mp4"})).samples
    assert [s.camera_source for s in samples] == [CameraSource.MANIFEST, CameraSource.MANIFEST, CameraSource.FOLDER]
    assert [s.camera.width for s in samples] == [96, 96, 192]
    assert np.allclose(samples[0].camera.X_BC, benchmark.X_BC)


def test_a_frame_folder_uses_its_own_camera_file_before_the_one_beside_it(tmp_path):
    touch(tmp_path, "still/0.png")
    save_camera(benchmark_camera().resized(192, 192), tmp_path / "camera.json")
    for source in (tmp_path, tmp_path / "still"):
        (sample,) = find_samples(source).samples
        assert (sample.camera.width, sample.camera_source) == (192, CameraSource.FOLDER)
    save_camera(benchmark_camera().resized(96, 96), tmp_path / "still" / "camera.json")
    assert find_samples(tmp_path / "still").samples[0].camera.width == 96


@pytest.mark.parametrize("films", [("videos/v.mp4", "videos/preview.png"), ("videos/more/v.mp4", "videos/preview.png")])
def test_a_folder_of_videos_ignores_the_camera_file_beside_it(tmp_path, films):
    touch(tmp_path, *films)
    save_camera(benchmark_camera().resized(192, 192), tmp_path / "camera.json")
    assert find_samples(tmp_path / "videos").samples[0].camera_source is CameraSource.BENCHMARK


def test_an_unreadable_folder_is_a_usage_error(tmp_path, monkeypatch):
    touch(tmp_path, "a/v.mp4", "b/w.mp4")
    look = os.scandir

    def scandir(path):
        if os.path.basename(path) == "b":
            raise PermissionError(13, "Permission denied", path)
        return look(path)

    monkeypatch.setattr(os, "scandir", scandir)
    for source in (tmp_path, tmp_path / "b"):
        with pytest.raises(UsageError, match=r"b: cannot be read \(Permission denied\)"):
            find_samples(source)


@pytest.mark.parametrize("text", ["{", "[]", '{"width": 3}', '{"width": NaN}'])
def test_an_unusable_camera_file_is_a_usage_error(tmp_path, text):
    touch(tmp_path, "v.mp4")
    (tmp_path / "camera.json").write_text(text)
    for source in (tmp_path, tmp_path / "v.mp4", write_manifest(tmp_path, {"video": "v.mp4"})):
        with pytest.raises(UsageError, match=re.escape(str(tmp_path / "camera.json"))):
            find_samples(source)
