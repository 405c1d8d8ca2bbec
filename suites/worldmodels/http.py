"""World model behind HTTP, by one of two contracts of docs/worldmodels.md.

simple: one POST, answered with a video, as servers of KineBench (https://github.com/minecraft-zzz/KineBench,
docs/videox_http_service.md). predict: that of WorldArena 2.0 (`predict.py`), answered with frames.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from kinebench_drake.errors import cause
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.files import open_file
from kinebench_drake.suites.worldmodels.http_client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.media import adopt, arriving, data_uri, encode_answer, from_base64
from kinebench_drake.suites.worldmodels.predict import CAPABILITIES, PATH, PredictService
from kinebench_drake.suites.worldmodels.remote import Limits, ServiceError, clean, key_from, web_address
from kinebench_drake.suites.worldmodels.spec import Spec, TimeoutOptions
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

_PATHS = ("video_path", "path", "output_path")
_URLS = ("video_url", "url")
_ENCODED = ("video_base64", "video")
"""Keys of an answer for a file of this machine, an address and a file in base64; the first is the documented one."""
_ANSWERS = (*_PATHS, *_URLS, *_ENCODED)
_NO_SUCH_PAGE = (
    HTTPStatus.OK,  # a web page in place of JSON
    HTTPStatus.BAD_REQUEST,
    HTTPStatus.NOT_FOUND,
    HTTPStatus.METHOD_NOT_ALLOWED,
    HTTPStatus.NOT_IMPLEMENTED,
)

_CONNECT_S = 5.0
"""Time in which a server need not answer, but be connected."""


class HttpOptions(TimeoutOptions):
    """Options of `http:`."""

    style: Literal["auto", "simple", "predict"] = Field(
        "auto", description="contract of the server; auto: predict if it answers /v1/capabilities"
    )
    key_env: str | None = Field(
        None, pattern=r"^[A-Za-z_]\w*$", description="the environment variable whose value is sent as bearer token"
    )


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
        base = str(url)
        self._style = options.style
        if base.rstrip("/").endswith(PATH) and self._style != "simple":
            base = base.rstrip("/").removesuffix(PATH)
            self._style = "predict"
        self._timeout_s = options.timeout
        self._client = HttpClient(
            f"the world model at {url.netloc.decode()}",
            base,
            key=key_from(options.key_env) if options.key_env else None,
            limits=limits,
        )
        self._predict: PredictService | None = None
        self.name = options.name or f"{url.netloc.decode()}{url.path.rstrip('/').removesuffix(PATH)}"

    def generate(self, request: Request, out: Path) -> Path:
        """Request a video or frames, by the contract of the server."""
        deadline = Deadline(self._timeout_s)
        if self._style == "auto":
            self._style = "predict" if self._answers_capabilities(deadline) else "simple"
        if self._style == "simple":
            return self._generate_video(request, out, deadline)
        if self._predict is None:
            self._predict = PredictService(self._client, deadline)
        return encode_answer(self._predict.frames(request, deadline), request.fps, out)

    def check(self) -> None:
        """Check that the server listens."""
        self._client.require_connection(min(_CONNECT_S, self._timeout_s))

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def _answers_capabilities(self, deadline: Deadline) -> bool:
        try:
            self._client.call("GET", CAPABILITIES, deadline)
        except ServiceError as error:
            if error.status in _NO_SUCH_PAGE:
                return False
            raise
        return True

    def _generate_video(self, request: Request, out: Path, deadline: Deadline) -> Path:
        """Request a video and store it beside `out`."""
        answer = self._client.call("POST", "", deadline, body=_body(request), patient=True, files=_ENCODED)
        with arriving(out) as part:
            self.fetch(answer, part, deadline)
            deadline.left()  # decoding a large answer takes seconds
            return adopt(part, out)

    def fetch(self, answer: dict[str, Any], part: Path, deadline: Deadline) -> None:
        """Store the video of an answer in a file."""
        kinds = [name for name in _ANSWERS if answer.get(name) is not None]
        if answer.get("error"):
            beside = f" (and {', '.join(kinds)} beside the error: answer with exactly one of them)" if kinds else ""
            raise WorldModelError(f"the world model gave no video: {clean(answer['error'])}{beside}")
        if len(kinds) != 1 or not isinstance(answer[kinds[0]], str | memoryview):
            raise WorldModelError(
                f"the world model's answer has {' and '.join(kinds) or 'no video'}; expected exactly one of "
                f"{', '.join(keys[0] for keys in (_PATHS, _URLS, _ENCODED))}, a string"
            )
        kind = kinds[0]
        value = answer[kinds[0]]
        if kind in _URLS:
            self._client.download(value, part, deadline)
        elif kind in _PATHS:
            if not self._client.is_local:
                raise WorldModelError(f"{kind} is accepted only from a server on this machine; answer with video_url")
            if not Path(value).is_absolute():
                raise WorldModelError(f"the world model's {kind} is not an absolute path")
            self._store(_pieces(kind, Path(value)), part, deadline)
        else:
            try:
                data = from_base64(value)
            except ValueError:
                raise WorldModelError(f"the world model's {kind} is not base64") from None
            self._store([data], part, deadline)

    def _store(self, chunks: Iterable[bytes], part: Path, deadline: Deadline) -> None:
        """Write a video to a file, within size limit and deadline."""
        budget = self._client.video_budget()
        with disk_errors(part.name), part.open("wb") as file:
            for chunk in chunks:
                deadline.left()
                budget.take(len(chunk))
                file.write(chunk)


def _pieces(key: str, path: Path) -> Iterator[bytes]:
    try:
        with open_file(path) as file:
            yield from iter(partial(file.read, 1 << 22), b"")
    except (OSError, ValueError) as error:
        raise WorldModelError(f"the world model's {key} cannot be read ({cause(error)})") from None


def _body(request: Request) -> dict[str, Any]:
    height, width = request.first_frame.shape[:2]
    return {
        "prompt": request.prompt,
        "negative_prompt": request.negative_prompt,
        "seed": request.seed,
        "first_frame": data_uri(request.first_frame),
        "num_frames": request.num_frames,
        "target_frames": request.num_frames,
        "size": [width, height],
        "output_size": [width, height],
        "fps": request.fps,
        **({} if request.actions is None else {"actions": request.actions.to_json()}),
    }
