"""The view command: its replay, its messages and its refusals."""

import shutil

import numpy as np
import pytest

from kinebench_drake.cli import outputs
from kinebench_drake.geometry import make_pose
from kinebench_drake.models.arm import load_robot
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack
from tests.rows import make_row


def make_track(n=4, *, tracked=True):
    p = np.stack([np.full(n, 0.5), np.linspace(-0.1, 0.1, n), np.full(n, 0.2)], axis=-1)
    X = make_pose(np.broadcast_to(np.diag([1.0, -1.0, -1.0]), (n, 3, 3)), p) * (1.0 if tracked else np.nan)
    on = np.full(n, tracked)
    return GripperTrack(
        t_s=np.arange(n) * 0.2, X_CH=X, X_BG=X, tracked=on, confidence=on * 0.9, finger_width_m=np.full(n, 0.04)
    )


@pytest.fixture
def out(tmp_path):
    with ResultStore(tmp_path) as store:
        for id, status in (
            ("reach_01", Status.OK),
            ("reach_02", Status.OK),
            ("lost", Status.OK),
            ("dark", Status.UNMEASURABLE),
        ):
            reason = None if status is Status.OK else "no robot in view"
            store.append(
                make_row(id=id, video="", task=None, model=None, status=status, reason=reason, content_hash="0"), 0.1
            )
        write_track(tmp_path / "tracks" / "reach_01.npz", make_track(), None, {})
        write_track(tmp_path / "tracks" / "lost.npz", make_track(tracked=False), None, {})
        (tmp_path / "tracks" / "reach_02.npz").write_bytes(b"PK broken")
    return tmp_path


def test_view_writes_the_replay_and_prints_only_its_path(program, out):
    code, told, err = program("view", out, "reach_01")
    assert (code, err) == (0, "")
    assert told == f"{out / 'replays' / 'reach_01.html'}\n"
    assert "reach_01" in (out / "replays" / "reach_01.html").read_text()


@pytest.mark.parametrize(("status", "told"), [(0, ""), (1, "no browser")])
def test_view_with_open_launches_the_browser_and_warns_if_there_is_none(program, out, monkeypatch, status, told):
    opened = []
    path = out / "replays" / "reach_01.html"
    monkeypatch.setattr("kinebench_drake.report.replay.write_replays", lambda *_, **__: [path])
    monkeypatch.setattr(outputs.click, "launch", lambda url: opened.append(url) or status)
    code, _, err = program("view", out, "reach_01", "--open")
    assert code == 0
    assert told in err
    assert opened == [path.resolve().as_uri()]


@pytest.mark.parametrize(
    ("id", "told"),
    [
        ("raech_01", "such as reach_01"),
        ("entirely different", "4 samples, such as dark"),
        ("dark", "no robot in view"),
        ("lost", "no frame is tracked"),
        ("reach_02", "not a track file"),
    ],
)
def test_samples_without_a_replayable_track_are_refused_in_one_line(refusal, out, id, told):
    assert told in refusal("view", out, id)
    assert not list(out.glob("replays/*"))


def test_a_folder_that_is_no_run_output_is_refused(refusal, tmp_path):
    assert "output folder of a run" in refusal("view", tmp_path / "nowhere", "a")


@pytest.mark.parametrize("robot", ["fr3", "arm.urdf"])
def test_a_replay_shows_the_robot_that_the_run_was_judged_by(program, out, write_arm, monkeypatch, robot):
    loaded = load_robot("fr3") if robot == "fr3" else load_robot(write_arm(), "tool")
    with ResultStore(out) as store:
        store.finish({"config": {"robot": robot, "robot_id": loaded.id}})
    shown = []
    monkeypatch.setattr(
        "kinebench_drake.report.replay.write_replays", lambda *a, **_: shown.append(a[2].robot) or [out / "a.html"]
    )
    assert program("view", out, "reach_01")[0] == 0
    assert [(r.id, r.tcp_link, r.joints) for r in shown] == [(loaded.id, loaded.tcp_link, loaded.joints)]
    shutil.rmtree(loaded.urdf.parent)
    code, _, err = program("view", out, "reach_01")
    assert code == (0 if robot == "fr3" else 2)
    assert robot == "fr3" or "its robot arm.urdf is not in the cache of this machine" in err
