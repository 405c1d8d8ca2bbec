"""External videos: references, errors and labels against exact geometry."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import benchmarks.footage as footage
from benchmarks.__main__ import main
from benchmarks.footage import ReferenceKind, TrackRecord, find_footage, reference_of
from benchmarks.footage_errors import SILENT_M, VISIBLE_PX, compare, error_table, figures
from benchmarks.footage_labels import (
    HAND_LENGTH_M,
    LabelledFrame,
    compare_labels,
    hand_lengths_px,
    label_figures,
    pair_points,
    read_labels,
    reprojection_px,
)
from benchmarks.perception.store import MeasurementStore
from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import make_pose, rotation_exp
from kinebench_drake.models.gripper import X_HALF_TURN
from kinebench_drake.models.panda.cad import FINGER_ORIGIN_H, franka_hand
from kinebench_drake.models.panda.description import GripperKind, RobotPart

T = 4
CAMERA = benchmark_camera()
R_FRONT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Wide face towards the camera, fingers down."""


def pose(yaw=0.0, pitch=0.0, z=0.8):
    return make_pose(rotation_exp([-pitch, 0.0, 0.0]) @ R_FRONT @ rotation_exp([0.0, 0.0, yaw]), [0.05, 0.02, z])


def record(X_CH, *, tracked=None, anomalies=()):
    n = len(X_CH)
    return TrackRecord(
        id="a", X_CH=X_CH, tracked=np.ones(n, bool) if tracked is None else tracked,
        confidence=np.full(n, 0.9), finger_width_m=np.full(n, 0.04), anomalies=tuple(anomalies), cpu_s=1.5,
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    """A video of each kind of reference, the same poses in all."""
    X_CH = np.stack([pose(0.1 * i) for i in range(T)])
    tmp_path = tmp_path / "set" / "videos"
    (tmp_path / "gt").mkdir(parents=True)
    lines = []
    for name in ("sim", "real", "edge", "none"):
        np.save(tmp_path / f"{name}.npy", np.zeros((T, 384, 384, 3), np.uint8))
        lines.append({"video": f"{name}.npy", "frame_period_s": 0.2, "camera": CAMERA.to_json()})
    width = np.full(T, 0.04)
    visible = np.array([1000, 1000, VISIBLE_PX, VISIBLE_PX - 1])
    np.savez(tmp_path / "sim.gt.npz", base_from_hand=CAMERA.X_BC @ X_CH, finger_width_m=width, visible=visible)
    np.savez(tmp_path / "gt" / "real.npz", camera_from_hand=X_CH, finger_width_m=width)
    np.savez(tmp_path / "gt" / "edge.edge.npz", camera_from_hand=X_CH, finger_width_m=width)
    (tmp_path / "manifest.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return tmp_path


def test_references_of_all_kinds_give_the_same_poses(folder):
    videos = find_footage(folder)
    assert [reference_of(v, ["none"]) for v in videos] == [
        *(ReferenceKind.SIMULATOR, ReferenceKind.JOINTS, ReferenceKind.EDGES, ReferenceKind.LABELS)
    ]
    for video in videos[1:3]:
        np.testing.assert_allclose(video.load().X_CH, videos[0].load().X_CH, atol=1e-12)
    assert videos[0].digest() != videos[1].digest() != videos[3].digest()
    assert [v.id for v in find_footage(folder.parent)] == [v.id for v in videos]


def test_a_manifest_without_cameras_is_refused(folder):
    (folder / "manifest.jsonl").write_text('{"video": "sim.npy", "frame_period_s": 0.2}\n')
    with pytest.raises(UsageError, match=r"camera\.json"):
        find_footage(folder)
    with pytest.raises(UsageError, match="has a manifest"):
        find_footage(folder / "gt")


def test_a_track_equal_to_the_reference_has_no_error(folder):
    video = find_footage(folder)[0].load()
    errors = compare(video, record(video.X_CH))
    f = figures([errors])
    assert (f["frames"], f["visible_frames"], f["tracked"], f["silent"], f["good"]) == (T, 3, 1.0, 0.0, 1.0)
    for name in ("hand_mm", "tcp_mm", "rotation_deg"):
        assert f[f"{name}_p95"] < 1e-4
    assert len(error_table({"a": f})) == 3


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_pose_off_by_the_bound_is_a_silent_error(folder, share):
    video = find_footage(folder)[0].load()
    p = video.X_CH[:, :3, 3]
    X_CH = video.X_CH.copy()
    X_CH[:, :3, 3] *= (1 + share * SILENT_M / np.linalg.norm(p, axis=1))[:, None]
    errors = compare(video, record(X_CH))
    np.testing.assert_allclose(errors.tcp_m, share * SILENT_M)
    assert errors.silent.all() == (share > 1)


def test_untracked_frames_lower_the_tracked_share_and_not_the_pose_error(folder):
    video = find_footage(folder)[0].load()
    tracked = np.array([True, False, True, False])
    X_CH = np.where(tracked[:, None, None], video.X_CH, np.nan)
    vanish = Anomaly(kind=AnomalyKind.VANISH, frame_start=1, frame_end=1, severity=1.0)
    f = figures([compare(video, record(X_CH, tracked=tracked, anomalies=[vanish]))])
    assert f["tracked"] == pytest.approx(2 / 3)
    assert f["hand_mm_p95"] < 1e-4
    assert f["anomalies"] == {"vanish": 1}


def test_track_records_survive_storage_as_json(tmp_path):
    X_CH = np.stack([pose(), np.full((4, 4), np.nan)])
    before = record(X_CH, tracked=np.array([True, False]))
    before = replace(before, finger_width_m=np.array([0.04, np.nan]))
    store = MeasurementStore(tmp_path / "tracks.jsonl", TrackRecord)
    store.put("a", before)
    after = MeasurementStore(tmp_path / "tracks.jsonl", TrackRecord)["a"]
    for name in ("X_CH", "tracked", "confidence", "finger_width_m"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=1e-6)


def test_finished_videos_are_not_grounded_again(folder, monkeypatch, tmp_path):
    grounded = []

    class Worker:
        def __init__(self, gripper, overlays):
            self.gripper = gripper

        def __call__(self, video):
            grounded.append((video.id, self.gripper))
            return record(np.stack([pose(0.1 * i) for i in range(T)]))

    monkeypatch.setattr(footage, "FootageWorker", Worker)
    out = tmp_path / "out"
    names = ["sim", "real", "edge", "none"]
    for gripper, kinds in (
        ("franka", [GripperKind.FRANKA]),
        ("franka", [GripperKind.FRANKA]),
        ("none", [GripperKind.FRANKA, GripperKind.NONE]),
    ):
        result = CliRunner().invoke(main, ["footage", str(folder), "--out", str(out), "--gripper", gripper])
        assert result.exit_code == 0, result.output
        assert grounded == [(name, kind) for kind in kinds for name in names]
    report = json.loads((out / "footage.json").read_text())
    assert report["kinds"][ReferenceKind.JOINTS.value]["hand_mm_p95"] < 0.01
    assert (out / "footage.md").read_text() == result.stdout.removesuffix("\n")


def labelled(X_CH, width_m, frame=0):
    points = {}
    for pair, p_C in pair_points(X_CH, width_m).items():
        px = CAMERA.project(p_C)
        points[f"{pair}_left"], points[f"{pair}_right"] = px[np.argsort(px[:, 0])]
    return LabelledFrame(frame=frame, points_px=points)


angle = st.floats(-3.1, 3.1)


@settings(deadline=None, max_examples=50)
@given(yaw=angle, pitch=st.floats(-1.0, 1.0), width_m=st.floats(0.0, 0.08), shift=st.floats(0.0, 20.0))
def test_reprojection_error_is_zero_at_the_true_pose_and_its_half_turn(yaw, pitch, width_m, shift):
    X_CH = pose(yaw, pitch)
    frame = labelled(X_CH, width_m)
    for X in (X_CH, X_CH @ X_HALF_TURN):
        assert reprojection_px(frame, CAMERA, X, width_m) < 1e-9
    moved = {name: px + np.array([shift, 0.0]) for name, px in frame.points_px.items()}
    assert reprojection_px(replace(frame, points_px=moved), CAMERA, X_CH, width_m) <= shift + 1e-9


@settings(deadline=None, max_examples=50)
@given(yaw=st.floats(-1.0, 1.0), pitch=st.floats(-0.8, 0.8), width_m=st.floats(0.0, 0.08))
def test_the_hand_length_in_pixels_follows_from_its_distance(yaw, pitch, width_m):
    X_CH = pose(yaw, pitch, z=1.0)
    share = hand_lengths_px([labelled(X_CH, width_m)])[0] / (CAMERA.fx * HAND_LENGTH_M / 1.0)
    assert 0.85 < share < 1.25


def test_frames_with_few_labels_interpolate_the_hand_length_of_their_neighbours():
    whole = [labelled(pose(z=z), 0.04, frame) for z, frame in ((0.8, 0), (1.0, 10))]
    bare = LabelledFrame(frame=5, points_px={"tip_left": np.zeros(2)})
    lengths = hand_lengths_px([whole[0], bare, whole[1]])
    assert lengths[1] == pytest.approx((lengths[0] + lengths[2]) / 2)


def test_an_error_above_a_fifth_of_the_hand_length_is_silent(folder):
    video = find_footage(folder)[3]
    frames = [labelled(pose(), 0.04)]
    for share, silent in ((0.0, 0.0), (0.15, 0.0), (0.4, 1.0)):
        X_CH = np.stack([pose()] * T)
        X_CH[:, 0, 3] += share * HAND_LENGTH_M
        f = label_figures([compare_labels(video, record(X_CH), frames)])
        assert f["silent"] == silent
        assert f["error_median"] == pytest.approx(share, rel=0.15)
    with pytest.raises(UsageError, match="frame 99 is labelled"):
        compare_labels(video, record(X_CH), [replace(frames[0], frame=99)])


def test_labelled_points_lie_on_the_cad_meshes():
    """Within 4 mm of a vertex of the mesh."""
    meshes = franka_hand().parts
    points = pair_points(np.eye(4), 0.0)
    for pair, part in (("corner", RobotPart.HAND), ("end", RobotPart.HAND), ("tip", RobotPart.LEFT_FINGER)):
        distance = np.linalg.norm(np.asarray(meshes[part].vertices) - points[pair][0], axis=1).min()
        assert distance < 0.004, pair
    assert FINGER_ORIGIN_H[2] < points["tip"][0, 2] <= meshes[RobotPart.LEFT_FINGER].bounds[1, 2] + 1e-4


def test_the_labels_cover_80_frames_and_10_clean_videos():
    labels = read_labels()
    frames = [frame for video in labels.videos.values() for frame in video]
    assert len(frames) >= 80
    assert len(labels.clean) >= 10
    assert all(len({frame.frame for frame in video}) == len(video) for video in labels.videos.values())


@pytest.mark.parametrize("points", [{}, {"nose": {"px": [1, 2]}}, {"tip_left": {"px": [1]}}])
def test_malformed_labels_are_refused(tmp_path, points):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps({"clean": [], "videos": {"a": [{"frame": 0, "points": points}]}}))
    with pytest.raises(UsageError, match="not a file of labels"):
        read_labels(path)
