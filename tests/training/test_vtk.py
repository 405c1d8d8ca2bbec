from pathlib import Path

import numpy as np
import pytest

from benchmarks.perception.clip import find_clips
from kinebench_drake.geometry import pose_difference, transform_points
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H
from kinebench_drake.io.npz import open_npz
from kinebench_drake.io.reader import read_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import panda
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.description import HAND_LINK
from training.video import render_videos

CLEAR_PX = 1500


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("videos")
    render_videos(path, [1], lambda line: None)
    return path


def test_the_renderer_draws_the_gripper_where_the_cad_model_lies(folder: Path, cad: GripperCad) -> None:
    (file,) = find_clips(folder)
    clip = file.load()
    with open_npz(file.truth) as truth:
        visible = truth["visible"]
    silhouette = clip.masks(cad).sum(axis=(1, 2))
    clear = visible > CLEAR_PX
    assert clear.sum() >= 5
    share = visible[clear] / silhouette[clear]
    assert share.max() < 1.05  # silhouettes ignore what hides the gripper
    assert np.median(share) > 0.7


def test_ground_truth_poses_follow_from_the_joint_angles(folder: Path) -> None:
    (file,) = find_clips(folder)
    clip = file.load()
    frames = read_video(file.video).frames
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


def test_rendered_motions_are_smooth_and_mostly_in_view(folder: Path) -> None:
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
