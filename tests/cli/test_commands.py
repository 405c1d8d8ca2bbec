"""The program as a user meets it: exit statuses, one-line errors, help."""

import re

import pytest

from kinebench_drake.io import progress
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.config import ScoreConfig
from tests.fakes.resources import fail_to_load

COMMANDS = ["score", "ground", "audit", "report", "doctor", "view"]


def test_score_prints_progress_summary_warnings_and_report_path(program, film, tmp_path):
    film("videos/a.mp4")
    film("videos/b.mp4", feasible=False)
    film("videos/c.mp4", raises=RuntimeError())
    code, out, err = program(
        "score", tmp_path / "videos", "--out", tmp_path / "out", "--tag", "run=7", "--tag", "x=a=b"
    )
    assert code == 0
    assert "feasible: 1 of 2 judged samples, 50% (95% interval 9% to 91%; at least 33% of all 3)" in out
    assert "unmeasurable: 0 of 3 samples; error: 1 of 3 samples: " in out
    assert str(tmp_path / "out" / "report.html") in out
    period = "frame period: 0.05882 s, 1 / fps of the file; but the benchmark camera fits: no verdict changes at 0.2 s"
    assert f"{period}\ncamera: the benchmark's\n" in out
    *finished, warning = err.splitlines()
    assert [line.split("]")[0] for line in finished] == ["[1/3", "[2/3", "[3/3"]
    assert warning.startswith("warning: no camera is named for 2 samples: the arm confirms one that is known by name")
    assert '"x": "a=b"' in (tmp_path / "out" / "results.json").read_text()
    code, _, err = program("score", tmp_path / "videos", "--out", tmp_path / "out", "--overwrite", "--limit", 1)
    assert (code, list(read_rows(tmp_path / "out"))) == (0, ["a"])


def test_progress_within_a_long_video_is_printed_with_its_name(program, film, tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "EVERY_S", 0.0)
    film("a.mp4", frames=3)
    _, _, err = program("score", tmp_path / "a.mp4", "--out", tmp_path / "out")
    assert err.splitlines()[:3] == [f"[0/1] a: {k} frames read" for k in (1, 2, 3)]


def test_ground_writes_results_and_overlay_and_report_renders_only_run_folders(program, refusal, film, tmp_path):
    film("a.mp4")
    code, out, _ = program(
        "ground", tmp_path / "a.mp4", "--out", tmp_path / "out", "--overlay", "--frame-period", "0.2"
    )
    assert code == 0
    assert "results.json" in out
    assert (tmp_path / "out" / "overlays" / "a.mp4").is_file()
    code, out, _ = program("report", tmp_path / "out")
    assert code == 0
    assert (tmp_path / "out" / "report.html").read_text().startswith("<!doctype html>")
    assert "samples.jsonl" in refusal("report", tmp_path)


def test_score_exits_with_status_1_when_nothing_could_be_measured(program, film, tmp_path):
    film("videos/a.mp4", has_gripper=False)
    (tmp_path / "videos" / "b.mp4").write_text("text")
    code, _, err = program("score", tmp_path / "videos", "--out", tmp_path / "out")
    assert code == 1
    assert "nothing could be measured (1 unmeasurable, 1 error)" in err.splitlines()[-1]
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nowhere", "--out", "out"], "no such file"),
        (["empty", "--out", "out"], "holds no video"),
        (["text.txt", "--out", "out"], "expected a video"),
        (["videos"], "--out"),
        (["videos", "--out", "file/below"], "cannot be written"),
        (["videos", "--out", "videos"], "input folder itself"),
        (["videos", "--out", "out", "--address", "a:1"], "goes with --engine ray"),
        (["videos", "--out", "out", "--engine", "slurm"], "slurm"),
        (["videos", "--out", "out", "--shard", "5/4"], "I/N"),
        (["videos", "--out", "out", "--shard", "0/4"], "I from 1 to N"),
        (["videos", "--out", "out", "--jobs", "0"], "--jobs"),
        (["videos", "--out", "out", "--limit", "x"], "--limit"),
        (["videos", "--out", "out", "--tag", "novalue"], "KEY=VALUE"),
        (["videos", "--out", "out", "--tag", "x=1", "--tag", "x=2"], "given twice"),
        (["videos", "--out", "out", "--frame-period", "nan"], "--frame-period"),
        (["videos", "--out", "out", "--frame-period", "0"], "--frame-period"),
        (["videos", "--out", "out", "--frame-period", "1e300"], "seconds from 0.0001 to 1000"),
        (["videos", "--out", "out", "--table-height", "nan"], "--table-height"),
        (["videos", "--out", "out", "--table-height", "720"], "metres"),
        (["videos", "--out", "out", "--nonsense"], "--nonsense"),
        (["bad_camera", "--out", "out"], "camera.json"),
        (["empty.jsonl", "--out", "out"], "is empty"),
    ],
)
def test_usage_errors_end_with_status_2_and_one_line(refusal, film, tmp_path, monkeypatch, arguments, told):
    film("videos/a.mp4")
    film("bad_camera/a.mp4")
    (tmp_path / "bad_camera" / "camera.json").write_text('{"width": "wide"}')
    (tmp_path / "empty").mkdir()
    for name in ("file", "text.txt", "empty.jsonl"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    assert told in refusal("score", *arguments)
    assert not (tmp_path / "out").exists()


def test_missing_dependencies_end_with_status_1_and_one_line_that_names_doctor(program, film, tmp_path, monkeypatch):
    film("videos/a.mp4")
    monkeypatch.setitem(ScoreConfig.__init__.__kwdefaults__, "make_resources", fail_to_load)
    code, _, err = program("score", tmp_path / "videos", "--out", tmp_path / "out")
    assert code == 1
    assert "doctor" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_has_an_example(program, command):
    code, out, err = program(command, "--help")
    assert (code, err) == (0, "")
    assert re.search(rf"Examples?:\n +kinebench-drake {command}", out)


def test_help_lists_every_command_and_version_prints_the_program_name(program):
    code, out, _ = program("--help")
    assert code == 0
    assert all(re.search(rf"^  {command} ", out, re.MULTILINE) for command in COMMANDS)
    code, out, _ = program("--version")
    assert (code, out.startswith("kinebench-drake")) == (0, True)


def test_an_unknown_command_is_answered_with_the_nearest_command_or_the_list(refusal):
    assert refusal("scor").startswith("kinebench-drake: no command 'scor' (did you mean score?);")
    assert "no command 'frobnicate'; there are doctor, score" in refusal("frobnicate")
