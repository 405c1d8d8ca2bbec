"""Obstacles of a file: read, refused with the fix, part of the robot."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kinebench_drake.errors import UsageError
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import load_robot

TURNED = [np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)]
SHAPES = {
    "box": {"box_m": [0.2, 0.4, 0.1], "position_m": [0.5, 0.1, 0.3], "quaternion_wxyz": TURNED},
    "ball": {"sphere_m": 0.05, "position_m": [0.4, 0.4, 0.3]},
    "post": {"cylinder_m": [0.02, 0.6], "position_m": [0.45, -0.3, 0.3]},
    "brick": {"mesh": "meshes/brick.obj", "position_m": [0.6, 0.2, 0.0]},
}


def write_scene(folder: Path, shapes: dict[str, dict[str, object]]) -> Path:
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((0.1, 0.2, 0.3)).export(folder / "meshes" / "brick.obj")
    path = folder / "scene.json"
    path.write_text(json.dumps({"obstacles": [{"name": name, **shape} for name, shape in shapes.items()]}))
    return path


def test_every_shape_has_its_size_and_place(tmp_path: Path) -> None:
    model = CollisionModel(ArmPlant(load_robot(obstacles=write_scene(tmp_path, SHAPES))))
    boxes = {solid.link.removeprefix("obstacle "): solid.box() for solid in model.obstacles}
    half = 0.5 * np.sqrt(0.5) * 0.6
    expected = {"box": [half, half, 0.05], "ball": [0.05] * 3, "post": [0.02, 0.02, 0.3], "brick": [0.05, 0.1, 0.15]}
    for name, shape in SHAPES.items():
        low, high = boxes[name]
        np.testing.assert_allclose(0.5 * (low + high), shape["position_m"], atol=1e-6)
        np.testing.assert_allclose(0.5 * (high - low), expected[name], atol=1e-6)


def test_a_robot_is_the_same_wherever_its_scene_lies_and_another_with_another_scene(tmp_path: Path) -> None:
    here, there = (load_robot(obstacles=write_scene(tmp_path / name, SHAPES)) for name in ("here", "there"))
    fewer = load_robot(obstacles=write_scene(tmp_path / "fewer", {"ball": SHAPES["ball"]}))
    assert here.id == there.id
    assert len({here.id, fewer.id, load_robot().id}) == 3
    assert here.hand_link == load_robot().hand_link


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "cannot be read as JSON"),
        ('{"obstacles": [{"name": "a", "position_m": [0, 0, 0]}]}', "exactly one of box_m, sphere_m"),
        ('{"obstacles": [{"name": "a", "sphere_m": -1, "position_m": [0, 0, 0]}]}', "greater than 0"),
        ('{"obstacles": [{"name": "a/b", "sphere_m": 1, "position_m": [0, 0, 0]}]}', "name"),
        ('{"obstacles": [{"name": "a", "sphere_m": 1, "position_m": [0, 0, NaN]}]}', "finite"),
        ('{"obstacles": [{"name": "a", "mesh": "no.obj", "position_m": [0, 0, 0]}]}', "no mesh file no.obj"),
        (
            '{"obstacles": [{"name": "a", "sphere_m": 1, "position_m": [0, 0, 0], "quaternion_wxyz": [1, 1, 0, 0]}]}',
            "no unit quaternion",
        ),
        (
            '{"obstacles": [{"name": "a", "sphere_m": 1, "position_m": [0, 0, 0]},'
            ' {"name": "a", "sphere_m": 1, "position_m": [0, 0, 0]}]}',
            "two are called 'a'",
        ),
    ],
)
def test_an_unusable_scene_is_refused_with_the_reason(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "scene.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=reason):
        load_robot(obstacles=path)
