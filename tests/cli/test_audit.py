"""Rows, files, resume and the command line of audits of tiny files."""

import json

import h5py
import numpy as np
import pytest

from kinebench_drake.errors import name_options
from kinebench_drake.results.metadata import Shard
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs.audit import AuditConfig, TrajectoryEvaluator, audit_trajectories
from kinebench_drake.runs.evaluator import KINEMATIC_METRICS
from tests.fakes.records import RunRecorder
from tests.fakes.resources import FakeResources

N = 10
Q = 0.1 * np.ones((N, 7)) + 0.01 * np.arange(N)[:, None]
T_S = 0.1 * np.arange(N)


@pytest.fixture
def source(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    np.savez(folder / "good.npz", t_s=T_S, q=Q, base_from_tcp=np.tile(np.eye(4), (N, 1, 1)))
    np.savez(folder / "far.npz", t_s=T_S, q=Q + 1.0)
    np.savez(folder / "poses.npz", t_s=T_S, base_from_tcp=np.tile(np.eye(4), (N, 1, 1)))
    np.savez(folder / "degrees.npz", t_s=T_S, q=np.rad2deg(Q) * 10)
    np.savez(folder / "single.npz", t_s=T_S[:1], q=Q[:1])
    (folder / "empty.npz").touch()
    with h5py.File(folder / "demo.h5", "w") as file:
        for k in range(2):
            file[f"traj_{k}/obs/agent/qpos"] = Q
    episodes = [{"episode_id": k, "episode_seed": 7 + k, "success": k == 1} for k in range(2)]
    about = {"env_info": {"env_id": "StackCube-v1", "control_freq": 20}, "episodes": episodes}
    (folder / "demo.json").write_text(json.dumps(about))
    return folder


@pytest.fixture
def run(source, tmp_path, fakes):
    def call(observer=None, **changes):
        config = {"source": source, "out": tmp_path / "out", "make_resources": FakeResources, **changes}
        return audit_trajectories(AuditConfig(**{"replays": None, **config}), observer)

    return call


def test_a_file_changed_during_its_audit_is_audited_again_by_the_next_run(run, source, tmp_path, monkeypatch):
    for path in source.iterdir():
        if path.stem != "good":
            path.unlink()
    evaluate = TrajectoryEvaluator.evaluate

    def change(self, sample, resources, row):
        completed = evaluate(self, sample, resources, row)
        np.savez(sample.path, t_s=T_S, q=Q + 1.0)
        return completed

    with monkeypatch.context() as patch:
        patch.setattr(TrajectoryEvaluator, "evaluate", change)
        run()
    assert [row.feasible for row in run().rows] == [False]


def test_the_row_of_a_changed_file_is_dropped_from_rows_and_aggregates(run, source, tmp_path):
    run()
    (source / "empty.npz").write_bytes(b"other")
    run(limit=3)  # which it is not among
    counts = json.loads((tmp_path / "out" / "results.json").read_text())["aggregates"]["samples"]
    assert counts["total"] == len(read_rows(tmp_path / "out")) == 7


def test_every_kind_of_trajectory_becomes_a_row(run, tmp_path):
    summary = run()
    rows = read_rows(tmp_path / "out")
    assert {id: (row.status.value, row.feasible) for id, row in rows.items()} == {
        "good": ("ok", True),
        "far": ("ok", False),
        "poses": ("ok", True),
        "degrees": ("error", None),
        "single": ("unmeasurable", None),
        "empty": ("error", None),
        "demo-traj_0": ("ok", True),
        "demo-traj_1": ("ok", True),
    }
    assert summary.counts == {Status.OK: 5, Status.UNMEASURABLE: 1, Status.ERROR: 2}
    for row in rows.values():
        assert set(KINEMATIC_METRICS) <= set(row.metrics)
        assert "tracked_fraction" not in row.metrics
        assert (row.reason is None) is (row.status is Status.OK)
        if row.status is Status.OK:
            assert set(row.null_reasons) == {name for name, value in row.metrics.items() if value is None}
    assert "degrees" in rows["degrees"].reason
    told = rows["demo-traj_1"]
    assert (told.task, told.seed, told.success) == ("StackCube-v1", 8, True)
    assert told.columns == "obs/agent/qpos: joints"
    assert (told.format, told.judged, told.frames) == ("maniskill", "joints", N)
    assert told.duration_s == pytest.approx((N - 1) / 20)
    assert rows["poses"].judged == "poses"
    assert rows["good"].details["given"] == "q"
    assert rows["good"].dropped_samples == ()
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert (results["kind"], results["samples_found"]) == ("audit", 8)
    assert results["aggregates"]["metrics"]["success"]["mean"] == 0.5


def test_audit_writes_one_track_file_with_joints_poses_and_curves_per_measured_trajectory(run, tmp_path):
    run()
    assert {p.stem for p in (tmp_path / "out" / "tracks").iterdir()} == {
        *("good", "far", "poses", "demo-traj_0", "demo-traj_1"),
    }
    file = read_track(tmp_path / "out" / "tracks" / "good.npz")
    np.testing.assert_array_equal(file.q, Q)
    np.testing.assert_array_equal(file.track.t_s, T_S)
    assert np.isnan(file.track.X_CH).all()
    assert np.isfinite(file.track.X_BG).all()
    assert file.track.tracked.all()
    assert set(file.track.confidence) == {1.0}
    assert {"manipulability", "joint_margin"} <= set(file.curves)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        *("drops.jsonl", "report.html", "results.json", "samples.jsonl", "timings.jsonl", "tracks"),
    ]


def test_resume_skips_finished_trajectories_unless_their_inputs_changed(run, source, tmp_path):
    def done(**changes):
        observer = RunRecorder()
        run(observer, **changes)
        return set(observer.finished)

    reading = source.parent / "reading.json"
    reading.write_text('{"tool": "tcp"}')
    everything = {"good", "far", "poses", "degrees", "single", "empty", "demo-traj_0", "demo-traj_1"}
    tried_again = {"degrees", "empty"}
    assert done() == everything
    assert done() == tried_again
    np.savez(source / "far.npz", t_s=T_S, q=Q + 1.1)
    assert done() == {"far", *tried_again}
    about = json.loads((source / "demo.json").read_text())
    about["episodes"][0]["success"] = True
    (source / "demo.json").write_text(json.dumps(about))
    assert done() == {"demo-traj_0", *tried_again}
    for changes in ({"rate_hz": 20.0}, {"table_height_m": -0.1}, {"reading": reading}):
        assert done(**changes) == everything
    assert done(reading=reading) < everything
    assert done(overwrite=True) == everything
    (tmp_path / "out" / "tracks" / "good.npz").unlink()
    assert done() == {"good", *tried_again}


def test_changed_urdf_srdf_meshes_or_tool_invalidate_stored_rows(run, tmp_path, write_arm):
    """The URDF, the SRDF beside it and the meshes, wherever the URDF finds them, are part of the robot."""
    meshes = ("mesh.obj", "package://parts/above.obj", "package://no/such.obj")
    urdf = write_arm(visuals={k: f'<mesh filename="{mesh}"/>' for k, mesh in enumerate(meshes)})
    (tmp_path / "parts").mkdir()
    arm = {"robot": urdf, "tool": "tool"}
    sums = [len(run_counted(run, **arm)) for _ in range(2)]
    assert sums[0] > sums[1]
    for file in (urdf.parent / "mesh.obj", tmp_path / "parts" / "above.obj", urdf.with_suffix(".srdf")):
        for text in ("<robot/>", "<robot></robot>"):
            file.write_text(text)
            assert len(run_counted(run, **arm)) == sums[0]
            assert len(run_counted(run, **arm)) == sums[1]
    assert len(run_counted(run, robot=urdf, tool="l7")) == sums[0]


def test_another_robot_limits_or_payload_invalidate_stored_rows(run, tmp_path):
    limits = tmp_path / "limits.json"
    every = len(run_counted(run))
    kept = len(run_counted(run))
    for torque in (40, 60):
        limits.write_text(json.dumps({"torque_nm": [torque] * 7}))
        assert len(run_counted(run, limits=limits)) == every
    for changes in ({"robot": "fr3"}, {"payload_kg": 1.0}, {"tool": "0,0,0.2,1,0,0,0"}):
        assert len(run_counted(run, **changes)) == every
        assert len(run_counted(run, **changes)) == kept
    config = json.loads((tmp_path / "out" / "results.json").read_text())["config"]
    assert (config["robot"], config["tool"], config["limits"]) == ("panda", "0,0,0.2,1,0,0,0", None)
    assert config["robot_id"].startswith("panda-")


def test_assumptions_about_a_urdf_are_warnings_and_stand_in_results_json(run, tmp_path, write_arm):
    observer = RunRecorder()
    run(observer, robot=write_arm(types={3: "continuous"}), tool="tool")
    warned = [text.removeprefix("small.urdf: ") for text in observer.warnings if text.startswith("small.urdf: ")]
    assert any("no limits of position: j3" in text for text in warned)
    assert any("no small.srdf beside the URDF" in text for text in warned)
    assert any("acceleration and jerk, which are not checked" in text for text in warned)
    stored = json.loads((tmp_path / "out" / "results.json").read_text())["config"]["robot_remarks"]
    assert stored == list(map(name_options, warned))
    run()
    assert json.loads((tmp_path / "out" / "results.json").read_text())["config"]["robot_remarks"] == []


def run_counted(run, **changes):
    observer = RunRecorder()
    run(observer, **changes)
    return observer.finished


def test_replays_show_the_worst_samples_of_all_resumed_runs_together(run, tmp_path, monkeypatch):
    def write(config, ids):
        for id in ids:
            path = artifact_path(config.out, "replays", id)
            path.parent.mkdir(exist_ok=True)
            path.write_text(id)

    def replayed():
        return {path.stem for path in tmp_path.glob("out/replays/*")}

    monkeypatch.setattr("kinebench_drake.runs.runner.replay_samples", write)
    run(limit=2, replays=1)
    assert replayed() == {"demo-traj_0"}
    run(replays=1)
    assert replayed() == {"far"}
    run(replays=0)
    assert not (tmp_path / "out" / "replays").exists()


def test_shards_split_the_trajectories_within_one_file(run, source, tmp_path):
    for index in (1, 2):
        run(source=source / "demo.h5", out=tmp_path / f"part{index}", shard=Shard(index=index, count=2))
        assert set(read_rows(tmp_path / f"part{index}")) == {f"demo-traj_{index - 1}"}


def test_audit_of_an_audit_output_folder_reads_its_tracks_with_their_ids_and_tasks(run, source, tmp_path):
    run(source=source / "demo.h5")
    run(source=tmp_path / "out", out=tmp_path / "again")
    first = read_rows(tmp_path / "out")
    again = read_rows(tmp_path / "again")
    assert first.keys() == again.keys()
    assert {row.judged for row in again.values()} == {"poses"}
    assert {row.task for row in again.values()} == {"StackCube-v1"}


def test_models_are_named_by_the_subfolders_of_the_source(run, source, tmp_path):
    for model in ("wan", "cogvideox"):
        (source / model / "first").mkdir(parents=True)
        np.savez(source / model / "first" / "a.npz", t_s=T_S, q=Q)
    run(model_from="folder")
    models = {row.video: row.model for row in read_rows(tmp_path / "out").values()}
    assert (models["wan/first/a.npz"], models["cogvideox/first/a.npz"], models["good.npz"]) == (
        "wan",
        "cogvideox",
        None,
    )


def test_audit_runs_no_grounding(run, fakes):
    run()
    assert not fakes.take_calls()


def test_audit_prints_summary_warnings_and_report_path(program, source, tmp_path):
    code, out, err = program("audit", source, "--out", tmp_path / "out", "--tag", "run=7", "--rate", "20")
    assert code == 0
    assert "; error: 2 of 8 samples (1 x " in out
    assert str(tmp_path / "out" / "report.html") in out
    assert "warning: " not in err
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["tags"] == {"run": "7"}
    assert results["config"]["rate_hz"] == 20.0
    code, _, err = program("audit", source / "degrees.npz", "--out", tmp_path / "none")
    assert code == 1
    assert "nothing could be measured (1 error)" in err


def test_an_unusable_urdf_or_limits_file_ends_the_audit_with_status_2_before_anything_is_begun(
    refusal, source, tmp_path
):
    (tmp_path / "arm.urdf").write_text("<robot/>")
    (tmp_path / "limits.json").write_text('{"jerk": [1, 2, 3, 4, 5, 6, 7]}')
    for option, file, message in (
        ("--robot", "arm.urdf", "--robot: arm.urdf: 0 links hang on no joint"),
        ("--limits", "limits.json", "--limits limits.json: has no key 'jerk'; valid are source, lower_rad, "),
    ):
        line = refusal("audit", source, "--out", tmp_path / "out", option, tmp_path / file)
        assert line.startswith(f"kinebench-drake: {message}")
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nowhere", "--out", "out"], "no such file"),
        (["in/good.npz"], "--out"),
        (["in", "--out", "in"], "input folder itself"),
        (["in", "--out", "out", "--rate", "0"], "--rate is 0.0"),
        (["in", "--out", "out", "--rate", "x"], "--rate"),
        (["in", "--out", "out", "--reading", "no.json"], "--reading no.json: there is no such file"),
        (["in", "--out", "out", "--robot", "xarm8"], "folder, expected panda, fr3, xarm7, "),
        (
            ["in/good.npz", "in/far.npz", "-o", "out"],
            "audit reads one PATH, found 2 (good.npz, far.npz): name their folder",
        ),
        (["in", "-o", "out", "--model-from", "folder"], "in has no subfolder with samples"),
        (["in", "-o", "out", "--model-from", "folder", "--model", "wan"], "exclude each other"),
        (["in", "--out", "out", "--tool", "tool0"], "has no link 'tool0'"),
        (["in", "--out", "out", "--tool", "1,2,3"], "metres and a unit quaternion"),
        (["in", "--out", "out", "--payload", "-1"], "--payload is -1.0, expected kilograms from 0 to 50"),
        (["in", "--out", "out", "--table-height", "inf"], "--table-height"),
        (["in", "--out", "out", "--overlay"], "--overlay"),
        (["in", "--out", "out", "--shard", "0/2"], "I from 1 to N"),
    ],
)
def test_usage_errors_end_with_status_2_and_one_line(refusal, source, tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    assert told in refusal("audit", *arguments)
    assert not (tmp_path / "out").exists()
