import numpy as np
import pytest

from kinebench_drake.geometry import invert, transform_points
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, WIDE_SIZE, Crop
from kinebench_drake.models.panda.cad import GripperCad, link_meshes
from kinebench_drake.models.panda.description import ARM, GRIPPER, RobotPart
from kinebench_drake.models.perception.network import COORDINATE_SCALE_M
from kinebench_drake.models.robotiq.cad import robotiq_2f85
from training.crops import (
    CLOSE_EVERY,
    WRIST_TARGET,
    Crops,
    Shards,
    Steps,
    frame_camera,
    label,
)
from training.frame import DEPTH_UNIT_M
from training.layout import ShownGripper, TrainedNetwork, random_gripper
from training.render import FRAMES_PER_SCENE, SHOWN, SceneRenderer
from training.scene import TrainingScene

pytestmark = pytest.mark.sapien


def clear_frames(shards: Shards) -> list[int]:
    """Frames that show much of the gripper."""
    shown = [i for i in range(FRAMES_PER_SCENE) if shards[i].gripper.sum() > 800]
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


def test_coordinate_labels_are_points_of_the_cad_model(shards: Shards, cad: GripperCad) -> None:
    for i in clear_frames(shards)[:3]:
        frame = shards[i]
        crop = Crop.of_gripper(frame.X_CH, 1.3, CLOSE_SIZE)
        part, coordinates, log_depth = label(frame, crop)
        rays = crop.rays(2)
        hit = cad.cast(invert(crop.X_CV) @ frame.X_CH, rays.reshape(-1, 3), frame.finger_m)
        same = (hit.part.reshape(part.shape) == part) & (part == RobotPart.HAND)
        p_V = rays[same] * hit.distance.reshape(part.shape)[same][:, None]
        p_H = transform_points(invert(frame.X_CH) @ crop.X_CV, p_V)
        assert np.median(np.abs(p_H - coordinates[same] * COORDINATE_SCALE_M)) < 2e-3
        assert np.isfinite(log_depth[part > 0]).all()


def test_a_handless_scene_shows_an_arm_without_gripper(shards: Shards) -> None:
    parts = np.concatenate([shards[FRAMES_PER_SCENE + i].part.ravel() for i in range(FRAMES_PER_SCENE)])
    shown = set(np.unique(parts))
    assert shown <= {RobotPart.BACKGROUND, *ARM}
    assert len(shown) > 4


@pytest.fixture(scope="module")
def other_shards(tmp_path_factory: pytest.TempPathFactory) -> Shards:
    folder = tmp_path_factory.mktemp("other")
    assert SHOWN[TrainedNetwork.ARM][0] is ShownGripper.OTHER
    SceneRenderer(folder, TrainedNetwork.ARM)(0)
    return Shards([folder])


def test_other_grippers_are_labelled_background(other_shards: Shards) -> None:
    parts = {part for i in range(FRAMES_PER_SCENE) for part in np.unique(other_shards[i].part)}
    assert parts <= {RobotPart.BACKGROUND, *ARM}
    assert len(parts) > 4


@pytest.fixture(scope="module")
def robotiq_shards(tmp_path_factory: pytest.TempPathFactory) -> Shards:
    """One scene with a Robotiq 2F-85, and one with the Franka hand, for the network of the former."""
    folder = tmp_path_factory.mktemp("robotiq")
    shown = SHOWN[TrainedNetwork.ROBOTIQ]
    for seed in (0, shown.index(ShownGripper.FRANKA)):
        SceneRenderer(folder, TrainedNetwork.ROBOTIQ)(seed)
    return Shards([folder])


def test_coordinates_of_a_robotiq_lie_on_its_model_at_the_opening(robotiq_shards: Shards) -> None:
    """The depth of a pixel and the pose of its part give a point on the surface of the CAD model."""
    cad = GripperCad(robotiq_2f85())
    for i in range(FRAMES_PER_SCENE):
        frame = robotiq_shards[i]
        pixels = np.isin(frame.part, GRIPPER)
        if pixels.sum() < 100:
            continue
        camera = frame_camera(frame)
        rays = camera.rays().reshape(-1, 3)[pixels.ravel()]
        distance, _ = cad.first_hits(frame.X_CH, rays, frame.finger_m)
        assert np.median(np.abs(distance - frame.depth[pixels] * DEPTH_UNIT_M)) < 1e-3


def test_a_hand_of_franka_is_background_to_the_network_of_the_robotiq(robotiq_shards: Shards) -> None:
    parts = {part for i in range(FRAMES_PER_SCENE) for part in np.unique(robotiq_shards[FRAMES_PER_SCENE + i].part)}
    assert parts <= {RobotPart.BACKGROUND, *ARM}
    assert len(parts) > 4


@pytest.mark.parametrize("seed", range(8))
def test_other_grippers_stand_on_the_flange(seed: int) -> None:
    gripper = [a for a in random_gripper(np.random.default_rng(seed)) if a.link == "panda_hand"]
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    solid = [transform_points(a.X_LA, corners * a.half) for a in gripper]
    assert all(np.isfinite(box).all() for box in solid)
    # One box begins at the flange, around its axis; the fingers end beyond the palm.
    on_flange = [np.abs(box[:, 2].min()) < 1e-9 and np.abs(box[:, :2].mean(axis=0)).max() < 1e-9 for box in solid]
    assert any(on_flange)
    assert 0.06 < max(box[:, 2].max() for box in solid) < 0.4


def test_crops_of_the_wrist_show_the_last_links(other_shards: Shards) -> None:
    crops = Crops(other_shards, 0, WRIST_TARGET)
    shown = [np.isin(crops[0, slot]["part"].numpy(), WRIST_TARGET.parts).mean() for slot in range(12)]
    assert np.median(shown) > 0.08
    gripper = Crops(other_shards, 0)
    assert np.mean(shown) > np.mean(
        [np.isin(gripper[0, s]["part"].numpy(), WRIST_TARGET.parts).mean() for s in range(12)]
    )


def test_crops_depend_on_seed_and_index_alone(shards: Shards) -> None:
    first = Crops(shards, 3)
    again = Crops(shards, 3)
    other = Crops(shards, 4)
    again[0, 0]
    np.testing.assert_array_equal(first[7, 1]["image"], again[7, 1]["image"])
    assert (first[7, 1]["image"] != other[7, 1]["image"]).any()


def test_all_crops_of_a_step_have_one_size(shards: Shards) -> None:
    crops = Crops(shards, 0)
    batches = list(Steps(range(2 * CLOSE_EVERY), 9))
    sizes = [{crops[item]["image"].shape for item in batch} for batch in batches]
    close = {(3, CLOSE_SIZE, CLOSE_SIZE)}
    wide = {(3, WIDE_SIZE, WIDE_SIZE)}
    assert sizes == [close, *[wide] * (CLOSE_EVERY - 1)] * 2
    assert [len(batch) for batch in batches] == [9, *[4] * (CLOSE_EVERY - 1)] * 2
    item = crops[0, 0]
    assert item["part"].shape == item["log_depth"].shape == item["coordinates"].shape[1:] == (64, 64)


def test_arm_labels_are_points_of_their_links(shards: Shards) -> None:
    """A link's points stay where they are in the link whatever the arm does: their box is that of the link's mesh."""
    low = np.full((len(RobotPart), 3), np.inf)
    high = np.full((len(RobotPart), 3), -np.inf)
    for i in clear_frames(shards):
        part, coordinates, _ = label(shards[i], Crop.of_gripper(shards[i].X_CH, 3.0, CLOSE_SIZE))
        for value in ARM:
            points = coordinates[part == value] * COORDINATE_SCALE_M
            if len(points):
                low[value] = np.minimum(low[value], points.min(0))
                high[value] = np.maximum(high[value], points.max(0))
    seen = [value for value in ARM if np.isfinite(low[value]).all()]
    assert len(seen) >= 4
    for value in seen:
        bounds = link_meshes()[value].bounds
        assert (low[value] > bounds[0] - 0.01).all()
        assert (high[value] < bounds[1] + 0.01).all()


def test_the_same_seed_renders_the_same_frame() -> None:
    frames = [TrainingScene(np.random.default_rng(5)).frame() for _ in range(2)]
    np.testing.assert_array_equal(frames[0].rgb, frames[1].rgb)
    np.testing.assert_array_equal(frames[0].X_CH, frames[1].X_CH)
