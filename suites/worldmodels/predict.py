"""The stateless prediction contract: `/v1/health`, `/v1/capabilities`, `/v1/predict`, frames as PNG in base64."""

import io
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, Field, ValidationError

from kinebench_drake.errors import SetupError
from kinebench_drake.mp4 import write_video
from kinebench_drake.storage import storage
from kinebench_drake.suites.worldmodels.client import Client
from kinebench_drake.suites.worldmodels.deadline import Deadline
from kinebench_drake.suites.worldmodels.picture import base64_png, from_base64
from kinebench_drake.suites.worldmodels.remark import remark
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

    def __init__(self, client: Client, deadline: Deadline) -> None:
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
        with storage(path.name):
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
