"""Cameras by name and by file."""

import json

import numpy as np
import pytest

from kinebench_drake.camera import CameraSource, benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.camerafile import read_camera, save_camera
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.geometry import pose_difference
from kinebench_drake.named_cameras import find_camera, named_cameras


def test_cameras_known_by_name_are_distinct_upright_and_look_at_the_workspace():
    cameras = list(named_cameras().values())
    names = [name for camera in cameras for name in (camera.name, *camera.also)]
    assert len(names) == len(set(names))
    for k, one in enumerate(cameras):
        X_BC = one.setting.camera.X_BC
        assert X_BC[2, 1] < 0.05, one.name  # y down, or the picture of a camera from above
        away = invert_point(X_BC, np.array([0.3, 0.0, 0.2]))
        assert away[2] > 0.1, one.name  # in front of the camera
        for other in cameras[:k]:
            moved_m, turned_rad = pose_difference(X_BC, other.setting.camera.X_BC)
            zoom = abs(np.log(one.fov_deg / other.fov_deg))
            assert moved_m > 1e-3 or turned_rad > 1e-3 or zoom > 1e-3, (one.name, other.name)


def invert_point(X_BC, p_B):
    return X_BC[:3, :3].T @ (p_B - X_BC[:3, 3])


def test_a_camera_is_read_by_its_name_its_other_name_or_its_file(tmp_path):
    save_camera(benchmark_camera(), tmp_path / "mine.json")
    for text in ("benchmark", str(tmp_path / "mine.json")):
        np.testing.assert_allclose(read_camera(text).camera.X_BC, benchmark_camera().X_BC)
    tabletop = read_camera("libero-tabletop")
    assert read_camera("libero-kitchen") is tabletop
    assert tabletop.table_height_m == -0.012
    assert find_camera("no-such") is None


@pytest.mark.parametrize(
    ("text", "found"), [("libero-tabeltop", "did you mean libero-tabletop?"), ("x.json", "x.json")]
)
def test_an_unknown_camera_is_reported_in_one_line_with_the_nearest_name(text, found):
    with pytest.raises(UsageError) as caught:
        read_camera(text)
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_camera_of_a_manifest_may_be_a_name(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 96, 96, 3), np.uint8))
    (tmp_path / "manifest.jsonl").write_text(json.dumps({"video": "a.npy", "camera": "libero-tabletop"}) + "\n")
    (sample,) = find_samples(tmp_path / "manifest.jsonl").samples
    assert sample.camera_source is CameraSource.MANIFEST
    assert sample.camera is read_camera("libero-tabletop").camera
    assert sample.table_height_m == -0.012
