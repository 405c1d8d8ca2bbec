"""Runs of `follow` over tiny videos with the fakes: actions found and read, rows, resume, real clips."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.geometry import make_pose, to_quaternion
from kinebench_drake.grounding.camera.links import LagEstimate
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs.config import FollowConfig
from kinebench_drake.runs.follow import follow_videos
from tests.fakes.records import RunRecorder
from tests.fakes.resources import FakeResources

FRAMES = 24


class Tools(FakeResources):
    """Fakes with the kinematics of an arm whose first joints are the position of the gripper, and no calibration."""

    plant = SimpleNamespace(forward_path=lambda q: make_pose(np.diag([1.0, -1.0, -1.0]), q[:, :3]))

    @property
    def calibrator(self):
        def calibrate(frames, states, guess, **options):
            assert len(frames) == len(states.q) == 2 * len(options["rows"]) == FRAMES
            raise UnmeasurableError("the arm is not seen")

        return SimpleNamespace(calibrate=calibrate)


def motion(n=FRAMES, lag=0):
    """The track that the fake grounding makes up, early by some frames."""
    s = np.clip((np.arange(n) + lag) / (n - 1), 0, 1)
    return np.stack([0.4 + 0.1 * s, 0.2 * np.sin(3 * s), 0.3 + 0.05 * np.cos(5 * s)], axis=1)


@pytest.fixture
def follow(tmp_path, fakes):
    def run(observer=None, **changes):
        paths = {"source": tmp_path / "videos", "out": tmp_path / "out", "camera": "benchmark"}
        config = FollowConfig(**{**paths, "make_resources": Tools, "replays": None, **changes})
        follow_videos(config, observer or RunRecorder())
        return read_rows(tmp_path / "out")

    return run


def write_poses(path, p):
    path.parent.mkdir(exist_ok=True)
    quaternion = to_quaternion(np.diag([1.0, -1.0, -1.0]))
    lines = [",".join(map(str, [*row, *quaternion])) for row in p]
    path.write_text("\n".join(["x_m,y_m,z_m,qw,qx,qy,qz", *lines]))


def test_clips_are_compared_with_the_actions_of_their_names(film, follow, tmp_path):
    for id in ("good", "late", "wrong", "none", "broken"):
        film(f"videos/{id}.mp4", frames=FRAMES)
    actions = tmp_path / "actions"
    write_poses(actions / "good.csv", motion())
    q = np.pad(motion(lag=2), ((0, 0), (0, 4)))
    (actions / "late.json").write_text(json.dumps({"q": q.tolist()}))
    np.savez(actions / "wrong.npz", q=np.pad(motion()[::-1], ((0, 0), (0, 4))), t_s=np.arange(FRAMES) / 17)
    (actions / "broken.csv").write_text("no,table\n1")
    rows = follow(actions=actions)
    assert {id: (row.status.value, row.follows) for id, row in rows.items()} == {
        "good": ("ok", True),
        "late": ("ok", True),
        "wrong": ("ok", False),
        "none": ("unmeasurable", None),
        "broken": ("error", None),
    }
    assert rows["good"].lag_frames == pytest.approx(0.0, abs=0.1)
    assert rows["late"].lag_frames == pytest.approx(2.0, abs=0.5)
    assert rows["good"].gain == pytest.approx(1.0, abs=0.05)
    assert rows["good"].deviation_m < 1e-3
    assert rows["wrong"].deviation_m > 0.05
    assert rows["wrong"].drift_from_frame is not None
    assert set(rows["good"].controls) == {"shuffled", "reversed", "still"}
    curves = read_track(artifact_path(tmp_path / "out", "tracks", "wrong")).curves
    assert np.nanmedian(curves["deviation_m"]) == pytest.approx(rows["wrong"].deviation_m)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "does not follow" in page
    assert "Deviation [mm]" in page


def test_a_row_is_computed_again_when_the_bytes_of_its_actions_change(film, follow, fakes, tmp_path):
    film("videos/a.mp4", frames=FRAMES)
    film("videos/b.mp4", frames=FRAMES)
    for id in ("a", "b"):
        write_poses(tmp_path / "actions" / f"{id}.csv", motion())
    options = {"actions": tmp_path / "actions"}
    assert follow(**options)["a"].follows
    fakes.take_calls()
    follow(**options)
    assert not fakes.take_calls()
    write_poses(tmp_path / "actions" / "a.csv", motion()[::-1])
    rows = follow(**options)
    assert (rows["a"].follows, rows["b"].follows) == (False, True)


def test_actions_of_a_manifest_and_frames_to_which_the_camera_is_fitted(film, follow, tmp_path):
    film("videos/a.mp4", frames=FRAMES)
    write_poses(tmp_path / "videos" / "a.csv", motion())
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text(json.dumps({"video": "a.mp4", "actions": "a.csv"}))
    assert follow(source=manifest)["a"].follows
    row = follow(source=manifest, camera="auto", out=tmp_path / "out")["a"]
    assert (row.status.value, row.follows) == ("unmeasurable", None)
    assert "none fits the actions: the arm is not seen" in row.reason


@pytest.mark.parametrize("reason", [None, "nothing confirms a camera"])
def test_a_clip_beside_its_real_one(film, follow, tmp_path, reason):
    film("videos/a.mp4", frames=FRAMES, choice={"reason": reason})
    film("real/a.mp4", frames=FRAMES, choice={"reason": reason})
    row = follow(reference=tmp_path / "real")["a"]
    assert row.follows
    assert row.deviation_px < 0.5
    assert (row.deviation_m is None) == (row.deviation_hands is not None) == (reason is not None)
    film("dark/a.mp4", frames=FRAMES, has_gripper=False)
    row = follow(reference=tmp_path / "dark")["a"]
    assert (row.status.value, row.follows, row.deviation_hands) == ("ok", None, None)
    assert "the real clip: no Franka hand" in row.follow_reason


def test_what_the_real_clip_does_not_follow_either_is_no_verdict(film, follow, tmp_path):
    film("videos/a.mp4", frames=FRAMES)
    film("real/a.mp4", frames=FRAMES)
    write_poses(tmp_path / "actions" / "a.csv", motion()[::-1])
    row = follow(actions=tmp_path / "actions", reference=tmp_path / "real")["a"]
    assert (row.follows, row.reference["follows"], row.reference["real_follows"]) == (None, True, False)


def test_without_anything_to_compare_with_there_is_no_run(film, follow, tmp_path):
    film("videos/a.mp4")
    with pytest.raises(UsageError, match=r"neither actions of its videos .* a\.npz"):
        follow()


class Linked(Tools):
    """Fakes that fit the benchmark camera, and see the links in the postures of the fake track alone."""

    @property
    def calibrator(self):
        def compare(frames, camera, postures):
            return np.array([np.exp(-20.0 * np.abs(q[:, :3] - motion()[1::2]).sum(axis=1)) for q in postures])

        lag = LagEstimate(frames=0.0, agreement=0.6, runner_up=0.4)
        fit = SimpleNamespace(camera=benchmark_camera(), links=SimpleNamespace(lag=lag))
        return SimpleNamespace(calibrate=lambda *_, **__: fit, compare_links=compare)


def test_poses_of_another_gripper_contradict_nothing(film, follow, tmp_path):
    film("videos/a.mp4", frames=FRAMES, result={"gripper": GripperKind.ROBOTIQ_2F85})
    write_poses(tmp_path / "actions" / "a.csv", motion()[::-1])
    row = follow(actions=tmp_path / "actions")["a"]
    assert (row.follows, row.deviation_m, row.drift_from_frame) == (None, None, None)
    assert "how the Robotiq 2F-85 is mounted is not stated" in row.follow_reason


def test_links_decide_where_the_gripper_does_not(film, follow, tmp_path):
    lost = {"frames": FRAMES, "is_sure": False, "result": {"gripper": GripperKind.ROBOTIQ_2F85}}
    for id in ("good", "wrong"):
        film(f"videos/{id}.mp4", **lost)
    q = np.pad(motion(), ((0, 0), (0, 4)))
    np.savez(tmp_path / "good.npz", q=q)
    np.savez(tmp_path / "wrong.npz", q=q[::-1])
    rows = follow(actions=tmp_path, camera="auto", make_resources=Linked, gripper="robotiq-2f85")
    assert {id: (row.status.value, row.follows) for id, row in rows.items()} == {
        "good": ("ok", True),
        "wrong": ("ok", None),
    }
    good = rows["good"]
    assert (good.lag_frames, good.deviation_m) == (0.0, None)
    assert good.link_agreement["own"] > 0.9 > 0.5 > good.link_agreement["shuffled"]
    assert "contours of the links on edges in 12 frames: own 100%" in good.follow_reason


def test_a_tile_is_its_own_reference(film, follow, tmp_path):
    film("videos/a.mp4", frames=FRAMES)
    with pytest.raises(UsageError, match=r"holds the clips themselves.*reference_view"):
        follow(reference=tmp_path / "videos")
    row = follow(reference=tmp_path / "videos", reference_view="1")["a"]
    assert (row.follows, row.lag_frames) == (True, pytest.approx(0.0, abs=0.1))
    assert row.deviation_m == pytest.approx(0.0, abs=1e-6)
    assert row.reference_error_m < 1e-3


def test_a_dry_run_lists_actions_and_real_clips(film, program, tmp_path):
    for path in ("videos/a.mp4", "videos/b.mp4", "videos/c.mp4", "real/b.mp4"):
        film(path, frames=FRAMES)
    write_poses(tmp_path / "actions" / "a.csv", motion())
    options = ("--actions", tmp_path / "actions", "--reference", tmp_path / "real", "--reference-view", "1")
    code, out, _ = program("follow", tmp_path / "videos", "--dry-run", *options)
    assert code == 0
    lines = {line.split(":")[0]: line for line in out.splitlines()}
    assert lines["a"].endswith("actions: a.csv")
    assert lines["b"].endswith("real clip: b.mp4, view 1")
    assert lines["c"].endswith("nothing to compare with")
    assert "nothing was measured or written" in out
