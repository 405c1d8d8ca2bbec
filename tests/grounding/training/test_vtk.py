from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.geometry import pose_difference, transform_points
from kinebench_drake.grounding.crop import GRIPPER_CENTRE_H
from kinebench_drake.grounding.evaluation.clip import find_clips
from kinebench_drake.grounding.training.crops import frame_camera
from kinebench_drake.grounding.training.video import render_videos
from kinebench_drake.grounding.training.vtk import VtkScene
from kinebench_drake.io.npz import open_npz
from kinebench_drake.io.reader import read_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.cad import GripperCad, link_meshes
from kinebench_drake.models.panda.robot import ARM, GRIPPER, HAND_LINK, RobotPart, panda
from kinebench_drake.models.perception.frame import DEPTH_UNIT_M

CLEAR_PX = 1500


@pytest.fixture(scope="module")
def clear_frames():
    scene = VtkScene(np.random.default_rng(0))
    frames = [frame for frame in (scene.frame() for _ in range(5)) if frame.gripper.sum() > CLEAR_PX]
    assert len(frames) >= 2
    return frames


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("videos")
    render_videos(path, [1], lambda line: None)
    return path


def test_the_cad_model_lies_where_the_renderer_draws_the_gripper(clear_frames, cad: GripperCad) -> None:
    for frame in clear_frames:
        v, u = np.nonzero(frame.gripper)
        hit = cad.cast(frame.X_CH, frame_camera(frame).rays()[v, u], frame.finger_m)
        assert (hit.part == frame.part[v, u]).mean() > 0.9
        both = hit.part > 0
        difference = np.abs(hit.distance[both] - frame.depth[v, u][both] * DEPTH_UNIT_M)
        assert np.median(difference) < 2e-4


def test_links_lie_inside_the_boxes_of_their_meshes(clear_frames) -> None:
    seen = 0
    for frame in clear_frames:
        for part, X_CL in zip(ARM, frame.X_CL, strict=True):
            v, u = np.nonzero(frame.part == part)
            p_C = frame_camera(frame).rays()[v, u] * (frame.depth[v, u] * DEPTH_UNIT_M)[:, None]
            p_L = transform_points(np.linalg.inv(X_CL), p_C)
            low, high = link_meshes()[part].bounds
            assert ((p_L > low - 1e-3) & (p_L < high + 1e-3)).all()
            seen += len(v) > 100
    assert seen >= 4


def test_a_handless_scene_shows_no_gripper() -> None:
    frame = VtkScene(np.random.default_rng(0), handless=True).frame()
    assert not np.isin(frame.part, GRIPPER).any()


def test_the_same_seed_renders_the_same_frame() -> None:
    first, again = (VtkScene(np.random.default_rng(3)).frame() for _ in range(2))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    np.testing.assert_array_equal(first.X_CH, again.X_CH)


def test_truth_of_a_video_is_that_of_its_joint_angles(folder: Path) -> None:
    (file,) = find_clips(folder)
    clip, frames = file.load(), read_video(file.video).frames
    with open_npz(file.truth) as truth:
        arrays = {name: truth[name] for name in truth.files}
    assert len(frames) == len(clip.t_s) == len(arrays["q"]) == len(arrays["visible"])
    assert frames.shape[1:3] == (clip.camera.height, clip.camera.width)
    arm = ArmPlant(panda())
    for q, X_BH, X_BG, X_CH in zip(
        arrays["q"], arrays["base_from_hand"], arrays["base_from_tcp"], clip.X_CH, strict=True
    ):
        np.testing.assert_allclose(arm.link_poses(q)[HAND_LINK], X_BH, atol=1e-9)
        np.testing.assert_allclose(arm.forward(q), X_BG, atol=1e-9)
        np.testing.assert_allclose(clip.camera.X_BC @ X_CH, X_BH, atol=1e-9)


def test_motions_are_smooth_and_mostly_in_view(folder: Path) -> None:
    clip = find_clips(folder)[0].load()
    distance, angle = pose_difference(clip.X_CH[:-1], clip.X_CH[1:])
    assert 0 < distance.max() < 0.5
    assert angle.max() < 1.0
    pixel = clip.camera.project(transform_points(clip.X_CH, GRIPPER_CENTRE_H[None])[:, 0])
    assert ((pixel > 0) & (pixel < [clip.camera.width, clip.camera.height])).all(axis=1).mean() >= 0.5


def test_a_second_run_renders_nothing(folder: Path) -> None:
    before = (folder / "manifest.jsonl").read_bytes()
    lines: list[str] = []
    render_videos(folder, [1], lines.append)
    assert not lines
    assert (folder / "manifest.jsonl").read_bytes() == before


def test_parts_are_those_of_the_robot(clear_frames) -> None:
    assert {int(p) for frame in clear_frames for p in np.unique(frame.part)} <= {int(p) for p in RobotPart}
