"""The first frame as services take it."""

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
