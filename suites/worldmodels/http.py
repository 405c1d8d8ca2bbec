"""World model behind HTTP, by one of two contracts of docs/worldmodels.md.

simple: one POST, answered with a video. predict: the stateless `/v1/predict`, answered with frames.
"""

import io
from collections.abc import Iterable, Iterator
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, Field, ValidationError

from kinebench_drake.errors import SetupError, cause
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.files import open_file
from kinebench_drake.suites.worldmodels.http_client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.media import (
    adopt,
    arriving,
    base64_png,
    data_uri,
    encode_answer,
    from_base64,
)
from kinebench_drake.suites.worldmodels.remote import Limits, ServiceError, clean, key_from, web_address
from kinebench_drake.suites.worldmodels.spec import Spec, TimeoutOptions
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

_MOST_PIXELS = 2048 * 2048
_CHUNK_BYTES = 1 << 22
_KNOCK_S = 5.0
"""Time in which a server need not answer, but be connected."""
_Side = Annotated[int, Field(ge=1, le=8192)]
_PREDICT = "/v1/predict"
_READY = ("ok", "ready", "healthy")
_ENCODED = "video_base64"
_ANSWERS = ("video_path", "video_url", _ENCODED)
_NO_SUCH_PAGE = (
    HTTPStatus.OK,  # a web page in place of JSON
    HTTPStatus.BAD_REQUEST,
    HTTPStatus.NOT_FOUND,
    HTTPStatus.METHOD_NOT_ALLOWED,
    HTTPStatus.NOT_IMPLEMENTED,
)


class HttpOptions(TimeoutOptions):
    """Options of `http:`."""

    style: Literal["auto", "simple", "predict"] = Field(
        "auto", description="contract of the server; auto: predict if it answers /v1/capabilities"
    )
    key_env: str | None = Field(
        None, pattern=r"^[A-Za-z_]\w*$", description="the environment variable whose value is sent as bearer token"
    )


class Capabilities(BaseModel):
    """Capabilities of a predict server; absent ones are not limited."""

    max_num_frames: int | None = Field(None, ge=2)
    """Most frames of one prediction, including the given one."""
    size: tuple[_Side, _Side] | None = None
    """Required width and height of the given frame [px]."""


class HttpModel:
    """World model on a server; its contract is detected with the first video unless the spec names it."""

    def __init__(self, spec: Spec, limits: Limits | None = None) -> None:
        options = spec.read(HttpOptions)
        url = web_address(spec.address)
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
        self._client = HttpClient(f"the world model at {url.netloc.decode()}", base, key=key, limits=limits)
        self._capabilities: Capabilities | None = None
        self.name = options.name or f"{url.netloc.decode()}{url.path.rstrip('/').removesuffix(_PREDICT)}"

    def generate(self, request: Request, out: Path) -> Path:
        """Request a video or frames, by the contract of the server."""
        deadline = Deadline(self._timeout_s)
        if self._style == "auto":
            self._style = "predict" if self._answers_capabilities(deadline) else "simple"
        if self._style == "simple":
            return self._generate_video(request, out, deadline)
        if self._capabilities is None:
            self._capabilities = self._read_capabilities(deadline)
        return self._generate_frames(request, out, deadline, self._capabilities)

    def check(self) -> None:
        """Check that the server listens."""
        self._client.require_connection(min(_KNOCK_S, self._timeout_s))

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def _answers_capabilities(self, deadline: Deadline) -> bool:
        try:
            self._client.call("GET", "/v1/capabilities", deadline)
        except ServiceError as error:
            if error.status in _NO_SUCH_PAGE:
                return False
            raise
        return True

    def _read_capabilities(self, deadline: Deadline) -> Capabilities:
        """Return the capabilities of a predict server that is ready."""
        status = self._client.call("GET", "/v1/health", deadline).get("status")
        if status not in _READY:
            raise SetupError(f"the world model is not ready: its health is {clean(status)!r}, expected 'ok'")
        try:
            return Capabilities.model_validate(self._client.call("GET", "/v1/capabilities", deadline))
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            key = ".".join(map(str, first["loc"]))
            raise SetupError(f"the world model's capabilities: {key}: {first['msg']}") from None

    def _generate_frames(self, request: Request, out: Path, deadline: Deadline, capabilities: Capabilities) -> Path:
        """Request frames and write them as an mp4 beside `out`."""
        frame = request.first_frame
        if capabilities.size is not None:
            frame = np.asarray(Image.fromarray(frame).resize(capabilities.size, Image.Resampling.LANCZOS))
        frames = {"frames": [base64_png(frame)]}
        num_frames = min(request.num_frames, capabilities.max_num_frames or request.num_frames)
        answer = self._post(_PREDICT, _body(request, frames, frame, num_frames), "frames", deadline)
        return encode_answer(_decode_frames(answer, num_frames, deadline), request.fps, out)

    def _generate_video(self, request: Request, out: Path, deadline: Deadline) -> Path:
        """Request a video and store it beside `out`."""
        frame = request.first_frame
        body = _body(request, {"first_frame": data_uri(frame)}, frame, request.num_frames)
        answer = self._post("", body, _ENCODED, deadline)
        with arriving(out) as part:
            self._fetch(answer, part, deadline)
            deadline.left()  # decoding a large answer takes seconds
            return adopt(part, out)

    def _post(self, path: str, body: dict[str, Any], files: str, deadline: Deadline) -> dict[str, Any]:
        return self._client.call("POST", path, deadline, body=body, patient=True, files=(files,))

    def _fetch(self, answer: dict[str, Any], part: Path, deadline: Deadline) -> None:
        """Store the video of an answer in a file."""
        kinds = [name for name in _ANSWERS if answer.get(name) is not None]
        if answer.get("error"):
            beside = f" (and {', '.join(kinds)} beside the error: answer with exactly one of them)" if kinds else ""
            raise WorldModelError(f"the world model gave no video: {clean(answer['error'])}{beside}")
        if len(kinds) != 1 or not isinstance(answer[kinds[0]], str | memoryview):
            raise WorldModelError(
                f"the world model's answer has {' and '.join(kinds) or 'no video'}; expected exactly one of "
                f"{', '.join(_ANSWERS)}, a string"
            )
        kind, value = kinds[0], answer[kinds[0]]
        if kind == "video_url":
            self._client.download(value, part, deadline)
        elif kind == "video_path":
            if not self._client.is_local:
                raise WorldModelError(
                    "video_path is accepted only from a server on this machine; answer with video_url"
                )
            if not Path(value).is_absolute():
                raise WorldModelError("the world model's video_path is not an absolute path")
            self._store(_pieces(Path(value)), part, deadline)
        else:
            try:
                data = from_base64(value)
            except ValueError:
                raise WorldModelError("the world model's video_base64 is not base64") from None
            self._store([data], part, deadline)

    def _store(self, chunks: Iterable[bytes], part: Path, deadline: Deadline) -> None:
        """Write a video to a file, within size limit and deadline."""
        budget = self._client.video_budget()
        with disk_errors(part.name), part.open("wb") as file:
            for chunk in chunks:
                deadline.left()
                budget.take(len(chunk))
                file.write(chunk)


def _pieces(path: Path) -> Iterator[bytes]:
    try:
        with open_file(path) as file:
            yield from iter(partial(file.read, _CHUNK_BYTES), b"")
    except (OSError, ValueError) as error:
        raise WorldModelError(f"the world model's video_path cannot be read ({cause(error)})") from None


def _body(request: Request, conditioning: dict[str, Any], frame: NDArray[np.uint8], num_frames: int) -> dict[str, Any]:
    height, width = frame.shape[:2]
    return {
        "prompt": request.prompt,
        "negative_prompt": request.negative_prompt,
        "seed": request.seed,
        **conditioning,
        "num_frames": num_frames,
        "size": [width, height],
        "fps": request.fps,
        **({} if request.actions is None else {"actions": request.actions.first(num_frames).to_json()}),
    }


def _decode_frames(answer: dict[str, Any], most: int, deadline: Deadline) -> Iterator[NDArray[np.uint8]]:
    """Decode the frames (H, W, 3) RGB of an answer, of which there are at most `most`, one at a time."""
    texts = answer.get("frames")
    if answer.get("error"):
        raise WorldModelError(f"the world model gave no frames: {clean(answer['error'])}")
    if not isinstance(texts, list) or not texts or not all(isinstance(text, str | memoryview) for text in texts):
        raise WorldModelError("the world model's answer has no frames; expected a list of PNG files in base64")
    if len(texts) > most:
        raise WorldModelError(f"the world model answered with {len(texts)} frames, {most} were requested")
    shape: tuple[int, ...] | None = None
    for number, text in enumerate(texts):
        frame = _decode_image(text, number)
        shape = shape or frame.shape
        if frame.shape != shape:
            raise WorldModelError("the world model's frames are of different sizes")
        deadline.left()
        yield frame


def _decode_image(text: str | memoryview, number: int) -> NDArray[np.uint8]:
    try:
        image = Image.open(io.BytesIO(from_base64(text)), formats=["PNG"])
        if image.width * image.height > _MOST_PIXELS:
            raise WorldModelError(
                f"the world model's frame {number} has {image.width} x {image.height} pixels, too many"
            )
        return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise WorldModelError(f"the world model's frame {number} is not a PNG file in base64") from None
