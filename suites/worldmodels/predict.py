"""Contract "predict" of a world model behind HTTP: version 1.0 of the world model service API of WorldArena 2.0.

Stateless: each request holds conditioning frames and the actions that follow, each answer one frame per action, without
the conditioning frames. https://github.com/WorldArena2/WorldArena-2.0, assets/track2_world_model_service_api_en.md
"""

import io
import uuid
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, Field, ValidationError

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.http_client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.media import base64_png, from_base64
from kinebench_drake.suites.worldmodels.remote import clean
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request, WorldModelError

PATH = "/v1/predict"
CAPABILITIES = "/v1/capabilities"
_VERSION = "1.0"
_SAMPLE = "sample-0"
DIMENSION = 8
"""Numbers of an action: seven joint angles [rad] and the gap between the finger pads [m]."""
_Side = Annotated[int, Field(ge=1, le=2048)]
_Count = Annotated[int, Field(ge=1, le=10_000)]


class ImageFormat(BaseModel):
    """Pictures of a profile."""

    height: _Side
    width: _Side


class Range(BaseModel):
    """Least and largest number of frames."""

    min: Annotated[int, Field(ge=1, le=64)] = 1
    max: _Count


class ActionProfile(BaseModel):
    """Actions of a profile."""

    dimension: _Count


class Instruction(BaseModel):
    """Instructions of a profile."""

    supported: bool = False


class Profile(BaseModel):
    """Format of requests and answers."""

    profile_id: str
    image: ImageFormat
    context_frames: Range
    prediction_frames: Range
    action: ActionProfile
    instruction: Instruction = Instruction()


class Capabilities(BaseModel):
    """Capabilities of a server."""

    api_version: str
    model_version: str
    profiles: tuple[Profile, ...]

    def profile(self) -> Profile:
        """Return the first profile whose actions are those of the arm.

        Raises:
            SetupError: there is none, or the server has another version of the interface.
        """
        if self.api_version.partition(".")[0] != _VERSION.partition(".")[0]:
            raise SetupError(f"the world model has api_version {clean(self.api_version)}, expected {_VERSION}")
        for profile in self.profiles:
            if profile.action.dimension == DIMENSION:
                return profile
        names = ", ".join(f"{clean(p.profile_id)} with {p.action.dimension}" for p in self.profiles) or "none"
        raise SetupError(
            f"the world model's profiles: {names}; expected one with {DIMENSION} numbers an action: seven joint angles "
            "and the gap between the pads"
        )


class PredictService:
    """A server of this contract."""

    def __init__(self, client: HttpClient, deadline: Deadline) -> None:
        """Read what the server can do.

        Raises:
            SetupError: it is not ready, or its profiles do not fit.
            WorldModelError: it does not answer.
        """
        status = client.call("GET", "/v1/health", deadline).get("status")
        if status != "ready":
            raise SetupError(f"the world model is not ready: its health is {clean(status)!r}, expected 'ready'")
        try:
            capabilities = Capabilities.model_validate(client.call("GET", CAPABILITIES, deadline))
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            key = ".".join(map(str, first["loc"]))
            raise SetupError(f"the world model's capabilities: {key}: {first['msg']}") from None
        self._client = client
        self._version = capabilities.model_version
        self._profile = capabilities.profile()

    def frames(self, request: Request, deadline: Deadline) -> Iterator[NDArray[np.uint8]]:
        """Request a clip and decode its frames (H, W, 3) RGB, the first of them that of the request, one at a time.

        Raises:
            SetupError: the request holds no actions.
            WorldModelError: the answer is unusable.
        """
        if request.actions is None:
            raise SetupError("the world model predicts from actions: run with --condition actions")
        profile = self._profile
        size = (profile.image.width, profile.image.height)
        first = np.asarray(Image.fromarray(request.first_frame).resize(size, Image.Resampling.LANCZOS))
        body = self._body(request, request.actions, first)
        answer = self._client.call("POST", PATH, deadline, body=body, patient=True, files=("predictions",))
        yield first
        for number, picture in enumerate(_pictures(answer, body)):
            yield _decode_image(picture, number, size)
            deadline.left()

    def _body(self, request: Request, actions: ActionTrack, first: NDArray[np.uint8]) -> dict[str, Any]:
        # before the clip the robot stands still
        profile = self._profile
        start = self._profile.context_frames.min
        vectors = np.column_stack([actions.q, actions.finger_width_m]).round(9).tolist()
        height, width = first.shape[:2]
        form = {"encoding": "png_base64", "color_space": "RGB", "height": height, "width": width, "channels": 3}
        return {
            "api_version": _VERSION,
            "request_id": str(uuid.uuid4()),
            "model_version": self._version,
            "profile_id": profile.profile_id,
            "samples": [
                {
                    "sample_id": _SAMPLE,
                    "seed": request.seed,
                    "context": {
                        "frames": [{**form, "data": base64_png(first)}] * start,
                        "actions": vectors[:1] * (start - 1),
                        "instruction": request.prompt if profile.instruction.supported else None,
                    },
                    "actions": vectors[1 : profile.prediction_frames.max + 1],
                }
            ],
        }


def _pictures(answer: Mapping[str, Any], body: Mapping[str, Any]) -> Sequence[object]:
    """Return the picture objects of an answer, one per action of the request."""
    if answer.get("error"):
        raise WorldModelError(f"the world model gave no frames: {clean(answer['error'])}")
    for name in ("request_id", "model_version"):
        if answer.get(name) != body[name]:
            raise WorldModelError(f"the world model's answer has {name} {clean(answer.get(name))}, not the request's")
    predictions = answer.get("predictions")
    first = predictions[0] if isinstance(predictions, list) and len(predictions) == 1 else None
    frames = first.get("frames") if isinstance(first, dict) and first.get("sample_id") == _SAMPLE else None
    wanted = len(body["samples"][0]["actions"])
    if not isinstance(frames, list) or len(frames) != wanted:
        count = f"{len(frames)} frames" if isinstance(frames, list) else "no frames"
        raise WorldModelError(f"the world model's answer has {count} of {_SAMPLE}, expected {wanted}, one per action")
    return frames


def _decode_image(picture: object, number: int, size: tuple[int, int]) -> NDArray[np.uint8]:
    data = picture.get("data") if isinstance(picture, dict) else None
    try:
        if not isinstance(data, str | memoryview):
            raise ValueError
        image = Image.open(io.BytesIO(from_base64(data)), formats=["PNG"])
        if image.size != size:
            raise WorldModelError(
                f"the world model's frame {number} has {image.width} x {image.height} pixels, expected "
                f"{size[0]} x {size[1]}"
            )
        return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise WorldModelError(f"the world model's frame {number} is not a picture object with a PNG file") from None
