"""Replays: self-contained, repeatable, without a server left running."""

import base64
import re
import socket
from functools import partial

import numpy as np
import pytest
from pydrake.geometry import Meshcat

from kinebench_drake.errors import SetupError, UnmeasurableError, UsageError
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.report import replay
from kinebench_drake.report.replay import build_replay, link_meshes, write_replays
from kinebench_drake.report.sample import worst_samples
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore, artifact_path, read_rows
from kinebench_drake.results.trackfile import TrackFile, read_track, write_track
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack
from tests.rows import make_row

N = 12


@pytest.fixture(scope="module")
def plant():
    return ArmPlant()


@pytest.fixture(scope="module")
def build(plant):
    return partial(build_replay, plant, link_meshes(plant))


@pytest.fixture
def joints(plant):
    """A swing of two joints; frame 5 has no joint angles and frame 8 misses the wanted pose."""
    t_s = np.arange(N) * 0.2
    q = plant.robot.rest_q + np.outer(np.sin(t_s), [0.3, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    q[5] = np.nan
    status = [IkStatus.OK] * N
    status[5] = IkStatus.NOT_TRACKED
    status[8] = IkStatus.UNREACHABLE
    error = np.where(np.isfinite(q[:, 0]), 0.0, np.nan)
    error[8] = 0.05
    return JointTrack(t_s=t_s, q=q, status=tuple(status), position_error_m=error, rotation_error_rad=error * 0.0)


@pytest.fixture
def track(plant, joints):
    X = np.full((N, 4, 4), np.nan)
    solved = np.isfinite(joints.q[:, 0])
    X[solved] = [plant.forward(q) for q in joints.q[solved]]
    X[8, 2, 3] += 0.05
    return GripperTrack(
        t_s=joints.t_s,
        X_CH=X,
        X_BG=X,
        tracked=solved,
        confidence=solved * 0.9,
        finger_width_m=np.where(solved, 0.04, np.nan),
    )


@pytest.fixture
def file(tmp_path, track, joints):
    write_track(tmp_path / "a.npz", track, joints, {})
    return read_track(tmp_path / "a.npz")


def row(id="a", **changes):
    velocity = {
        "kind": "velocity",
        "frame_start": 2,
        "frame_end": 3,
        "joint": "panda_joint4",
        "value": 3.0,
        "limit": 2.6,
    }
    unreachable = {"kind": "unreachable", "frame_start": 8, "frame_end": 8, "joint": None, "value": 0.05, "limit": 1e-6}
    fields = {"feasible": False, "violations": (velocity, unreachable), **changes}
    return make_row(id=id, video="", task=None, model=None, status=Status.OK, reason=None, content_hash="0", **fields)


def commands(html):
    """Commands of the page to its viewer, decoded."""
    return [base64.b64decode(c) for c in re.findall(r'fetch\("data:application/octet-binary;base64,([^"]+)"', html)]


def paths(html):
    """Objects that the page shows."""
    return {
        m[1].decode()
        for command in commands(html)
        if b"set_object" in command
        for m in [re.search(rb"\xa4path(?:[\xa0-\xbf]|\xd9.)([ -~]+?)\xa6object", command)]
        if m
    }


def test_the_same_track_gives_the_same_bytes_below_five_megabytes(build, file):
    page = build(row(), file)
    assert build(row(), file) == page
    assert len(page.encode()) < 5e6


def test_the_page_may_fetch_nothing_but_its_own_data(build, file):
    page = build(row(), file)
    head = page[: page.index("<body")]
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', head)[1]
    assert "default-src 'none'" in policy
    assert "connect-src data: blob:" in policy
    assert not re.search(r"https?:|[*]", policy)
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=", page)


def test_the_track_gripper_is_shown_where_the_arm_misses_it(build, plant, file, joints, track, tmp_path):
    shown = paths(build(row(), file))
    assert {f"/arm/{name}" for name in ("panda_link0", "panda_link7", "panda_hand", "panda_leftfinger")} <= shown
    assert {"/gripper/panda_hand", "/wanted", "/reached", "/table"} <= shown
    X = track.X_BG.copy()
    X[8] = plant.forward(joints.q[8])
    agreed = TrackFile(
        track=GripperTrack(
            t_s=track.t_s, X_CH=X, X_BG=X, tracked=track.tracked, confidence=track.confidence,
            finger_width_m=track.finger_width_m,
        ),
        q=file.q, ik_ok=file.ik_ok, status=None, curves={},
    )  # fmt: skip
    shown = paths(build(row(violations=()), agreed))
    assert not {p for p in shown if p.startswith("/gripper")} | ({"/reached"} & shown)


def test_the_gripper_alone_is_shown_without_joint_angles(build, track, tmp_path):
    write_track(tmp_path / "b.npz", track, None, {})
    open_row = row(feasible=None, violations=(), executable_reasons=("undecided",))
    page = build(open_row, read_track(tmp_path / "b.npz"))
    shown = paths(page)
    assert not {p for p in shown if p.startswith("/arm")}
    assert {"/gripper/panda_hand", "/gripper/panda_leftfinger", "/gripper/panda_rightfinger", "/tcp/x"} <= shown
    assert "<p>undecided: no reason stored</p>" in page


def test_faults_are_listed_with_their_times(build, file):
    page = build(row(), file)
    assert re.findall(r'data-time="([\d.]+)">([^<]*)<', page) == [
        ("0.4", "velocity, panda_joint4: 0.40 to 0.60 s (frames 2 to 3)"),
        ("1.6", "unreachable: 1.60 s (frame 8)"),
    ]


def test_names_are_escaped_in_html(build, file):
    evil = "<script>alert(1)</script>"
    page = build(row(id=evil, violations=({"joint": evil},)), file)
    assert evil not in page
    assert page.count("&lt;script&gt;") >= 3


def test_the_meshcat_server_is_closed_after_the_replay_is_built(build, file, monkeypatch):
    ports = []

    def meshcat(parameters):
        assert parameters.host == "localhost"
        server = Meshcat(parameters)
        ports.append(server.port())
        return server

    monkeypatch.setattr(replay, "Meshcat", meshcat)
    build(row(), file)
    (port,) = ports
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("localhost", port), timeout=5.0)


def test_a_machine_without_a_free_port_is_reported(build, file, monkeypatch):
    def refuse(parameters):
        raise RuntimeError("Meshcat failed to open a websocket port.")

    monkeypatch.setattr(replay, "Meshcat", refuse)
    with pytest.raises(SetupError, match="port of this machine"):
        build(row(), file)


def test_a_track_of_one_frame_has_a_replay_and_an_empty_one_is_refused(build, file):
    track = file.track
    one = np.zeros(N, dtype=bool)
    one[3] = True
    X = np.where(one[:, None, None], track.X_BG, np.nan)
    lone = GripperTrack(
        t_s=track.t_s, X_CH=X, X_BG=X, tracked=one, confidence=one * 0.9, finger_width_m=np.full(N, np.nan)
    )
    none = GripperTrack(
        t_s=track.t_s,
        X_CH=X,
        X_BG=X * np.nan,
        tracked=~one & one,
        confidence=one * 0.0,
        finger_width_m=np.full(N, np.nan),
    )
    q = np.full((N, 7), np.nan)
    ok = np.zeros(N, dtype=bool)
    assert "/gripper/panda_hand" in paths(build(row(), TrackFile(track=lone, q=q, ik_ok=ok, status=None, curves={})))
    with pytest.raises(UnmeasurableError, match="nothing to show"):
        build(row(), TrackFile(track=none, q=q, ik_ok=ok, status=None, curves={}))


def test_replays_of_a_folder_are_written_for_named_samples_with_tracks(tmp_path, plant, track, joints):
    with ResultStore(tmp_path / "out") as store:
        for id in ("a", "b", "trackless"):
            faults = {"feasible": True, "violations": ()} if id == "a" else {}
            store.append(row(id=id, **faults), 0.1)
        for id in ("a", "b"):
            write_track(tmp_path / "out" / "tracks" / f"{id}.npz", track, joints, {})
        store.finish({"config": {"table_height_m": -0.02}})
    rows = read_rows(tmp_path / "out").values()
    tracks = partial(artifact_path, tmp_path / "out", "tracks")
    assert worst_samples(rows, tracks, 5) == ["b", "a"]
    assert worst_samples(rows, tracks, 1) == ["b"]
    written = write_replays(tmp_path / "out", ["b", "trackless"], plant)
    assert written == [artifact_path(tmp_path / "out", "replays", "b")]
    assert written[0].is_file()
    assert not list(written[0].parent.glob(".*"))
    with pytest.raises(UsageError, match="'c'"):
        write_replays(tmp_path / "out", ["c"], plant)
