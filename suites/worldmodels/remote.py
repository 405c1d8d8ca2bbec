"""Remote services: limits of calls, errors, messages without secrets, keys and addresses."""

import ipaddress
import os
import re
import socket
from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

import httpx
from pydantic import SecretStr

from kinebench_drake.errors import SetupError
from kinebench_drake.io.files import Budget
from kinebench_drake.io.jsonl import parse_json
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError

_SHORTEST = 6
"""Letters of a secret: shorter values are none, and masking them would garble words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of time and size."""

    attempts: int = 8
    """Attempts of one call."""
    first_wait_s: float = 1.0
    """Wait before the second attempt; doubled for each further one, plus a random part of up to this much."""
    longest_wait_s: float = 60.0
    """Upper limit of this wait; a service may ask for a longer one."""
    silence_s: float = 60.0
    """Longest time without a byte, except while a service generates a video."""
    poll_s: float = 10.0
    """Period of asking whether a video is ready."""
    json_bytes: int = 4 << 20
    """Largest JSON answer apart from files in base64."""
    video_bytes: int = 256 << 20
    """Largest video."""

    @property
    def encoded_video_bytes(self) -> int:
        """Largest JSON answer with a video in base64."""
        return self.video_bytes // 3 * 4 + self.json_bytes


class ServiceError(WorldModelError):
    """Failed call of a service, with the HTTP status of the answer (None without one) and the service's error code."""

    def __init__(self, message: str, *, status: int | None = None, code: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.code = code


class BusyError(ServiceError):
    """Failure after which the same request may succeed: after `after_s` seconds if the service gave them."""

    def __init__(
        self, message: str, *, status: int | None = None, code: str = "", after_s: float | None = None
    ) -> None:
        super().__init__(message, status=status, code=code)
        self.after_s = after_s


class UnreachableError(BusyError):
    """The request was not sent."""


_FILE_BYTES = 4096
"""Length of strings in an answer above which they are set aside."""
_LARGE = 1 << 24
_ESCAPED = 16
"""Size of an answer from which on escapes are rare, and the least bytes for each: base64 with line breaks and escaped
slashes has about 35."""
_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+"', re.DOTALL)


def parse_answer(data: bytearray, files: Collection[str], budget: Budget) -> object:
    """Parse a JSON answer; long strings are cut out before, `budget` holds for the rest.

    Below the keys `files` long strings become views of the data, with their escapes; elsewhere only the beginning of a
    long string of the two outermost levels is kept.

    Raises:
        ValueError: it is not JSON, or nested too deeply.
        InputError: it exceeds the budget, or consists of escapes.
    """
    if len(data) > _LARGE and data.count(b"\\") * _ESCAPED > len(data):
        raise budget.exceeded
    text = bytearray()
    cut = dict[str, memoryview]()
    start = 0
    while (begin := data.find(b'"', start)) >= 0:
        string = _STRING.match(data, begin)
        if string is None:
            raise ValueError("it ends within a string")
        is_long = string.end() - begin > _FILE_BYTES
        end = begin if is_long else string.end()
        budget.take(end - start + 2)
        text += data[start:end]
        if is_long:
            text += f'"\\u0000{len(cut)}"'.encode()
            cut[f"\0{len(cut)}"] = memoryview(data)[begin + 1 : string.end() - 1]
        start = string.end()
    budget.take(len(data) - start)
    answer = parse_json(bytes(text + data[start:]))

    def restore(value: object, whole: bool, depth: int = 0) -> object:
        deeper = whole or depth <= 1
        if deeper and isinstance(value, list):
            return [restore(item, whole, depth + 1) for item in value]
        if deeper and isinstance(value, dict):
            return {key: restore(item, whole or key in files, depth + 1) for key, item in value.items()}
        view = cut.get(value) if isinstance(value, str) else None
        return value if view is None else view if whole else bytes(view[:_FILE_BYTES]).decode(errors="replace")

    return restore(answer, False)


_LONGEST = 200
_SECRET = re.compile(r"KEY|TOKEN|SECRET|PASSWORD|CREDENTIAL")
_KEYS: set[str] = set()  # that were read in this process, whatever their variables are called


def clean(message: object) -> str:
    """Return a remote message as one line of limited length, without control characters and secrets.

    Services like to repeat a rejected key: values of environment variables with names of secrets are masked.
    """
    text = str(message)
    values = (v.strip() for name, v in os.environ.items() if _SECRET.search(name.upper()))
    for value in sorted({*(v for v in values if len(v) >= _SHORTEST), *_KEYS}, key=len, reverse=True):
        text = text.replace(value, "***")
    line = " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 3] + "..."


def key_from(variable: str) -> SecretStr:
    """Return the key in an environment variable; it is used in request headers only.

    Raises:
        SetupError: the variable is not set, or is not valid in a header.
    """
    key = os.environ.get(variable, "").strip()
    if not key:
        raise SetupError(f"{variable} is not set: set this environment variable to the service's key")
    if not (key.isascii() and key.isprintable()):
        raise SetupError(f"{variable} holds signs that no key has: set it to the service's key alone")
    _KEYS.add(key)
    return SecretStr(key)


def web_address(text: str) -> httpx.URL | None:
    """Parse an http or https address with a host and without user information; None for any other text."""
    try:
        url = httpx.URL(text)
        url.host.encode("idna")  # as name resolution does
    except (httpx.InvalidURL, ValueError):
        return None
    return url if url.scheme in ("http", "https") and url.host and not url.userinfo else None


def is_loopback(url: httpx.URL) -> bool:
    """Return whether the host is a loopback name or address."""
    host = url.host.rstrip(".").lower()
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        try:
            address = ipaddress.ip_address(socket.inet_aton(host))  # other notations, such as 127.1 or 0x7f000001
        except OSError:
            return False
    address = getattr(address, "ipv4_mapped", None) or address
    return address.is_loopback or address.is_unspecified


def origin(url: httpx.URL) -> tuple[str, str, int | None]:
    """Return scheme, host and port, the scope of a key."""
    port = url.port if url.port is not None else {"http": 80, "https": 443}.get(url.scheme)
    return url.scheme, url.host.lower(), port


def retry_after(header: str) -> float | None:
    """Parse a `Retry-After` header into seconds; None if it is empty or invalid (RFC 9110, section 10.2.3)."""
    text = header.strip()
    if text.isascii() and text.isdecimal():
        return float(text)
    try:
        moment = parsedate_to_datetime(text)
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return max((moment - datetime.now(UTC)).total_seconds(), 0.0)
    except (ValueError, OverflowError):
        return None
