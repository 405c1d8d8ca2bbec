"""Poses are read unchanged; frames without one are NaN."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.grounding.overrides.files import MESH_NAME, pose_files, read_poses
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack

T = 12
X_CH = make_pose(rotation_exp(np.random.default_rng(0).normal(size=(T, 3))), [[0.01 * k, 0.1, 0.7] for k in range(T)])


def texts(folder: Path, numbers: Iterable[int], X: Array = X_CH, first: int = 0) -> Path:
    """Matrices as FoundationPose writes them: file `number` is that of frame `number - first`."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        np.savetxt(folder / f"{number:07}.txt", X[number - first])
    return folder


def without(*frames: int) -> Array:
    X = X_CH.copy()
    X[list(frames)] = np.nan
    return X


def test_poses_and_finger_widths_of_arrays_are_read_as_written(tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", without(3))
    np.savez(tmp_path / "v.npz", camera_from_hand=X_CH, finger_width_m=np.full(T, 0.03))
    poses = read_poses(tmp_path, tmp_path / "v.npy", T)
    np.testing.assert_allclose(poses.X_CH, without(3), atol=1e-12)
    assert poses.finger_width_m is None
    poses = read_poses(tmp_path, tmp_path / "v.npz", T)
    np.testing.assert_allclose(poses.X_CH, X_CH, atol=1e-12)
    assert poses.finger_width_m is not None
    assert (poses.finger_width_m == 0.03).all()


def test_only_tracked_frames_of_a_track_have_a_pose(tmp_path: Path) -> None:
    tracked = np.arange(T) != 5
    track = GripperTrack(
        t_s=np.linspace(0.0, 2.2, T),
        X_CH=X_CH,
        X_BG=X_CH,
        tracked=tracked,
        confidence=tracked.astype(float),
        finger_width_m=np.full(T, 0.05),
    )
    write_track(tmp_path / "v.npz", track, None, {})
    np.testing.assert_allclose(read_poses(tmp_path, tmp_path / "v.npz", T).X_CH, without(5), atol=1e-12)


@pytest.mark.parametrize("tracked", [np.ones(T - 1, dtype=bool), np.ones(T), np.array(["no"] * T)])
def test_a_tracked_array_of_wrong_shape_or_type_is_refused(tmp_path: Path, tracked: NDArray[Any]) -> None:
    np.savez(tmp_path / "v.npz", camera_from_hand=X_CH, tracked=tracked)
    with pytest.raises(InputError, match=rf"tracked has shape .* expected \({T},\)"):
        read_poses(tmp_path, tmp_path / "v.npz", T)


@pytest.mark.parametrize(
    ("numbers", "first", "missing"),
    [
        (range(T), 0, ()),
        (range(1, T + 1), 1, ()),
        (range(100, 100 + T), 100, ()),
        ([n for n in range(T) if n not in (4, 11)], 0, (4, 11)),
        ([n for n in range(T) if n not in (0, 4)], 0, (0, 4)),
        ([n for n in range(1, T + 1) if n != 5], 1, (4,)),
    ],
)
def test_text_files_are_assigned_to_frames_by_their_numbers(
    tmp_path: Path, numbers: Iterable[int], first: int, missing: tuple[int, ...]
) -> None:
    for entry, inner in ((tmp_path / "a", tmp_path / "a"), (tmp_path / "b", tmp_path / "b" / "ob_in_cam")):
        texts(inner, numbers, first=first)
        np.testing.assert_allclose(read_poses(tmp_path, entry, T).X_CH, without(*missing), atol=1e-12)
        assert len(pose_files(tmp_path, entry)) == T - len(missing)


@pytest.mark.parametrize("numbers", [range(3, T + 3 + 1), [0, T], [], [10**17, 10**17 + 33]])
def test_text_files_whose_numbers_do_not_fit_the_video_are_refused(tmp_path: Path, numbers: Iterable[int]) -> None:
    folder = tmp_path / "v"
    folder.mkdir()
    for number in numbers:
        np.savetxt(folder / f"{number}.txt", X_CH[0])
    with pytest.raises(InputError, match="expected"):
        read_poses(tmp_path, folder, T)


def test_poses_of_another_mesh_are_converted_to_hand_poses(tmp_path: Path) -> None:
    X_MH = make_pose(rotation_exp([0.0, 0.3, 1.0]), [0.0, 0.02, -0.05])
    texts(tmp_path / "v" / "ob_in_cam", range(T), X_CH @ np.linalg.inv(X_MH))
    np.savetxt(tmp_path / MESH_NAME, X_MH)
    np.testing.assert_allclose(read_poses(tmp_path, tmp_path / "v", T).X_CH, X_CH, atol=1e-12)
    assert tmp_path / MESH_NAME in pose_files(tmp_path, tmp_path / "v")


@pytest.mark.parametrize(
    ("X", "message"),
    [
        (X_CH[:, :3], "shape"),
        (np.where(np.eye(4) > 0, 2.0, 0.0)[None], "pose of frame 0 is not a rigid pose"),
        (make_pose(X_CH[:, :3, :3], 1000 * X_CH[:, :3, 3]), "millimetres"),
        (make_pose(X_CH[:, :3, :3], -X_CH[:, :3, 3]), "behind the camera"),
    ],
)
def test_arrays_that_contain_no_valid_poses_are_refused(tmp_path: Path, X: Array, message: str) -> None:
    np.save(tmp_path / "v.npy", X)
    with pytest.raises(InputError, match=message):
        read_poses(tmp_path, tmp_path / "v.npy", T)


def test_finger_widths_are_clipped_to_the_gripper_and_refused_in_millimetres(tmp_path: Path) -> None:
    width = np.linspace(-0.001, 0.081, T)
    np.savez(tmp_path / "v.npz", camera_from_hand=X_CH, finger_width_m=np.where(np.arange(T) == 3, np.nan, width))
    clipped = read_poses(tmp_path, tmp_path / "v.npz", T).finger_width_m
    assert clipped is not None
    assert np.isnan(clipped[3])
    assert (np.nanmin(clipped), np.nanmax(clipped)) == (0.0, 0.08)
    np.savez(tmp_path / "v.npz", camera_from_hand=X_CH, finger_width_m=1000 * width)
    with pytest.raises(InputError, match="between the pads"):
        read_poses(tmp_path, tmp_path / "v.npz", T)
