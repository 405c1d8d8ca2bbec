"""Videos in HDF5 files, as simulators and recorders write them."""

import io
import json

import h5py
import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.reader import read_video
from tests.formats.videos.conftest import frames_of


@pytest.fixture
def file(tmp_path):
    def write(name="a.h5", **sets):
        with h5py.File(tmp_path / name, "w") as file:
            for path, data in sets.items():
                file[path] = data
        return tmp_path / name

    return write


def jpegs(frames):
    coded = []
    for image in frames:
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, format="jpeg", quality=95)
        coded.append(np.frombuffer(buffer.getvalue(), np.uint8))
    padded = np.zeros((len(coded), max(map(len, coded)) + 9), np.uint8)
    for row, data in zip(padded, coded, strict=True):
        row[: len(data)] = data
    return padded


def test_a_file_of_one_image_data_set_is_one_sample(file):
    path = file(**{"observations/images/top": frames_of(0, 4), "action": np.zeros((4, 7))})
    (sample,) = find_samples(path).samples
    assert (sample.id, sample.camera_key) == ("a", "observations/images/top")
    assert np.array_equal(read_video(path, sample.part).frames, frames_of(0, 4))
    assert np.array_equal(read_video(path).frames, frames_of(0, 4))


def test_jpeg_encoded_images_are_decoded(file):
    path = file(**{"observations/images/top": jpegs(frames_of(1, 4)), "lengths": np.arange(4, dtype=np.uint8)})
    (sample,) = find_samples(path).samples
    assert np.abs(read_video(path, sample.part).frames.astype(int) - frames_of(1, 4)).max() < 6


def test_maniskill_episodes_have_their_task_seed_and_frame_period(file):
    rgb = {f"traj_{k}/obs/sensor_data/base_camera/rgb": frames_of(k // 5, 3) for k in (2, 10)}
    path = file("demo.h5", **rgb, **{"traj_2/actions": np.zeros((2, 8))})
    episodes = [{"episode_id": k, "episode_seed": 100 + k} for k in (2, 10)]
    about = {"env_info": {"env_id": "PullCube-v1", "env_kwargs": {"control_freq": 10}}, "episodes": episodes}
    path.with_suffix(".json").write_text(json.dumps(about))
    samples = find_samples(path).samples
    assert [(s.id, s.task, s.seed) for s in samples] == [
        ("demo-traj_2", "PullCube-v1", 102),
        ("demo-traj_10", "PullCube-v1", 110),
    ]
    assert {s.dataset_period_s for s in samples} == {0.1}
    assert np.array_equal(read_video(path, samples[1].part).frames, frames_of(2, 3))


def test_several_cameras_require_a_camera_key(file):
    sets = {f"data/demo_{k}/obs/{name}_image": frames_of(k, 3) for k in (0, 1) for name in ("agentview", "hand")}
    path = file(**sets)
    with pytest.raises(UsageError, match=r"2 cameras \(obs/agentview_image, obs/hand_image\)"):
        find_samples(path)
    samples = find_samples(path, camera_key="agentview_image").samples
    assert [s.id for s in samples] == ["a-demo_0", "a-demo_1"]
    with pytest.raises(InputError, match=r"holds 4 videos .*expected one"):
        read_video(path)


def test_the_camera_key_selects_an_array_of_an_npz_file(tmp_path):
    np.savez(tmp_path / "a.npz", left=frames_of(0, 3), right=frames_of(1, 3))
    (sample,) = find_samples(tmp_path / "a.npz", camera_key="right").samples
    assert np.array_equal(read_video(sample.path, sample.part).frames, frames_of(1, 3))
    with pytest.raises(InputError, match="camera_key NAME"):
        read_video(tmp_path / "a.npz")


def test_hdf5_files_without_a_readable_video_are_refused(file, tmp_path):
    (tmp_path / "bad.h5").write_bytes(b"no file of that kind")
    (tmp_path / "empty.h5").touch()
    other = file("other.h5", secret=frames_of(0, 3))
    path = file("a.h5", actions=np.zeros((3, 7)))
    with h5py.File(path, "a") as linked:
        linked["outside"] = h5py.ExternalLink("other.h5", "secret")
        layout = h5py.VirtualLayout(shape=(3, 96, 96, 3), dtype=np.uint8)
        layout[:] = h5py.VirtualSource(other, "secret", shape=(3, 96, 96, 3))
        linked.create_virtual_dataset("virtual", layout)
    told = {"a.h5": "holds no video", "bad.h5": "not a readable HDF5", "empty.h5": "0 bytes"}
    for name, reason in told.items():
        with pytest.raises(UsageError, match=reason):
            find_samples(tmp_path / name)
