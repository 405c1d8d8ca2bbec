import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinebench_drake.camera import CameraSetting, benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.camerafile import load_camera, save_camera
from kinebench_drake.geometry import make_pose


def test_the_benchmark_camera_sees_the_table_in_front_of_the_robot() -> None:
    camera = benchmark_camera()
    p_C = np.linalg.inv(camera.X_BC) @ [0.615, 0.0, 0.0, 1.0]
    u, v = camera.project(p_C[:3])
    assert u == pytest.approx(192.0)
    assert 192.0 < v < 384.0
    assert camera.fx == pytest.approx(192.0 / np.tan(np.pi / 6))


def test_rays_invert_projection() -> None:
    camera = benchmark_camera().resized(96, 96)
    v, u = np.mgrid[0:96, 0:96] + 0.5
    pixels = camera.project(camera.rays() * 0.7)
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-9)


def test_a_camera_keeps_its_aspect_ratio() -> None:
    with pytest.raises(UsageError, match="aspect"):
        benchmark_camera().resized(832, 480)


_MILLIMETRES = make_pose(benchmark_camera().X_BC[:3, :3], 1e3 * benchmark_camera().X_BC[:3, 3])


def _broken(**changes: Any) -> dict[str, Any]:
    return {k: v for k, v in (benchmark_camera().to_json() | changes).items() if v is not None}


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (_broken(fx=None), "missing keys"),
        (_broken(focal=3.0), "unknown keys"),
        (_broken(fx="300"), "fx must be a number"),
        (_broken(width=383.5), "width must be a number"),
        (_broken(fy=-1.0), "positive"),
        (_broken(cx=float("nan")), "cx must be a number"),
        (_broken(width=float("nan")), "width must be a number"),
        (_broken(height=float("inf")), "height must be a number"),
        (_broken(base_from_camera=[[1, 2], [3, 4]]), "4x4"),
        (_broken(base_from_camera="identity"), "4x4"),
        (_broken(base_from_camera=(2 * np.eye(4)).tolist()), "not a rigid pose"),
        (_broken(base_from_camera=np.diag([1.0, 1.0, -1.0, 1.0]).tolist()), "not a rigid pose"),
        (_broken(base_from_camera=_MILLIMETRES.tolist()), "at most 20 m are accepted.*millimetres, divide it by 1000"),
        ([1, 2, 3], "expected an object"),
        ("{", "JSON"),
    ],
)
def test_invalid_camera_files_are_refused_in_one_line(tmp_path: Path, data: object, says: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    with pytest.raises(UsageError, match=says) as caught:
        load_camera(path)
    assert "camera.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_camera_file_may_state_mirroring_and_table_height(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text(
        json.dumps({**benchmark_camera().to_json(), "mirrored": True, "table_height_m": -0.1})
    )
    setting = load_camera(tmp_path / "camera.json")
    assert (setting.mirrored, setting.table_height_m) == (True, -0.1)
    save_camera(benchmark_camera(), tmp_path / "camera.json")
    assert load_camera(tmp_path / "camera.json").table_height_m is None


@pytest.mark.parametrize(
    ("key", "value"), [("mirrored", 1), ("mirrored", None), ("table_height_m", True), ("table_height_m", 80.0)]
)
def test_mirroring_and_table_height_of_the_camera_file_are_checked(key: str, value: object) -> None:
    with pytest.raises(UsageError, match=f"mine: {key} must be"):
        CameraSetting.from_json({**benchmark_camera().to_json(), key: value}, "mine")
