"""Options and sources that are refused or only listed, and what of them reaches the terminal."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.runs.score import score_videos


def test_options_out_of_range_or_in_conflict_are_refused(film, config, monkeypatch):
    film("videos/a.mp4")
    with pytest.raises(UsageError, match=r"address a:1 goes with \$engine ray"):
        score_videos(config(address="a:1"))
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SetupError, match=r"pip install 'kinebench-drake\[ray\]'"):
        score_videos(config(engine=ExecutorKind.RAY))
    for changes in ({"limit": 0}, {"jobs": 0}, {"seed": -1}, {"frame_period_s": float("nan")}, {"frame_period_s": 0.0}):
        with pytest.raises(UsageError, match="expected"):
            config(**changes)


def test_a_dry_run_lists_samples_and_writes_nothing(film, program, tmp_path):
    film("videos/a.mp4", fps=10)
    (tmp_path / "videos" / "b.mp4").write_text("text")
    film("videos/c.mp4")
    dry_run = ("score", tmp_path / "videos", "--dry-run")
    code, out, _ = program(*dry_run, "--limit", 2)
    a, b, *totals = out.splitlines()
    period = "frame period: 0.1 s, 1 / fps of the file"
    camera = "camera: one known by name where the arm confirms it, else estimated from the arm"
    assert a == f"a: 8 frames of 96 x 96 px; {period}; {camera}; no a.png: minutes if resized or cropped"
    assert b.startswith("b: b.mp4: ")
    assert totals == ["1 of 2 samples can be read; nothing was measured or written", period, camera]
    assert code == 0
    _, resampled, _ = program(*dry_run, "--task-duration", 0.8)
    assert resampled.startswith("a: 5 frames of 96 x 96 px; frame period: 0.2 s")
    cv2.imwrite(str(tmp_path / "videos" / "a.png"), np.zeros((96, 96, 3), np.uint8))
    _, pictured, _ = program(*dry_run, "--limit", 1)
    assert pictured.splitlines()[0] == f"a: 8 frames of 96 x 96 px; {period}; {camera}; given picture: a.png"
    assert not [*tmp_path.rglob("*.jsonl")]


def test_first_frames_of_pending_rounds_are_not_scored_as_a_video(film, program, tmp_path):
    film("run/videos/a_r0.mp4", fps=10)
    (tmp_path / "run" / "ask").mkdir()
    for name in ("samples.jsonl", "results.json", "ask/0.png", "ask/1.png"):
        (tmp_path / "run" / name).touch()
    _, out, _ = program("score", tmp_path / "run", "--out", tmp_path / "out", "--dry-run")
    assert "ask" not in out


def test_labels_reach_the_terminal_as_one_printable_line_of_bounded_length(film, program, tmp_path):
    film("videos/a.mp4")
    film("videos/b.mp4")
    labels = {"model": "\x1b[31mred\n\u202e\x07" + "x" * 100_000, "task": "\ud800"}
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text("".join(json.dumps({"video": f"{name}.mp4", **labels}) + "\n" for name in "ab"))
    for arguments in (("--dry-run",), ()):
        _, out, err = program("score", manifest, "--out", tmp_path / "out", *arguments)
        assert all(line.isprintable() and len(line) <= 1000 for line in (out + err).splitlines())


@pytest.mark.parametrize("command", ["score", "audit"])
def test_a_source_path_too_long_for_the_disk_is_a_usage_error(refusal, tmp_path, command):
    assert "File name too long" in refusal(command, tmp_path / ("x" * 300), "--out", tmp_path / "out")


def test_an_empty_path_is_refused_and_not_taken_as_the_current_folder(film, refusal, tmp_path, monkeypatch):
    film("videos/a.mp4")
    monkeypatch.chdir(tmp_path / "videos")
    for arguments in (("score", "", "--out", "out"), ("score", ".", "--out", ""), ("audit", "", "--out", "out")):
        assert "the path is empty" in refusal(*arguments)
    assert [path.name for path in Path().iterdir()] == ["a.mp4"]


def test_a_seed_beyond_64_bit_is_refused_before_the_run(film, program, refusal, tmp_path):
    film("videos/a.mp4")
    out = ("--out", tmp_path / "out", "--seed")
    assert refusal("score", tmp_path / "videos", *out, 2**63)
    assert not (tmp_path / "out").exists()
    assert [program("score", tmp_path / "videos", *out, 2**63 - 1)[0] for _ in range(2)] == [0, 0]


def test_undecodable_file_names_are_written_with_replacement_characters(film, config, tmp_path):
    """A lone surrogate, as Python reads such names, cannot be written in any encoding."""
    film("videos/a.mp4").rename(tmp_path / "videos" / "caf\udce9.mp4")
    source = (tmp_path / "videos").rename(tmp_path / "vid\udce9os")
    for _ in range(2):  # also when it goes on
        summary = score_videos(config(source=source, tags={"note": "\udce9"}, task="\ud800"))
    (row,) = summary.rows
    assert (row.id, row.video, row.task, row.status.value) == ("caf_", "caf?.mp4", "?", "ok")
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    stored = results["config"]["source"], results["tags"], list(results["per_task"])
    assert stored == ("vid?os", {"note": "?"}, ["?"])
    assert "caf?.mp4" in summary.report.read_text()
