"""The first frame as services take it, and what they give in the same way."""

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def png(frame: NDArray[np.uint8]) -> bytes:
    """A frame (H, W, 3) RGB as the bytes of a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(frame).save(buffer, format="png")
    return buffer.getvalue()


def base64_png(frame: NDArray[np.uint8]) -> str:
    """A frame (H, W, 3) RGB as a PNG file in base64."""
    return base64.b64encode(png(frame)).decode()


def data_uri(frame: NDArray[np.uint8]) -> str:
    """A frame (H, W, 3) RGB as a data URI of type image/png."""
    return f"data:image/png;base64,{base64_png(frame)}"


def from_base64(text: str) -> bytes:
    """The bytes of a file in base64, with or without the head of a data URI and line breaks.

    Raises:
        ValueError: it is not base64.
    """
    payload = text.partition(",")[2] if text.startswith("data:") else text
    return base64.b64decode("".join(payload.split()), validate=True)
