"""A world model behind HTTP: one POST answered with a video, or the stateless `/v1/predict` answered with frames.

Both are described in docs/worldmodels.md so that a server can be written from there.
"""

import shutil
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from kinebench_drake.storage import storage
from kinebench_drake.suites.worldmodels.address import web_address
from kinebench_drake.suites.worldmodels.client import Client
from kinebench_drake.suites.worldmodels.deadline import Deadline
from kinebench_drake.suites.worldmodels.picture import data_uri, from_base64
from kinebench_drake.suites.worldmodels.predict import Predictor
from kinebench_drake.suites.worldmodels.remark import key_from, remark
from kinebench_drake.suites.worldmodels.service import Limits, ServiceError
from kinebench_drake.suites.worldmodels.spec import ServiceOptions, Spec
from kinebench_drake.suites.worldmodels.videofile import adopt, arriving
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

_PREDICT = "/v1/predict"
_ANSWERS = ("video_path", "video_url", "video_base64")
_NOT_HERE = (
    HTTPStatus.OK,
    HTTPStatus.BAD_REQUEST,
    HTTPStatus.NOT_FOUND,
    HTTPStatus.METHOD_NOT_ALLOWED,
    HTTPStatus.NOT_IMPLEMENTED,
)
"""How a server answers a question it does not know; with 200 if a web page says so."""


class HttpOptions(ServiceOptions):
    """Options of `http:`."""

    style: Literal["auto", "simple", "predict"] = Field(
        "auto", description="which contract the server keeps; auto asks it for /v1/capabilities"
    )
    key_env: str | None = Field(
        None, pattern=r"^[A-Za-z_]\w*$", description="environment variable whose value is sent as bearer token"
    )


class Http:
    """Asks a server that keeps one of the two contracts; which one is found out with the first video."""

    def __init__(self, spec: Spec, limits: Limits | None = None) -> None:
        options = spec.read(HttpOptions)
        given = f"{spec.kind}:{spec.rest}" if spec.rest.startswith("//") else spec.rest
        url = web_address(given)
        if url is None or url.query or url.fragment:
            # The spec itself is not repeated: it may hold a password.
            raise Spec(text="http://...", kind="http", rest="", options={}).unusable(
                "expected http://HOST:PORT/PATH, http:URL or https://..., without name, password and query; a key is "
                "given with ?key_env=VARIABLE"
            )
        base, self._style = str(url), options.style
        if base.rstrip("/").endswith(_PREDICT) and self._style != "simple":
            base, self._style = base.rstrip("/").removesuffix(_PREDICT), "predict"
        self._timeout_s = options.timeout
        key = key_from(options.key_env) if options.key_env else None
        self._limits = limits or Limits()
        self._client = Client("the world model", base, key=key, limits=self._limits)
        self._predictor: Predictor | None = None
        self.name = options.name or "http"

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`."""
        deadline = Deadline(self._timeout_s)
        if self._style == "auto":
            self._style = "predict" if self._has_capabilities(deadline) else "simple"
        if self._style == "predict":
            if self._predictor is None:
                self._predictor = Predictor(self._client, deadline)
            return self._predictor.generate(request, out, deadline)
        return self._simple(request, out, deadline)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def _has_capabilities(self, deadline: Deadline) -> bool:
        try:
            self._client.call("GET", "/v1/capabilities", deadline)
        except ServiceError as error:
            if error.status in _NOT_HERE:
                return False
            raise
        return True

    def _simple(self, request: Request, out: Path, deadline: Deadline) -> Path:
        height, width = request.first_frame.shape[:2]
        body = {
            "prompt": request.prompt,
            "negative_prompt": request.negative_prompt,
            "seed": request.seed,
            "first_frame": data_uri(request.first_frame),
            "num_frames": request.num_frames,
            "size": [width, height],
            "fps": request.fps,
        }
        most = self._limits.video_bytes // 3 * 4 + self._limits.json_bytes
        answer = self._client.call("POST", "", deadline, body=body, patient=True, most_bytes=most)
        with arriving(out) as part:
            self._fetch(answer, part, deadline)
            return adopt(part, out)

    def _fetch(self, answer: dict[str, Any], part: Path, deadline: Deadline) -> None:
        """Put the video of an answer into a file."""
        given = [name for name in _ANSWERS if answer.get(name) is not None]
        if answer.get("error") and not given:
            raise WorldModelError(f"the world model gave no video: {remark(str(answer['error']))}")
        if len(given) != 1 or not isinstance(answer[given[0]], str):
            raise WorldModelError(
                f"the world model's answer has no video; expected one of {', '.join(_ANSWERS)}, a string"
            )
        kind, value = given[0], answer[given[0]]
        if kind == "video_url":
            self._client.download(value, part, deadline)
        elif kind == "video_path":
            if not self._client.is_local:
                raise WorldModelError(
                    "video_path is accepted only from a server on this machine; answer with video_url"
                )
            path = Path(value)
            if not path.is_absolute() or not path.is_file():
                raise WorldModelError("the world model's video_path is not the absolute path of a file that is there")
            with storage(part.name):
                shutil.copyfile(path, part)
        else:
            try:
                data = from_base64(value)
            except ValueError:
                raise WorldModelError("the world model's video_base64 is not base64") from None
            with storage(part.name):
                part.write_bytes(data)
