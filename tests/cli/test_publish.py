"""`bundle`, `verify` and `leaderboard` on the command line: what they print, and their exit statuses."""

import hashlib
import json

import numpy as np
import pytest

from tests.runs.test_verify import altered, bundle, change_row  # noqa: F401  a fixture


def test_a_run_is_bundled_and_ranked(film, program, tmp_path):
    film("videos/a.mp4")
    program("score", tmp_path / "videos", "--out", tmp_path / "out", "--model", "wan")
    code, out, err = program("bundle", tmp_path / "out", "--out", tmp_path / "wan.zip")
    assert (code, err) == (0, "")
    assert out == f"{hashlib.sha256((tmp_path / 'wan.zip').read_bytes()).hexdigest()}  {tmp_path / 'wan.zip'}\n"
    row = json.loads((tmp_path / "out" / "samples.jsonl").read_text())
    assert row["status"] == "ok"
    assert row["input_sha256"] == hashlib.sha256((tmp_path / "videos" / "a.mp4").read_bytes()).hexdigest()

    code, out, err = program("leaderboard", tmp_path / "wan.zip", "--out", tmp_path / "board")
    assert (code, err) == (0, "")
    assert out == f"{tmp_path / 'board' / 'index.html'}\n"


def test_verify_exits_with_1_and_names_the_numbers_that_do_not_hold(bundle, program, tmp_path):  # noqa: F811
    code, out, err = program("verify", bundle, "--samples", 2, "--seed", 3)
    assert (code, err) == (0, "")
    holds = "holds: hashes and aggregates of 4 samples, 2 of 4 measurable ones anew from tracks (--seed 3)\n"
    assert out == f"{bundle}: {holds}"
    path = altered(bundle, tmp_path / "r.zip", change_row)
    code, out, _ = program("verify", path)
    assert code == 1
    assert "results.json: aggregates.executable.mean is " in out
    assert "t1: feasible is True, its track gives False" in out


def test_verify_compares_tracks_with_those_of_the_videos(film, program, tmp_path):
    for name in ("a", "b", "c"):
        film(f"videos/{name}.mp4")
    program("ground", tmp_path / "videos", "--out", tmp_path / "out", "--frame-period", 0.2)
    program("bundle", tmp_path / "out", "--out", tmp_path / "r.zip")
    videos = ("--videos", tmp_path / "videos")
    code, out, _ = program("verify", tmp_path / "r.zip", *videos)
    assert (code, out.count("\n")) == (0, 1)
    assert "3 of 3 measurable ones anew from tracks and videos" in out

    film("videos/b.mp4", frames=9)
    (tmp_path / "videos" / "c.mp4").unlink()
    code, out, _ = program("verify", tmp_path / "r.zip", *videos)
    assert code == 1
    lines = ["b: b.mp4 is another video: its SHA-256 differs", "c: c.mp4 is absent"]
    assert out.splitlines()[:-1] == lines

    def move(files):
        path = tmp_path / "moved.npz"
        path.write_bytes(files["tracks/a.npz"])
        with np.load(path) as arrays:
            moved = dict(arrays)
        moved["camera_from_hand"][:, 0, 3] += 0.011
        np.savez(path, **moved)
        files["tracks/a.npz"] = path.read_bytes()

    code, out, _ = program("verify", altered(tmp_path / "r.zip", tmp_path / "moved.zip", move), *videos)
    assert code == 1
    assert "a: 8 of 8 frames are not within 10 mm and 5 degrees of its video's" in out


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("bundle", "{}", "--out", "r.tar"), "--out r.tar: expected a name that ends in .zip"),
        (("bundle", "{}", "--out", "absent/r.zip"), "there is no folder absent"),
        (("bundle", "{}", "--out", "{}/r.zip"), "holds no samples.jsonl, expected the output folder of a run"),
        (("verify", "{}/absent.zip"), "absent.zip: cannot be read as a bundle: No such file or directory"),
        (("verify", "{}"), "cannot be read as a bundle: Not a regular file"),
        (("verify", "{}/absent.zip", "--videos", "absent"), "--videos absent: there is no such file or folder"),
        (("leaderboard", "{}/absent.zip", "--out", "{}/board"), "cannot be read as a bundle"),
    ],
)
def test_unusable_arguments_end_in_one_line_and_write_nothing(refusal, tmp_path, arguments, line):
    assert line in refusal(*(argument.format(tmp_path) for argument in arguments))
    assert list(tmp_path.iterdir()) == []
