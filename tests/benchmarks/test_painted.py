from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.painted import (
    FAULTS,
    FIRST_SEED,
    SPLICE_FRAMES,
    SPLICE_M,
    TASKS,
    TRUTH,
    PaintedClip,
    Painter,
    Splice,
    choose_splice,
    compare_faults,
    find_jumps,
    find_odd_steps,
    find_wrong_gaps,
    find_wrong_sizes,
    measure_gripper,
    paint_orders,
    paint_splice,
    painted_report,
    read_painted,
)
from benchmarks.perception.store import MeasurementStore
from examples.worldmodel.pack import measure_pose
from examples.worldmodel.robot import FIELD, NEAR_M, POINTS, POSE, ROBOT
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError
from kinebench_drake.formats.manifest import ManifestEntry
from kinebench_drake.geometry import invert, transform_points
from kinebench_drake.io.reader import read_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import HAND_TO_TCP_M
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack
from tests.rows import make_row

FRAMES = 20
WRIST = 10
JUMP, STEP, CUT, FADED, SIZE, GAP = FAULTS


def clip(id="a", dynamics="dynamics", **numbers):
    """Return a clip whose gripper moves at 2 cm a frame."""
    p_C = np.outer(np.arange(FRAMES), [0.02, 0.0, 0.0]) + np.array([0.0, 0.0, 0.7])
    exact = {"p_C": p_C, "size": np.ones(FRAMES), "finger_width_m": np.full(FRAMES, 0.04), **numbers}
    return PaintedClip(id=id, task=TASKS[0], seed=3, prompt="Pull.", dynamics=dynamics, sampling_seed=4, **exact)


def jumping(at, length_m, **labels):
    p_C = clip().p_C
    p_C[at:, 1] += length_m
    return clip(p_C=p_C, **labels)


def row(id="a", *anomalies, **others):
    entries = [{"kind": k, "frame_start": a, "frame_end": b, "severity": 1.0} for k, a, b in anomalies]
    return make_row(id, metrics={"anomalies": entries}, **others)


def test_numbers_of_a_true_motion_are_its_tcp_at_the_right_size_with_its_gap():
    plant = ArmPlant()
    camera = benchmark_camera()
    q = np.linspace([0, 0.4, 0, -2, 0, 2.4, 0.8], [0.3, 0.6, 0.1, -1.8, 0.2, 2.2, 0.9], 5)
    X_CH = invert(camera.X_BC) @ np.array([plant.link_poses(each)["panda_hand"] for each in q])
    truth = {
        "q": q,
        "finger_width_m": np.linspace(0.0, 0.08, 5),
        "camera_from_hand": X_CH,
        "base_from_object": np.tile(np.eye(4), (5, 1, 1, 1)),
        "joint_position": np.empty((5, 0)),
    }
    p_C, size, finger_width_m = measure_gripper(measure_pose(camera.to_json(), truth, plant))
    np.testing.assert_allclose(p_C, transform_points(X_CH, [[0, 0, HAND_TO_TCP_M]])[:, 0], atol=1e-5)
    np.testing.assert_allclose(size, 1.0, atol=1e-3)
    np.testing.assert_allclose(finger_width_m, truth["finger_width_m"], atol=1e-5)


def test_each_first_frame_is_continued_by_each_dynamics_tasks_in_turn():
    orders = paint_orders(5, ["one", "two"])
    assert [order.dynamics for order in orders] == ["one", "two"] * 5
    assert [order.spec.task for order in orders[::2]] == [*TASKS, TASKS[0]]
    assert [order.spec.seed for order in orders[::2]] == [FIRST_SEED] * 4 + [FIRST_SEED + 1]
    assert len({order.id for order in orders}) == 10


def test_half_of_the_spliced_clips_are_cut_and_half_cross_faded_in_each_task():
    orders = paint_orders(16, ["one"], is_spliced=True)
    assert {order.faded for order in paint_orders(4, ["one"])} == {None}
    for task in TASKS:
        assert sorted(order.faded for order in orders if order.spec.task == task) == [0, 0, 2, 3]


def poses_along(y_m):
    """Return pose numbers (T, POSE) of a right gripper that moves across the picture."""
    points = np.zeros((len(y_m), POINTS, 3))
    points[:, :, 2] = NEAR_M / 0.7 - 1.0
    points[:, WRIST:ROBOT, 0] = (np.asarray(y_m)[:, None] + [0.0, 0.01, -0.01, 0.0, 0.01, -0.01]) / (0.7 * FIELD)
    poses = np.zeros((len(y_m), POSE))
    poses[:, : POINTS * 3] = points.reshape(len(y_m), -1)
    return torch.tensor(poses, dtype=torch.float32)


def test_a_splice_is_a_jump_of_a_length_in_its_range_that_the_steps_around_do_not_explain():
    start = poses_along(0.002 * np.arange(49))
    samples = torch.stack([start, *(poses_along(0.002 * np.arange(49) + off) for off in (0.045, 0.2))])
    splice, one, other = choose_splice(samples, 2, np.random.default_rng(0))
    assert splice.length_m == pytest.approx(0.045, abs=1e-4)
    assert SPLICE_M[0] <= splice.length_m <= SPLICE_M[1]
    assert splice.frame in SPLICE_FRAMES
    assert {float(one[0, WRIST * 3]), float(other[0, WRIST * 3])} == {float(s[0, WRIST * 3]) for s in samples[:2]}
    with pytest.raises(InputError, match="no change"):
        choose_splice(samples[[0, 2]], 2, np.random.default_rng(0))


@pytest.mark.parametrize(("faded", "levels"), [(0, [1, 2, 3, 104, 105, 106]), (2, [1, 2, 36, 71, 105, 106])])
def test_a_splice_is_painted_as_a_cut_or_as_a_blend_of_both(faded, levels):
    class Levels:
        def paint(self, first, poses):
            return np.stack([np.full((2, 2, 3), each, np.uint8) for each in poses[:, 0].tolist()])

    one = torch.arange(1.0, 7.0)[:, None]
    splice = Splice(frame=3, faded=faded, length_m=0.05)
    video = paint_splice(Levels(), np.zeros((2, 2, 3), np.uint8), one, one + 100, splice)
    assert video[:, 0, 0, 0].tolist() == levels


def test_the_frames_of_a_splice_are_the_faded_ones_and_the_first_after_them():
    cut, faded = (Splice(frame=10, faded=n, length_m=0.05) for n in (0, 3))
    assert (cut.frames, faded.frames) == (slice(10, 11), slice(9, 13))
    for splice, fault, other in ((cut, CUT, FADED), (faded, FADED, CUT)):
        pair = (clip(splice=splice), row("a", ("teleport", 10, 10)))
        assert compare_faults(fault, [pair])[0].true == (splice.frames,)
        assert compare_faults(other, [pair])[0].true == ()


class FakeGenerator:
    """Generator of random numbers and of black frames."""

    def __init__(self, dynamics):
        self.dynamics = dynamics

    def imagine(self, first, prompt, seed):
        return torch.rand(3, POSE, generator=torch.Generator().manual_seed(seed))

    def paint(self, first, poses):
        return np.stack([first, *np.zeros((len(poses) - 1, *first.shape), np.uint8)])


@pytest.mark.sapien
def test_a_painter_writes_the_clip_of_the_first_frame(tmp_path):
    (order,) = paint_orders(1, ["fake"])
    painter = Painter(FakeGenerator, tmp_path)
    painted = painter(order)
    painter.close()
    frames = read_video(tmp_path / f"{order.id}.mp4").frames
    assert frames.shape == (3, 384, 384, 3)
    assert frames[0].mean() > 50 > frames[1].mean()
    assert painted.p_C.shape == (3, 3)
    assert painted.id == order.id


def test_clips_are_read_as_written_the_last_of_each_id(tmp_path):
    store = MeasurementStore(tmp_path / TRUTH, PaintedClip)
    for key, each in (("1", clip()), ("2", clip("b")), ("3", jumping(8, 0.1))):
        store.put(key, each)
    clips = {each.id: each for each in read_painted(tmp_path)}
    assert list(clips) == ["a", "b"]
    assert find_jumps(clips["a"])
    assert not find_jumps(clips["b"])


def test_a_line_of_the_manifest_is_valid():
    entry = ManifestEntry.model_validate(clip().manifest_row())
    assert (entry.id, entry.camera, entry.frame_period_s, entry.model) == ("a", "benchmark", 0.2, "dynamics")


def test_a_jump_is_off_the_motion_around_it():
    assert not find_jumps(clip())
    assert not find_odd_steps(clip())
    assert find_jumps(jumping(8, 0.1)) == [slice(8, 9)]
    (odd,) = find_odd_steps(jumping(8, 0.1))
    assert odd.start <= 8 < odd.stop
    assert find_odd_steps(jumping(8, 0.035)) == [slice(8, 9)]
    assert not find_jumps(jumping(8, 0.025))
    assert not find_odd_steps(jumping(8, 0.025))


def test_a_wrong_size_lasts_and_a_wrong_gap_is_out_of_range():
    size = np.ones(FRAMES)
    size[3:7] = 1.1
    assert not find_wrong_sizes(clip(size=size))
    size[7] = 1.1
    assert find_wrong_sizes(clip(size=size)) == [slice(3, 8)]
    width_m = np.full(FRAMES, 0.08)
    width_m[5] = 0.1
    assert find_wrong_gaps(clip(finger_width_m=width_m)) == [slice(5, 6)]
    assert not find_wrong_gaps(clip(finger_width_m=width_m - 0.01))


@pytest.mark.parametrize(("reported", "missed", "false"), [(6, 0, 0), (10, 0, 0), (5, 1, 1), (11, 1, 1)])
def test_a_report_within_two_frames_is_right(reported, missed, false):
    pair = (jumping(8, 0.1), row("a", ("teleport", reported, reported), ("deformation", 8, 8)))
    (compared,) = compare_faults(JUMP, [pair])
    assert (len(compared.missed), len(compared.false)) == (missed, false)


def test_the_report_counts_faults_and_clips_and_tcp_errors(tmp_path):
    clips = [jumping(8, 0.1), jumping(8, 0.1, id="b"), clip("c", dynamics="early"), clip("lost")]
    rows = {
        "a": row("a", ("teleport", 9, 9), hand_size_error=-0.02),
        "b": row("b", anomalies_open=("teleport",)),
        "c": row("c", ("teleport", 3, 3)),
    }
    X_CH = np.tile(np.eye(4), (FRAMES, 1, 1))
    X_CH[:, :3, 3] = clips[0].p_C + np.array([0.002, 0.0, -HAND_TO_TCP_M])
    tracked = np.arange(FRAMES) > 10
    flat = {"confidence": np.ones(FRAMES), "finger_width_m": np.ones(FRAMES)}
    track = GripperTrack(t_s=np.arange(FRAMES) * 0.2, X_CH=X_CH, X_BG=X_CH, tracked=tracked, **flat)
    path = artifact_path(tmp_path, "tracks", "a")
    path.parent.mkdir()
    write_track(path, track, None, {})
    text = "\n".join(painted_report(rows, clips, tmp_path))
    assert "3 of 4 clips" in text
    assert f"| {JUMP} | dynamics | faults | 2 | 1 | 1/1 [21, 100] % | 1/2 [9, 91] % |" in text
    assert f"| {JUMP} | dynamics | clips | 2 | 1 | 1/1 [21, 100] % | 1/2 [9, 91] % | 1 |" in text
    assert f"| {JUMP} | early | faults | 0 | 1 | 0/1 [0, 79] % | - |" in text
    assert f"| {JUMP} | all | faults | 2 | 2 | 1/2 [9, 91] % | 1/2 [9, 91] % |" in text
    assert "| dynamics | 2 | 47.4 % | 2.0 mm | 2.0 mm | 0.0 % | 2.0 % (1 clips) |" in text
    assert f"{JUMP}, missed: b:8" in text
    assert f"{JUMP}, false: c:3" in text


def test_a_row_without_anomalies_is_not_compared(tmp_path):
    bare = replace(row("a"), metrics=make_row("a").metrics)
    assert next(painted_report({"a": bare}, [clip()], tmp_path)).startswith("0 of 1 clips")
