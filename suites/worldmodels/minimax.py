"""MiniMax Hailuo image-to-video: submit, poll, ask for the file's address, download.

Protocol: "Image-to-video", "Query video generation task" and "Retrieve file" of MiniMax's API reference,
https://platform.minimax.io/docs/api-reference/video-generation-i2v; codes: .../docs/api-reference/errorcode
"""

from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from pydantic import Field

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.service import BusyError, Limits, data_uri, key_from, remark, web_address
from kinebench_drake.suites.worldmodels.spec import ServiceOptions, Spec
from kinebench_drake.suites.worldmodels.videofile import adopt, arriving
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

KEY = "MINIMAX_API_KEY"
_MODEL = "MiniMax-Hailuo-02"
_WAITING = ("Preparing", "Queueing", "Processing")
_RATE_LIMIT = 1002
_PASSING = (1000, 1001, _RATE_LIMIT)
"""Unknown error, time-out, too many requests: the service's manual says to try again."""
_ACCOUNT = (1004, 1008, 2049)
"""Not authorised, no balance, invalid key."""
_REFUSED = (1026, 1027)
"""Moderation: of what was asked, of what was made."""


class MiniMaxOptions(ServiceOptions):
    """Options of `minimax:`."""

    resolution: Literal["512P", "768P", "1080P"] = Field("768P", description="size class of the video")
    duration: Literal["6", "10"] = Field("6", description="seconds of video; 10 not with 1080P")
    prompt_extend: bool = Field(False, description="let the service rewrite the prompt")
    base: str = Field("https://api.minimax.io", description="address of the region that the key belongs to")


class MiniMaxModel:
    """One task a video. The service takes neither a seed nor a negative prompt."""

    def __init__(self, spec: Spec, limits: Limits | None = None) -> None:
        self._options = spec.read(MiniMaxOptions)
        if web_address(self._options.base) is None:
            raise spec.unusable("base= expected an http or https address without name and password")
        self._model = spec.rest or _MODEL
        self._limits = limits or Limits()
        self._client = HttpClient("MiniMaxModel", self._options.base, key=key_from(KEY), limits=self._limits)
        self.name = self._options.name or self._model

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`."""
        deadline = Deadline(self._options.timeout)
        task = self._submit(request, deadline)
        file = deadline.poll(lambda: self._finished(task, deadline), self._limits.poll_s)
        with arriving(out) as part:
            self._client.download(self._address(file, deadline), part, deadline)
            return adopt(part, out)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def _submit(self, request: Request, deadline: Deadline) -> str:
        """Id of the task that makes the video."""
        body = {
            "model": self._model,
            "prompt": request.prompt,
            "first_frame_image": data_uri(request.first_frame),
            "duration": int(self._options.duration),
            "resolution": self._options.resolution,
            "prompt_optimizer": self._options.prompt_extend,
        }
        answer = self._client.call(
            "POST", "/v1/video_generation", deadline, body=body, repeatable=False, check=_check_submission
        )
        task = answer.get("task_id")
        if not isinstance(task, str | int) or not str(task):
            raise WorldModelError("MiniMaxModel accepted the task but gave no task_id")
        return str(task)

    def _finished(self, task: str, deadline: Deadline) -> str | None:
        """Id of the file with the task's video; None while it is made."""
        path = f"/v1/query/video_generation?task_id={quote(task, safe='')}"
        answer = self._client.call("GET", path, deadline, check=_check)
        status, file = answer.get("status"), answer.get("file_id")
        if status in _WAITING:
            return None
        if status == "Success" and isinstance(file, str | int) and str(file):
            return str(file)
        said = answer.get("error_message") or _said(answer)
        raise WorldModelError(f"MiniMax's task ended as {remark(str(status))}: {remark(str(said))}")

    def _address(self, file: str, deadline: Deadline) -> str:
        """Where a file can be downloaded."""
        answer = self._client.call("GET", f"/v1/files/retrieve?file_id={quote(file, safe='')}", deadline, check=_check)
        found = answer.get("file")
        address = found.get("download_url") if isinstance(found, dict) else None
        if not isinstance(address, str) or not address:
            raise WorldModelError("MiniMaxModel made a video but gave no download_url for it")
        return address


def _check(answer: dict[str, Any], passing: tuple[int, ...] = _PASSING) -> None:
    """Find the error in an answer: MiniMax tells most of them with HTTP status 200.

    Raises:
        WorldModelError: there is one.
        SetupError: the account cannot be used.
    """
    base = answer.get("base_resp")
    code = base.get("status_code") if isinstance(base, dict) else 0
    said = f"MiniMax answered {remark(str(code))}: {_said(answer)}"
    if code in passing:
        raise BusyError(said, code=str(code))
    if code in _ACCOUNT:
        raise SetupError(f"{said}; look at {KEY} and the account it belongs to")
    if code in _REFUSED:
        raise WorldModelError(f"MiniMax's moderation refused the request or the video ({_said(answer)})")
    if code:
        raise WorldModelError(said)


def _check_submission(answer: dict[str, Any]) -> None:
    """As `_check`, but nothing is sent again that may have begun to cost."""
    _check(answer, (_RATE_LIMIT,))


def _said(answer: dict[str, Any]) -> str:
    base = answer.get("base_resp")
    return remark(str(base.get("status_msg") or "no reason given")) if isinstance(base, dict) else "no reason given"
