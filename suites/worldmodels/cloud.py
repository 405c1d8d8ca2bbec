"""Cloud services that generate a video as a task: submit, poll, download.

DashScope (Wan of Alibaba Cloud Model Studio): "Wan - image-to-video - first frame API reference (2.1-2.6)",
https://www.alibabacloud.com/help/en/model-studio/legacy-image-to-video-api-reference/
MiniMax (Hailuo): "Image-to-video", "Query video generation task" and "Retrieve file" of its API reference,
https://platform.minimax.io/docs/api-reference/video-generation-i2v; codes: .../docs/api-reference/errorcode
"""

from abc import ABC, abstractmethod
from functools import partial
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar
from urllib.parse import quote

from pydantic import Field
from typing_extensions import override

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.http_client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.media import adopt, arriving, data_uri
from kinebench_drake.suites.worldmodels.remote import BusyError, Limits, ServiceError, clean, key_from, web_address
from kinebench_drake.suites.worldmodels.spec import Spec, TimeoutOptions
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError


class DashScopeOptions(TimeoutOptions):
    """Options of `dashscope:`."""

    resolution: Literal["480P", "720P", "1080P"] = Field("720P", description="size class of the video")
    duration: int = Field(5, ge=2, le=15, description="seconds of video")
    prompt_extend: bool = Field(False, description="let the service rewrite the prompt")
    base: str = Field(
        "https://dashscope-intl.aliyuncs.com", description="address of the region that the key belongs to"
    )


class MiniMaxOptions(TimeoutOptions):
    """Options of `minimax:`."""

    resolution: Literal["512P", "768P", "1080P"] = Field("768P", description="size class of the video")
    duration: Literal["6", "10"] = Field("6", description="seconds of video; 10 not with 1080P")
    prompt_extend: bool = Field(False, description="let the service rewrite the prompt")
    base: str = Field("https://api.minimax.io", description="address of the region that the key belongs to")


_Options = TypeVar("_Options", DashScopeOptions, MiniMaxOptions)


class CloudModel(ABC, Generic[_Options]):
    """World model of a cloud service. One task per video; an accepted task is never submitted again."""

    service: str
    """Name in messages."""
    key: str
    """Environment variable with the service's key."""
    default_model: str
    options_class: type[_Options]
    chooses_length = True
    """Services take seconds of video, not frames."""

    def __init__(self, spec: Spec, limits: Limits | None = None) -> None:
        self._options: _Options = spec.read(self.options_class)
        options = self._options
        if web_address(options.base) is None:
            raise spec.unusable("base= expected an http or https address without name and password")
        self._model = spec.rest or self.default_model
        self._limits = limits or Limits()
        self._client = HttpClient(self.service, options.base, key=key_from(self.key), limits=self._limits)
        self.name = options.name or self._model

    def generate(self, request: Request, out: Path) -> Path:
        """Submit a task, wait until its video is ready, and download it."""
        deadline = Deadline(self._options.timeout)
        task = self._submit(request, deadline)
        while (result := self._result(task, deadline)) is None:
            deadline.wait(self._limits.poll_s)
        with arriving(out) as part:
            self._client.download(self._address(result, deadline), part, deadline)
            return adopt(part, out)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    @abstractmethod
    def _submit(self, request: Request, deadline: Deadline) -> str:
        """Submit a request and return the id of its task."""

    @abstractmethod
    def _result(self, task: str, deadline: Deadline) -> str | None:
        """Return what identifies the video of a task; None while it is generated."""

    def _address(self, result: str, deadline: Deadline) -> str:
        """Return the download address of a result."""
        return result

    def _moderated(self, reason: str) -> WorldModelError:
        return WorldModelError(f"{self.service}'s moderation refused the request or the video ({reason})")


_SUBMIT = "/api/v1/services/aigc/video-generation/video-synthesis"
_MODERATED = "DataInspectionFailed"
_ARREARS = "Arrearage"


class DashScopeModel(CloudModel[DashScopeOptions]):
    """Wan image-to-video on DashScope."""

    service = "DashScope"
    key = "DASHSCOPE_API_KEY"
    default_model = "wan2.6-i2v"
    options_class = DashScopeOptions

    @override
    def _submit(self, request: Request, deadline: Deadline) -> str:
        inputs = {"prompt": request.prompt, "img_url": data_uri(request.first_frame)}
        if request.negative_prompt:
            inputs["negative_prompt"] = request.negative_prompt
        parameters = {
            "resolution": self._options.resolution,
            "duration": self._options.duration,
            "prompt_extend": self._options.prompt_extend,
            "watermark": False,
            "seed": request.seed % (2**31),
        }
        body = {"model": self._model, "input": inputs, "parameters": parameters}
        headers = {"X-DashScope-Async": "enable"}
        try:
            answer = self._client.call("POST", _SUBMIT, deadline, body=body, headers=headers, repeatable=False)
        except ServiceError as error:
            if error.code == _ARREARS:
                raise SetupError(f"{error}; look at the account that {self.key} belongs to") from None
            raise self._moderated(str(error)) if error.code == _MODERATED else error from None
        task = _object(answer, "output").get("task_id")
        if not isinstance(task, str) or not task:
            raise WorldModelError("DashScope accepted the task but gave no task_id")
        return task

    @override
    def _result(self, task: str, deadline: Deadline) -> str | None:
        answer = self._client.call("GET", f"/api/v1/tasks/{quote(task, safe='')}", deadline)
        output = _object(answer, "output")
        status = output.get("task_status")
        address = output.get("video_url")
        if status in ("PENDING", "RUNNING"):
            return None
        if status == "SUCCEEDED" and isinstance(address, str):
            return address
        code = str(output.get("code") or "")
        reason = clean(output.get("message") or "no reason given")
        if code == _MODERATED:
            raise self._moderated(reason)
        raise WorldModelError(f"DashScope's task ended as {clean(status)}: {clean(code)} {reason}")


_RATE_LIMIT = 1002


class MiniMaxModel(CloudModel[MiniMaxOptions]):
    """Hailuo image-to-video on MiniMax. The service accepts neither a seed nor a negative prompt."""

    service = "MiniMax"
    key = "MINIMAX_API_KEY"
    default_model = "MiniMax-Hailuo-02"
    options_class = MiniMaxOptions

    @override
    def _submit(self, request: Request, deadline: Deadline) -> str:
        body = {
            "model": self._model,
            "prompt": request.prompt,
            "first_frame_image": data_uri(request.first_frame),
            "duration": int(self._options.duration),
            "resolution": self._options.resolution,
            "prompt_optimizer": self._options.prompt_extend,
        }
        retry_safely = partial(self._check, transient=(_RATE_LIMIT,))  # only what cannot have cost money
        answer = self._client.call(
            "POST", "/v1/video_generation", deadline, body=body, repeatable=False, check=retry_safely
        )
        task = answer.get("task_id")
        if not isinstance(task, str | int) or not str(task):
            raise WorldModelError("MiniMax accepted the task but gave no task_id")
        return str(task)

    @override
    def _result(self, task: str, deadline: Deadline) -> str | None:
        path = f"/v1/query/video_generation?task_id={quote(task, safe='')}"
        answer = self._client.call("GET", path, deadline, check=self._check)
        status = answer.get("status")
        file = answer.get("file_id")
        if status in ("Preparing", "Queueing", "Processing"):
            return None
        if status == "Success" and isinstance(file, str | int) and str(file):
            return str(file)
        reason = answer.get("error_message") or _status_message(answer)
        raise WorldModelError(f"MiniMax's task ended as {clean(status)}: {clean(reason)}")

    @override
    def _address(self, result: str, deadline: Deadline) -> str:
        path = f"/v1/files/retrieve?file_id={quote(result, safe='')}"
        address = _object(self._client.call("GET", path, deadline, check=self._check), "file").get("download_url")
        if not isinstance(address, str) or not address:
            raise WorldModelError("MiniMax made a video but gave no download_url for it")
        return address

    def _check(self, answer: dict[str, Any], transient: tuple[int, ...] = (1000, 1001, _RATE_LIMIT)) -> None:
        """Raise the error in an answer: MiniMax reports most of them with HTTP status 200."""
        code = _object(answer, "base_resp").get("status_code")
        reason = _status_message(answer)
        message = f"MiniMax answered {clean(code)}: {reason}"
        if code in transient:  # unknown error, time-out, too many requests: to be retried by the manual
            raise BusyError(message, code=str(code))
        if code in (1004, 1008, 2049):  # not authorised, no balance, invalid key
            raise SetupError(f"{message}; look at {self.key} and the account it belongs to")
        if code in (1026, 1027):  # of the request, of the video
            raise self._moderated(reason)
        if code:
            raise WorldModelError(message)


def _status_message(answer: dict[str, Any]) -> str:
    return clean(_object(answer, "base_resp").get("status_msg") or "no reason given")


def _object(answer: dict[str, Any], key: str) -> dict[str, Any]:
    """Return a JSON object within an answer; an empty one where there is none."""
    value = answer.get(key)
    return value if isinstance(value, dict) else {}
