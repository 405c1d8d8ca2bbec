import numpy as np
import pytest

from kinebench_drake.geometry import invert, transform_points
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.training.dataset import CROP_SIZE, Crops, Shards, frame_camera, label
from kinebench_drake.models.perception.frame import DEPTH_UNIT_M
from kinebench_drake.grounding.training.render import FRAMES_PER_SCENE
from kinebench_drake.grounding.training.scene import Scene
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.part import Part
from kinebench_drake.models.perception.network import COORDINATE_SCALE_M

pytestmark = pytest.mark.sapien


def clear_frames(shards: Shards) -> list[int]:
    """Frames that show much of the gripper."""
    shown = [i for i in range(FRAMES_PER_SCENE) if (shards[i].depth > 0).sum() > 1500]
    assert len(shown) >= 3
    return shown


def test_the_cad_model_lies_where_the_renderer_draws_the_gripper(shards: Shards, cad: GripperCad) -> None:
    for i in clear_frames(shards):
        frame = shards[i]
        camera = frame_camera(frame)
        v, u = np.nonzero(frame.gripper)
        hit = cad.cast(frame.X_CH, camera.rays()[v, u], frame.finger_m)
        assert (hit.part == frame.part[v, u]).mean() > 0.9
        both = hit.part > 0
        difference = np.abs(hit.distance[both] - frame.depth[v, u][both] * DEPTH_UNIT_M)
        assert np.median(difference) < 2e-3


def test_labels_are_points_of_the_cad_model(shards: Shards, cad: GripperCad) -> None:
    for i in clear_frames(shards)[:3]:
        frame = shards[i]
        crop = Crop.of_gripper(frame.X_CH, 1.3, CROP_SIZE)
        part, coordinates, log_depth = label(frame, crop)
        rays = crop.rays(2)
        hit = cad.cast(invert(crop.X_CV) @ frame.X_CH, rays.reshape(-1, 3), frame.finger_m)
        same = (hit.part.reshape(part.shape) == part) & (part == Part.HAND)
        p_V = rays[same] * hit.distance.reshape(part.shape)[same][:, None]
        p_H = transform_points(invert(frame.X_CH) @ crop.X_CV, p_V)
        assert np.median(np.abs(p_H - coordinates[same] * COORDINATE_SCALE_M)) < 2e-3
        assert np.isfinite(log_depth[part > 0]).all()


def test_a_handless_scene_shows_an_arm_without_gripper(shards: Shards) -> None:
    parts = np.concatenate([shards[FRAMES_PER_SCENE + i].part.ravel() for i in range(FRAMES_PER_SCENE)])
    assert set(np.unique(parts)) == {Part.BACKGROUND, Part.ARM}


def test_crops_depend_on_seed_and_index_alone(shards: Shards) -> None:
    first, again, other = Crops(shards, 3, 10), Crops(shards, 3, 10), Crops(shards, 4, 10)
    again[0]
    np.testing.assert_array_equal(first[7]["image"], again[7]["image"])
    assert (first[7]["image"] != other[7]["image"]).any()
    item = first[2]
    assert item["image"].shape == (3, CROP_SIZE, CROP_SIZE)
    assert item["part"].shape == item["log_depth"].shape == item["coordinates"].shape[1:] == (64, 64)


def test_the_same_seed_renders_the_same_frame() -> None:
    frames = [Scene(np.random.default_rng(5)).frame() for _ in range(2)]
    np.testing.assert_array_equal(frames[0].rgb, frames[1].rgb)
    np.testing.assert_array_equal(frames[0].X_CH, frames[1].X_CH)
