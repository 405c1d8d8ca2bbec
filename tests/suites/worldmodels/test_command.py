import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.worldmodels.command import CommandModel
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request, WorldModelError


def run(program: str, request: Request, out: Path, *, arguments: str = "", options: str = "?timeout=60") -> Path:
    """Run a Python program (without quotes) as a world model."""
    return CommandModel(parse(f"command:{sys.executable} -S -c '{program}' {arguments}{options}")).generate(
        request, out
    )


COPY = 'import json, shutil, sys; shutil.copy(sys.argv[1], json.load(sys.stdin)["out"])'


def test_a_program_generates_a_video_by_its_format(
    request_: Request, out: Path, film: bytes, gif: bytes, tmp_path: Path
) -> None:
    for data, suffix in ((film, ".mp4"), (gif, ".gif")):
        (tmp_path / "it").write_bytes(data)
        path = run(COPY, request_, out, arguments=f"{tmp_path}/it")
        assert (path, path.read_bytes()) == (out.with_name(out.name + suffix), data)
        path.unlink()
    assert list(out.parent.iterdir()) == []


def test_a_program_gets_the_request_on_stdin_and_as_placeholders(
    request_: Request, out: Path, film: bytes, tmp_path: Path
) -> None:
    (tmp_path / "it").write_bytes(film)
    program = (
        "import json, shutil, sys; told = json.load(sys.stdin); keep, it, out, frame = sys.argv[1:5]; "
        'shutil.copy(it, out); shutil.copy(frame, keep + "/frame.png"); '
        'json.dump([told, sys.argv[3:]], open(keep + "/told", "w"))'
    )
    given = "{out} {first_frame} --p={prompt} '{seed} {width}x{height}' '{\"a\": 1}'"
    run(program, request_, out, arguments=f"{tmp_path} {tmp_path}/it {given}")
    told, argv = json.loads((tmp_path / "told").read_text())
    assert argv == [told["out"], told["first_frame"], f"--p={request_.prompt}", f"{2**31 + 7} 96x64", '{"a": 1}']
    assert told["prompt"] == request_.prompt  # a single argument, whatever a shell would make of it
    assert (told["episode"], told["round"], told["num_frames"], told["fps"]) == ("StackCube-v1_s0003", 0, 5, 17.0)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "frame.png")), request_.first_frame)


def test_a_program_gets_the_requested_actions_as_json(
    request_: Request, actions: ActionTrack, out: Path, film: bytes, tmp_path: Path
) -> None:
    (tmp_path / "it").write_bytes(film)
    program = (
        'import json, shutil, sys; told = json.load(sys.stdin); shutil.copy(sys.argv[1], told["out"]); '
        'json.dump(told.get("actions"), open(sys.argv[1] + ".told", "w"))'
    )
    for given in (actions, None):
        run(program, replace(request_, actions=given), out, arguments=f"{tmp_path}/it")
        told = json.loads((tmp_path / "it.told").read_text())
        assert told == (None if given is None else given.to_json())


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ('import sys; sys.exit("first\\nno such checkpoint")', "failed with status 1: no such checkpoint"),
        ("import os; os.kill(os.getpid(), 9)", "failed with signal 9"),
        ("print(1)", "wrote no video"),
        ('import json, sys; open(json.load(sys.stdin)["out"], "w").write("<a>")', "not a video"),
    ],
)
def test_a_failed_program_is_reported_by_status_and_last_line(
    request_: Request, out: Path, program: str, message: str
) -> None:
    with pytest.raises(WorldModelError, match=message):
        run(program, request_, out)
    assert list(out.parent.iterdir()) == []


def test_a_program_and_its_children_are_killed_at_the_timeout(request_: Request, out: Path, tmp_path: Path) -> None:
    """A child deaf to the first signal holds the other end of a pipe: that we can read to its end shows it dead."""
    os.mkfifo(tmp_path / "pipe")
    end = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    child = 'trap "" TERM; echo here; sleep 60; sleep 60'
    spec = f"command:sh -c '({child}) > {tmp_path}/pipe & echo dying >&2; wait'?timeout=0.4"
    start = time.monotonic()
    with pytest.raises(WorldModelError, match=r"no video within 0\.4 s.*: dying"):
        CommandModel(parse(spec)).generate(request_, out)
    assert time.monotonic() - start < 30
    os.set_blocking(end, True)
    heard = b""
    while data := os.read(end, 99):  # ends only when nobody can write any more
        heard += data
    os.close(end)
    assert heard == b"here\n"
    assert list(out.parent.iterdir()) == []


@pytest.mark.parametrize("moment", ["it is started", "it runs"])
def test_a_program_is_terminated_with_the_run(
    request_: Request, out: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """SIGTERM as workers answer it, when the program has begun but nobody knows it yet, or while it is waited for."""
    started = []

    class Popen(subprocess.Popen):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            started.append(self)
            if moment == "it is started":
                signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(subprocess, "Popen", Popen)
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
    first = "kill -TERM $PPID; " if moment == "it runs" else ""
    try:
        with pytest.raises(SystemExit, match="7"):
            CommandModel(parse(f"command:sh -c '{first}exec sleep 60'")).generate(request_, out)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert [process.returncode for process in started] == [-signal.SIGTERM]
    assert list(out.parent.iterdir()) == []


def test_secrets_in_the_error_of_a_program_are_masked(request_: Request, out: Path, keys: str) -> None:
    with pytest.raises(WorldModelError, match=r"status 1: bad key \*\*\*$"):
        run('import os, sys; sys.exit("bad key " + os.environ["MY_API_KEY"])', request_, out)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("command:", "expected command:PROGRAM"),
        ("command:'a", "cannot be split"),
        ("command:no-such-program-here x", "there is no program no-such-program-here"),
        ("command:true {prompts}", r"there is no placeholder \{prompts\}; there are \{episode\}, \{task\}"),
        ("command:true?timeout=-1", "timeout=-1: Input should be greater than 0"),
    ],
)
def test_unusable_commands_are_usage_errors(spec: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        CommandModel(parse(spec))


def test_a_program_is_named_by_its_script(tmp_path: Path) -> None:
    (tmp_path / "wan.py").touch()
    names = {
        f"{sys.executable} {tmp_path}/wan.py --steps 3": "wan.py",
        f"{sys.executable} -u {tmp_path}/wan.py": "wan.py",
        f"{sys.executable} -m models.wan --out {{out}}": "models.wan",
        "true {prompt}": "true",
        "true {prompt}?name=wan": "wan",
    }
    assert {text: CommandModel(parse(f"command:{text}")).name for text in names} == names


def test_question_marks_in_a_command_are_not_parsed_as_options() -> None:
    assert parse("command:a http://b/?c=d?").rest == "a http://b/?c=d"
    assert parse("command:a what? --b?timeout=3").options == {"timeout": "3"}
    assert parse("command:ls a?.png").rest == "ls a?.png"
