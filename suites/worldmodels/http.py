"""A world model behind HTTP: one POST answered with a video, or the stateless `/v1/predict` answered with frames.

Both are described in docs/worldmodels.md so that a server can be written from there.
"""

import io
import shutil
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, Field, ValidationError

from kinebench_drake.errors import SetupError
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.worldmodels.client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.service import (
    Limits,
    ServiceError,
    base64_png,
    data_uri,
    from_base64,
    key_from,
    remark,
    web_address,
)
from kinebench_drake.suites.worldmodels.spec import ServiceOptions, Spec
from kinebench_drake.suites.worldmodels.videofile import adopt, arriving
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

_MOST_PIXELS = 4096 * 4096
_Side = Annotated[int, Field(ge=1, le=8192)]
_READY = ("ok", "ready", "healthy")


class Capabilities(BaseModel):
    """What a server says it can do; what it does not say is not limited."""

    max_num_frames: int | None = Field(None, ge=2)
    """Most frames of one prediction, the given one included."""
    size: tuple[_Side, _Side] | None = None
    """Width and height that it wants frames in [px]."""


class Predictor:
    """A server that is up.

    Raises:
        SetupError: it is not, or says of itself what cannot be understood.
        WorldModelError: it cannot be asked.
    """

    def __init__(self, client: HttpClient, deadline: Deadline) -> None:
        self._client = client
        status = client.call("GET", "/v1/health", deadline).get("status")
        if status not in _READY:
            raise SetupError(f"the world model is not ready: its health is {remark(str(status))!r}, expected 'ok'")
        try:
            self._can = Capabilities.model_validate(client.call("GET", "/v1/capabilities", deadline))
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            raise SetupError(
                f"the world model's capabilities: {'.'.join(map(str, first['loc']))}: {first['msg']}"
            ) from None

    def generate(self, request: Request, out: Path, deadline: Deadline) -> Path:
        """The predicted frames as an mp4 beside `out`.

        Raises:
            WorldModelError: the server gave no frames.
        """
        limits = self._client.limits
        most = limits.video_bytes // 3 * 4 + limits.json_bytes
        answer = self._client.call(
            "POST", "/v1/predict", deadline, body=self._body(request), patient=True, most_bytes=most
        )
        frames = _frames(answer)
        path = out.with_name(f"{out.name}.mp4")
        with disk_errors(path.name):
            write_video(path, frames, request.fps)
        return path

    def _body(self, request: Request) -> dict[str, Any]:
        frame = request.first_frame
        if self._can.size is not None:
            frame = np.asarray(Image.fromarray(frame).resize(self._can.size, Image.Resampling.LANCZOS))
        height, width = frame.shape[:2]
        return {
            "prompt": request.prompt,
            "negative_prompt": request.negative_prompt,
            "seed": request.seed,
            "frames": [base64_png(frame)],
            "num_frames": min(request.num_frames, self._can.max_num_frames or request.num_frames),
            "size": [width, height],
            "fps": request.fps,
        }


def _frames(answer: dict[str, Any]) -> list[NDArray[np.uint8]]:
    """The frames (H, W, 3) RGB of an answer."""
    given = answer.get("frames")
    if not isinstance(given, list) or not given or not all(isinstance(text, str) for text in given):
        said = f": {remark(str(answer['error']))}" if answer.get("error") else ""
        raise WorldModelError(f"the world model's answer has no frames{said}; expected a list of PNG files in base64")
    frames = [_picture(text, number) for number, text in enumerate(given)]
    if len({frame.shape for frame in frames}) > 1:
        raise WorldModelError("the world model's frames are of different sizes")
    return frames


def _picture(text: str, number: int) -> NDArray[np.uint8]:
    try:
        image = Image.open(io.BytesIO(from_base64(text)), formats=["PNG"])
        if image.width * image.height > _MOST_PIXELS:
            raise WorldModelError(
                f"the world model's frame {number} has {image.width} x {image.height} pixels, too many"
            )
        return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise WorldModelError(f"the world model's frame {number} is not a PNG file in base64") from None


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


class HttpModel:
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
        self._client = HttpClient("the world model", base, key=key, limits=self._limits)
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
            with disk_errors(part.name):
                shutil.copyfile(path, part)
        else:
            try:
                data = from_base64(value)
            except ValueError:
                raise WorldModelError("the world model's video_base64 is not base64") from None
            with disk_errors(part.name):
                part.write_bytes(data)
