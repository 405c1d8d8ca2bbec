"""What a service may take, and how it fails."""

import base64
import io
import ipaddress
import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

import httpx
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import SecretStr

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How long and how much."""

    attempts: int = 8
    """Times that one call is tried."""
    first_wait_s: float = 1.0
    """Wait before the second attempt; each further one is twice as long, and up to this much is added by chance."""
    longest_wait_s: float = 60.0
    """Longest wait of our own choice; a service may ask for longer ones."""
    silence_s: float = 60.0
    """Longest time without a byte, save where a service makes a video while we wait."""
    poll_s: float = 10.0
    """Pause between two questions whether a video is ready."""
    json_bytes: int = 4 << 20
    """Largest answer in JSON that holds no video."""
    video_bytes: int = 512 << 20
    """Largest video."""


class ServiceError(WorldModelError):
    """A service did not give what was asked for.

    Args:
        message: what happened.
        status: HTTP status of its answer; None if there was none.
        code: its own code for what it did not like.
    """

    def __init__(self, message: str, *, status: int | None = None, code: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.code = code


class BusyError(ServiceError):
    """The same request may succeed a little later: after `after_s` seconds if the service said so."""

    after_s: float | None = None


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


_LONGEST = 200
_SECRET = re.compile(r"KEY|TOKEN|SECRET|PASSWORD|CREDENTIAL")
_LEAST_SECRET = 6
"""Shorter values of such variables are no secrets; blotting them out would only spoil words."""


def remark(text: str) -> str:
    """`text` in one line without control signs, not too long, without what the environment holds as secret.

    Args:
        text: an error message, perhaps of many lines; services like to repeat the key they did not accept.
    """
    values = (v.strip() for name, v in os.environ.items() if _SECRET.search(name.upper()))
    for value in sorted((v for v in values if len(v) >= _LEAST_SECRET), key=len, reverse=True):
        text = text.replace(value, "***")
    line = " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 3] + "..."


def key_from(variable: str) -> SecretStr:
    """The key that an environment variable holds; nothing but the request's header ever sees it.

    Raises:
        SetupError: the variable is not set, or holds what no header can carry.
    """
    key = os.environ.get(variable, "").strip()
    if not key:
        raise SetupError(f"{variable} is not set: set this environment variable to the service's key")
    if not (key.isascii() and key.isprintable()):
        raise SetupError(f"{variable} holds signs that no key has: set it to the service's key alone")
    return SecretStr(key)


def web_address(text: str) -> httpx.URL | None:
    """The address if it is one of http or https with a host and without a name and password, else None."""
    try:
        url = httpx.URL(text)
        url.host.encode("idna")  # as whoever looks it up will
    except (httpx.InvalidURL, ValueError):
        return None
    return url if url.scheme in ("http", "https") and url.host and not url.userinfo else None


def is_loopback(url: httpx.URL) -> bool:
    """Whether the host is this machine by any of its own names."""
    host = url.host.rstrip(".").lower()
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def origin(url: httpx.URL) -> tuple[str, str, int | None]:
    """Scheme, host and port: what a key is meant for."""
    port = url.port if url.port is not None else {"http": 80, "https": 443}.get(url.scheme)
    return url.scheme, url.host.lower(), port


def retry_after(header: str) -> float | None:
    """Seconds that a `Retry-After` header asks to wait; None if it asks for nothing (RFC 9110, section 10.2.3)."""
    text = header.strip()
    if text.isascii() and text.isdecimal():
        return float(text)
    try:
        moment = parsedate_to_datetime(text)
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return max((moment - datetime.now(UTC)).total_seconds(), 0.0)
