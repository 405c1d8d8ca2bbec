"""Program as a world model: reads the request on standard input, writes a video file."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import IO

from kinebench_drake.errors import SetupError, cause
from kinebench_drake.executors.interrupt import defer_interrupts
from kinebench_drake.io.atomic import disk_errors, unfinished
from kinebench_drake.suites.worldmodels.media import adopt, png
from kinebench_drake.suites.worldmodels.remote import clean
from kinebench_drake.suites.worldmodels.spec import Spec, TimeoutOptions
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModel, WorldModelError

_PLACEHOLDER = re.compile(r"\{([a-z_]+)\}")
_FIELDS = ("episode", "task", "round", "prompt", "negative_prompt", "seed", "num_frames", "fps")
_PLACEHOLDERS = (*_FIELDS, "width", "height", "first_frame", "out")
_GRACE_S = 2.0
"""Time between SIGTERM and SIGKILL."""
_PEEK = os.WEXITED | os.WNOHANG | os.WNOWAIT


class CommandModel(WorldModel):
    """World model that runs a program for each video, without a shell.

    The program receives the request as a JSON object on standard input and through `{placeholders}` in its arguments.
    It writes the video to the path `out` and exits with status 0.
    """

    def __init__(self, spec: Spec) -> None:
        options = spec.read(TimeoutOptions)
        try:
            self._arguments = shlex.split(spec.rest)
        except ValueError as error:
            raise spec.unusable(f"cannot be split into arguments ({error})") from None
        if not self._arguments:
            raise spec.unusable("expected command:PROGRAM ARGUMENTS")
        unknown = {m for argument in self._arguments for m in _PLACEHOLDER.findall(argument)} - {*_PLACEHOLDERS}
        if unknown:
            valid = ", ".join(f"{{{name}}}" for name in _PLACEHOLDERS)
            raise spec.unusable(f"there is no placeholder {{{min(unknown)}}}; there are {valid}")
        if shutil.which(self._arguments[0]) is None:
            raise spec.unusable(f"there is no program {self._arguments[0]}, or it is not executable")
        self._timeout_s = options.timeout
        self.name = options.name or _script_name(self._arguments)

    def generate(self, request: Request, out: Path) -> Path:
        """Run the program and store its video beside `out`."""
        part = unfinished(out)
        with disk_errors(out.name), tempfile.TemporaryDirectory(prefix=f"{part.name}.", dir=part.parent) as name:
            folder = Path(name)
            first_frame = folder / "first_frame.png"
            video = folder / "video.mp4"
            log = folder / "log"
            first_frame.write_bytes(png(request.first_frame))
            fields = _request_fields(request, first_frame, video)
            actions = {} if request.actions is None else {"actions": request.actions.to_json()}
            (folder / "request.json").write_text(json.dumps({**fields, **actions}), encoding="utf-8")
            arguments = [_PLACEHOLDER.sub(lambda m: str(fields[m[1]]), argument) for argument in self._arguments]
            with (folder / "request.json").open("rb") as request_file, log.open("wb") as log_file:
                status = self._run(arguments, request_file, log_file)
            if status is None:
                problem = f"gave no video within {self._timeout_s:g} s; the option timeout= allows more"
            elif status:
                problem = f"failed with status {status}" if status > 0 else f"failed with signal {-status}"
            elif not video.exists():
                problem = "ended well but wrote no video to {out}"
            else:
                return adopt(video, out)
            raise WorldModelError(f"{self.name} {problem}{_last_line(log)}")

    def _run(self, arguments: list[str], request: IO[bytes], log: IO[bytes]) -> int | None:
        """Run the program and return its exit status; None if it was terminated after the time limit."""
        process: subprocess.Popen[bytes] | None = None
        try:
            with defer_interrupts():  # else an interrupt could leave a process that nothing terminates
                process = subprocess.Popen(
                    arguments, stdin=request, stdout=subprocess.DEVNULL, stderr=log, start_new_session=True
                )
            return process.wait(self._timeout_s)
        except subprocess.TimeoutExpired:
            return None
        except (OSError, ValueError) as error:
            raise SetupError(f"{self.name} cannot be started ({cause(error)})") from None
        finally:
            if process is not None and process.returncode is None:
                with defer_interrupts():
                    _terminate(process)


def _script_name(arguments: list[str]) -> str:
    """Return what names a command line best: its script or module, as `python` names many models, else its program."""
    for before, argument in pairwise(arguments):
        if before == "-m" or Path(argument).is_file():
            return Path(argument).name
    return Path(arguments[0]).name


def _terminate(process: subprocess.Popen[bytes]) -> None:
    """Terminate the process group. Its leader is reaped last, so that the group id cannot be reused before."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        if number == signal.SIGTERM:
            deadline = time.monotonic() + _GRACE_S
            while os.waitid(os.P_PID, process.pid, _PEEK) is None and time.monotonic() < deadline:
                time.sleep(_GRACE_S / 100)
    process.wait()


def _request_fields(request: Request, first_frame: Path, video: Path) -> Mapping[str, str | int | float]:
    height, width = request.first_frame.shape[:2]
    return {
        **{name: getattr(request, name) for name in _FIELDS},
        "width": width,
        "height": height,
        "first_frame": str(first_frame.resolve()),
        "out": str(video.resolve()),
    }


def _last_line(log: Path) -> str:
    """Return the last line of standard error, for a message."""
    with log.open("rb") as file:
        file.seek(max(file.seek(0, os.SEEK_END) - 4096, 0))
        lines = [line for line in file.read().decode(errors="replace").splitlines() if line.strip()]
    return f": {clean(lines[-1])}" if lines else ""
