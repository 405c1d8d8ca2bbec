"""Hostile input: it leads nowhere else, is not waited for, and is shown rather than run."""

import csv
import io
import json
import os
import threading

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError, one_line
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.formats.folders import join_relative
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.files import read_bytes
from kinebench_drake.io.jsonl import parse_json
from kinebench_drake.report.page import write_report
from kinebench_drake.report.table import format_csv
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from kinebench_drake.suites.report.suite_page import write_suite_report
from tests.report.pages import Page, row
from tests.rows import make_violation
from tests.suites.report.synthetic import write_run

# What users hand in


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "/etc/passwd", "a/../../b.mp4", "out.mp4", "a\0b.mp4", "up/b.mp4"]
)
def test_a_manifest_cannot_name_files_outside_of_its_folder(tmp_path, name):
    folder = tmp_path / "in"
    folder.mkdir()
    (tmp_path / "b.mp4").write_bytes(b"x")
    (folder / "out.mp4").symlink_to(tmp_path / "b.mp4")
    (folder / "up").symlink_to(tmp_path)
    with pytest.raises(InputError, match=r"relative path|leads out|cannot be followed"):
        join_relative(folder, name, "video", links_out=False)
    (folder / "manifest.jsonl").write_text(json.dumps({"video": name}) + "\n")
    (sample,) = find_samples(folder / "manifest.jsonl").samples
    assert sample.problem is not None
    assert sample.path == folder


@pytest.mark.parametrize("name", ["camera.json", "manifest.jsonl", "clip.mp4", "clip.npz", "frames/0.png"])
def test_a_named_pipe_does_not_block_reading(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    os.mkfifo(tmp_path / name)
    done = threading.Event()

    def read():
        try:
            source = tmp_path / name if name.endswith(("jsonl", "npz")) else tmp_path
            from kinebench_drake.io.reader import read_video

            for sample in find_samples(source).samples:
                read_video(sample.path, sample.part)
        except (InputError, UsageError):
            pass
        done.set()

    threading.Thread(target=read, daemon=True).start()
    assert done.wait(30)


def test_endless_and_too_large_files_are_refused(tmp_path):
    (tmp_path / "camera.json").symlink_to("/dev/zero")
    with pytest.raises(UsageError, match="regular file"):
        load_camera(tmp_path / "camera.json")
    (tmp_path / "big").write_bytes(b"x" * 11)
    with pytest.raises(OSError, match="Larger"):
        read_bytes(tmp_path / "big", most=10)


def test_deep_json_is_refused_and_overlong_numbers_are_infinity():
    with pytest.raises(ValueError, match="deep"):
        parse_json("[" * 100_000)
    assert parse_json("[1, " + "9" * 400 + "]") == [1, float("inf")]
    with pytest.raises(ValueError, match="Expecting"):
        parse_json(b"")


def test_a_playlist_is_not_read_as_a_video(tmp_path):
    from kinebench_drake.io.container import read_container, write_video
    from kinebench_drake.io.video import WHOLE

    write_video(tmp_path / "real.mp4", np.zeros((3, 96, 96, 3), np.uint8), 10)
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile real.mp4\n")
    assert len(read_container(tmp_path / "real.mp4", WHOLE).frames) == 3
    with pytest.raises(InputError, match="not a readable video"):
        read_container(tmp_path / "list.mp4", WHOLE)


def test_error_messages_are_one_printable_line_of_bounded_length():
    text = str(InputError("a\nb\x1b[2Jc\u202ed\udcff" + "x" * 5000))
    assert text.isprintable()
    assert text.startswith("a b\\x1b[2Jc\\u202ed\\udcff")
    assert len(text) <= 1000
    assert one_line("plain") == "plain"


# Tables


@pytest.mark.parametrize("name", ["=cmd|' /C calc'!A0", "+1", "-rf", "@SUM(1)", "\t=1"])
def test_text_in_a_csv_table_is_no_formula(name):
    [[head], [text, number]] = csv.reader(io.StringIO(format_csv([name], [(name, -0.5)]), newline=""))
    assert (head, text, number) == (f"'{name}", f"'{name}", "-0.5")


# Html


HOSTILE = [
    "<script>alert(1)</script>",
    "a\"onload='x",
    "</script><img src=x onerror=alert(1)>",
    "{{7*7}}",
    "<!--",
    "&lt;",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_report_escapes_names(tmp_path, name):
    fault = make_violation(joint=name, unit=name, link=name, body=name)
    texts = {"prompt": name, "warnings": [name], "framing": {name: name}}
    with ResultStore(tmp_path / "out") as store:
        for id, changes in {
            "a": {"violations": (fault,), "feasible": False, "details": {name: {name: name}}, "extra": texts},
            "b": {"status": Status.ERROR, "reason": name},
        }.items():
            store.append(row(id, task=name, model=name, video=name, null_reasons={name: name}, **changes), 0.1)
        results = {"kind": "score", "config": {"source": name}, "tags": {name: name}, "versions": {name: name}}
        store.finish(results)
    page = Page(write_report(tmp_path / "out").read_text())
    clean(page)


def test_a_suite_report_escapes_names(tmp_path):
    for k, name in enumerate(HOSTILE):
        write_run(tmp_path / str(k), {name: [True, False], "T": [True, True]}, model=name, tags={"k": name})
    page = Page(write_suite_report([tmp_path / str(k) for k in range(len(HOSTILE))], tmp_path / "page").read_text())
    clean(page)


@pytest.mark.parametrize("split", ['x"><script>alert(1)<!--', "/../../../elsewhere", "", "a b"])
def test_a_suite_report_refuses_a_split_that_is_no_name(tmp_path, split):
    write_run(tmp_path / "run", {"T": [True, False]}, split=split)
    with pytest.raises(UsageError, match="names no suite, split and variant"):
        write_suite_report([tmp_path / "run"], tmp_path / "deep" / "page")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]


def clean(page: Page) -> None:
    """The page holds as many scripts as one of plain names, loads nothing, and no tag of a name became one."""
    assert page.scripts <= 2
    assert all(
        link.startswith(("data:", "#", "replays/", "tracks/", "overlays/")) or "/" not in link for link in page.links
    )
    assert "x" not in page.links
