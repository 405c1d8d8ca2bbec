"""Wan image-to-video of Alibaba Cloud Model Studio (DashScope): submit, poll, download.

Protocol: "Wan - image-to-video - first frame API reference (2.1-2.6)",
https://www.alibabacloud.com/help/en/model-studio/legacy-image-to-video-api-reference/
"""

from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from pydantic import Field

from kinebench_drake.suites.worldmodels.client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.service import Limits, ServiceError, data_uri, key_from, remark, web_address
from kinebench_drake.suites.worldmodels.spec import ServiceOptions, Spec
from kinebench_drake.suites.worldmodels.videofile import adopt, arriving
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

KEY = "DASHSCOPE_API_KEY"
_MODEL = "wan2.6-i2v"
_SUBMIT = "/api/v1/services/aigc/video-generation/video-synthesis"
_WAITING = ("PENDING", "RUNNING")
_SEEDS = 2**31
_REFUSED = "DataInspectionFailed"
"""Code of what the service's moderation does not let through."""


class DashScopeOptions(ServiceOptions):
    """Options of `dashscope:`."""

    resolution: Literal["480P", "720P", "1080P"] = Field("720P", description="size class of the video")
    duration: int = Field(5, ge=2, le=15, description="seconds of video")
    prompt_extend: bool = Field(False, description="let the service rewrite the prompt")
    base: str = Field(
        "https://dashscope-intl.aliyuncs.com", description="address of the region that the key belongs to"
    )


class DashScopeModel:
    """One task a video. A task that was accepted is never submitted a second time."""

    def __init__(self, spec: Spec, limits: Limits | None = None) -> None:
        self._options = spec.read(DashScopeOptions)
        if web_address(self._options.base) is None:
            raise spec.unusable("base= expected an http or https address without name and password")
        self._model = spec.rest or _MODEL
        self._limits = limits or Limits()
        self._client = HttpClient("DashScopeModel", self._options.base, key=key_from(KEY), limits=self._limits)
        self.name = self._options.name or self._model

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`."""
        deadline = Deadline(self._options.timeout)
        task = self._submit(request, deadline)
        address = deadline.poll(lambda: self._finished(task, deadline), self._limits.poll_s)
        with arriving(out) as part:
            self._client.download(address, part, deadline)
            return adopt(part, out)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def _submit(self, request: Request, deadline: Deadline) -> str:
        """Id of the task that makes the video."""
        options = self._options
        asked: dict[str, Any] = {"prompt": request.prompt, "img_url": data_uri(request.first_frame)}
        if request.negative_prompt:
            asked["negative_prompt"] = request.negative_prompt
        parameters: dict[str, Any] = {
            "resolution": options.resolution,
            "duration": options.duration,
            "prompt_extend": options.prompt_extend,
            "watermark": False,
            "seed": request.seed % _SEEDS,
        }
        body = {"model": self._model, "input": asked, "parameters": parameters}
        headers = {"X-DashScope-Async": "enable"}
        try:
            answer = self._client.call("POST", _SUBMIT, deadline, body=body, headers=headers, repeatable=False)
        except ServiceError as error:
            raise _refusal(str(error)) if error.code == _REFUSED else error from None
        task = _output(answer).get("task_id")
        if not isinstance(task, str) or not task:
            raise WorldModelError("DashScopeModel accepted the task but gave no task_id")
        return task

    def _finished(self, task: str, deadline: Deadline) -> str | None:
        """Address of the task's video; None while it is made."""
        output = _output(self._client.call("GET", f"/api/v1/tasks/{quote(task, safe='')}", deadline))
        status = output.get("task_status")
        if status in _WAITING:
            return None
        address = output.get("video_url")
        if status == "SUCCEEDED" and isinstance(address, str):
            return address
        code, said = str(output.get("code") or ""), remark(str(output.get("message") or "no reason given"))
        if code == _REFUSED:
            raise _refusal(said)
        raise WorldModelError(f"DashScope's task ended as {remark(str(status))}: {remark(code)} {said}")


def _refusal(said: str) -> WorldModelError:
    return WorldModelError(f"DashScope's moderation refused the request or the video ({said})")


def _output(answer: dict[str, Any]) -> dict[str, Any]:
    output = answer.get("output")
    return output if isinstance(output, dict) else {}
