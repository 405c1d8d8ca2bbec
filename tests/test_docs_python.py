"""The code of docs/api.md, docs/conventions.md and docs/tutorial.md runs, and says what the text says."""

import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake import cli
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from tests.films import shorten_clips

ROOT = Path(__file__).parent.parent
CLIP = ROOT / "examples" / "videos" / "PickFruits-v1_s0010_unseen.mp4"


def blocks(page):
    """Blocks of Python in a page of docs/, each with its heading."""
    heading = ""
    found = []
    text = (ROOT / "docs" / page).read_text()
    for title, code in re.findall(r"^#+ ([^\n]+)$|^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        heading = title or heading
        if code:
            found.append((heading, code))
    return found


def run(page, space, chosen=lambda heading: True):
    for heading, code in blocks(page):
        if chosen(heading):
            exec(compile(code, f"docs/{page}: {heading}", "exec"), space)
    return space


def test_projected_pixels_are_those_of_the_text(capsys):
    space = run("conventions.md", {})
    np.testing.assert_allclose(space["camera"].X_BC[:3, 3], [1.015, 0.0, 0.45])
    np.testing.assert_allclose(space["camera"].project(space["p_C"]), [[192.0, 204.7], [245.4, 204.7]], atol=0.06)
    assert (
        "(1.015, 0, 0.45) m, and the pixels (192, 204.7) and (245.4, 204.7)"
        in (ROOT / "docs" / "conventions.md").read_text()
    )


@pytest.mark.slow
def test_code_of_the_interface_page_runs_with_the_described_results(tmp_path, monkeypatch):
    (tmp_path / "videos").mkdir()
    write_video(tmp_path / "videos" / "clip.mp4", read_video(CLIP).frames[20:29], 17)
    save_camera(benchmark_camera(), tmp_path / "videos" / "camera.json")
    monkeypatch.chdir(tmp_path)
    space = run("api.md", {"__name__": "docs"}, lambda heading: heading != "A suite")
    assert space["result"].feasible is True
    assert 1.0 < space["fast"].metrics["slowdown_min"] < 20.0
    assert [row.id for row in space["summary"].rows] == ["clip"]  # of the audit


@pytest.mark.sapien
@pytest.mark.slow
def test_code_of_the_suite_section_runs(tmp_path, monkeypatch):
    shorten_clips(monkeypatch)
    monkeypatch.chdir(tmp_path)
    space = run("api.md", {"__name__": "docs"}, lambda heading: heading in ("Python interface", "A suite"))
    assert space["summary"].success.mean == 0.0


@pytest.mark.sapien
@pytest.mark.slow
def test_commands_of_the_tutorial_print_the_quoted_lines(tmp_path, monkeypatch, capsys):
    """Commands of the program run in this process: one start of it, and one of the renderer, are enough."""
    page = (ROOT / "docs" / "tutorial.md").read_text()
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    for command in re.findall(r"^ {4}(\S.*)$", page, re.MULTILINE):
        program, *arguments = shlex.split(command)
        if program != "kinebench-drake":
            subprocess.run([program, *arguments], check=True)
            continue
        with pytest.raises(SystemExit) as stop:
            cli.main(arguments)
        assert stop.value.code == 0, command
    told = capsys.readouterr().out.splitlines()
    quoted = "".join(re.findall(r"^```\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)).splitlines()
    assert [line for line in quoted if line not in told] == []
    named = re.findall(r"`(tutorial-[\w/.-]+)`", page)
    assert [path for path in named if not (tmp_path / path).exists()] == []
