"""HTTP client with deadlines, retries and confined keys.

Retried, with exponential backoff and jitter: failed connections, answers 429 (after the time they ask for) and 5xx.
Never retried: any other answer. Of requests that cost money only those are retried that the service cannot have
accepted: failed connects and 429. A key is sent to the service's origin only, over https or within this machine.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any, TypeVar

import httpx
from pydantic import SecretStr
from tenacity import (
    RetryCallState,
    Retrying,
    retry_if_exception_type,
    stop_after_attempt,
    wait_exponential,
    wait_random,
)

from kinebench_drake.errors import SetupError
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.suites.worldmodels.remote import (
    BusyError,
    Limits,
    ServiceError,
    clean,
    is_loopback,
    origin,
    retry_after,
    web_address,
)
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError

_T = TypeVar("_T")


class Deadline:
    """Time limit of one video."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._end = time.monotonic() + limit_s

    def left(self, need_s: float = 0.0) -> float:
        """Return the remaining seconds.

        Raises:
            WorldModelError: they are no more than `need_s`.
        """
        left = self._end - time.monotonic()
        if left <= need_s:
            raise WorldModelError(f"no video within {self._limit_s:g} s; the option timeout= allows more")
        return left

    def wait(self, seconds: float) -> None:
        """Sleep; raise `WorldModelError` at once if the deadline would pass before."""
        self.left(seconds)
        time.sleep(seconds)


_REDIRECTS = 5
_HEAD, _QUOTED = 4096, 80
"""Bytes of an invalid answer that are read for a message, and characters that it quotes."""
_FINAL = (HTTPStatus.NOT_IMPLEMENTED, HTTPStatus.HTTP_VERSION_NOT_SUPPORTED)
_UNSENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout, httpx.ProxyError)
"""Failures before a request was sent."""


class HttpClient:
    """Client of one service.

    Args:
        service: name in messages.
        base: base address; the key is sent to its origin only.
        key: bearer token, if the service requires one.
        limits: limits of time and size.

    Raises:
        SetupError: the key would be sent unencrypted.
    """

    def __init__(self, service: str, base: str, *, key: SecretStr | None = None, limits: Limits | None = None) -> None:
        self.service = service
        self.limits = limits or Limits()
        self._base = httpx.URL(base)
        self._key = key
        self._clients: dict[bool, httpx.Client] = {}
        self.is_local = is_loopback(self._base)
        if key is not None and self._base.scheme != "https" and not self.is_local:
            raise SetupError(f"{service}: a key goes only over https or to this machine; use an https address")

    def call(
        self,
        method: str,
        path: str,
        deadline: Deadline,
        *,
        body: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        most_bytes: int | None = None,
        patient: bool = False,
        repeatable: bool = True,
        check: Callable[[dict[str, Any]], None] = lambda answer: None,
    ) -> dict[str, Any]:
        """Send a request and return the JSON object of the answer.

        Args:
            method: GET or POST.
            path: path below the base address; empty for the address itself.
            deadline: time limit.
            body: body, sent as JSON.
            headers: additional headers.
            most_bytes: largest answer; None: `json_bytes`.
            patient: whether the service may be silent until the deadline.
            repeatable: whether a request that the service may have accepted can be sent again.
            check: validates the answer; may raise `BusyError` for another attempt.

        Raises:
            WorldModelError: there was no valid answer.
            SetupError: the service rejected the key.
        """
        url = httpx.URL(f"{str(self._base).rstrip('/')}{path}") if path else self._base
        content = None if body is None else json.dumps(body).encode()
        kind = {} if body is None else {"Content-Type": "application/json"}
        sent = {"Accept": "application/json", **kind, **(headers or {})}

        def attempt() -> dict[str, Any]:
            with self._stream(method, url, deadline, sent, content, patient, repeatable) as response:
                self._accept(response, deadline, repeatable)
                data = b"".join(self._read(response, most_bytes or self.limits.json_bytes, deadline))
            answer = self._object(data, response)
            deadline.left()
            check(answer)
            return answer

        return self._repeat(attempt, deadline)

    def download(self, address: str, part: Path, deadline: Deadline) -> None:
        """Download a file, following http and https redirects.

        Raises:
            WorldModelError: the download failed.
            SetupError: the disk failed.
        """

        def attempt() -> None:
            url = self._download_address(address)
            for _ in range(_REDIRECTS + 1):
                with self._stream("GET", url, deadline) as response:
                    if not response.has_redirect_location:
                        self._accept(response, deadline, True)
                        with disk_errors(part.name), part.open("wb") as file:
                            for chunk in self._read(response, self.limits.video_bytes, deadline):
                                file.write(chunk)
                        return
                    url = self._download_address(str(url.join(response.headers["Location"])))
            raise ServiceError(f"{self.service}: the video's address redirects more than {_REDIRECTS} times")

        self._repeat(attempt, deadline)

    def close(self) -> None:
        """Close all connections."""
        for client in self._clients.values():
            client.close()
        self._clients.clear()

    def _repeat(self, attempt: Callable[[], _T], deadline: Deadline) -> _T:
        limits = self.limits
        backoff = wait_exponential(limits.first_wait_s, limits.longest_wait_s) + wait_random(0, limits.first_wait_s)
        enough = stop_after_attempt(limits.attempts)

        def wait(state: RetryCallState) -> float:
            failure = state.outcome.exception() if state.outcome else None
            asked = failure.after_s if isinstance(failure, BusyError) else None
            return max(backoff(state), asked or 0.0)

        return Retrying(
            retry=retry_if_exception_type(BusyError),
            wait=wait,
            stop=lambda state: enough(state) or state.upcoming_sleep >= deadline.left(),
            sleep=deadline.wait,
            reraise=True,
        )(attempt)

    @contextmanager
    def _stream(
        self,
        method: str,
        url: httpx.URL,
        deadline: Deadline,
        headers: Mapping[str, str] | None = None,
        content: bytes | None = None,
        patient: bool = False,
        repeatable: bool = True,
    ) -> Iterator[httpx.Response]:
        """Send a request; network failures become `BusyError` where a retry may help."""
        local = is_loopback(url)
        if local not in self._clients:
            # Proxies of the environment do not apply to services on this machine.
            self._clients[local] = httpx.Client(trust_env=not local, follow_redirects=False)
        sent = {"Accept-Encoding": "identity", **(headers or {})}
        if self._key is not None and origin(url) == origin(self._base):
            sent["Authorization"] = f"Bearer {self._key.get_secret_value()}"
        left = deadline.left()
        quiet = min(self.limits.silence_s, left)
        timeout = httpx.Timeout(quiet, read=left if patient else quiet)
        try:
            with self._clients[local].stream(method, url, headers=sent, content=content, timeout=timeout) as response:
                yield response
        except (httpx.TransportError, httpx.DecodingError) as error:
            deadline.left()  # raises if the deadline has passed meanwhile
            unsent = isinstance(error, _UNSENT)
            retry = unsent or (repeatable and not isinstance(error, httpx.UnsupportedProtocol))
            problem = "cannot be reached" if unsent else "broke off"
            message = f"{self.service} {problem} ({type(error).__name__})"
            raise (BusyError if retry else ServiceError)(message) from None

    def _accept(self, response: httpx.Response, deadline: Deadline, repeatable: bool) -> None:
        """Raise the error of an answer that is no success."""
        status = response.status_code
        if response.is_success:
            return
        if response.is_redirect:
            raise ServiceError(f"{self.service} redirects (HTTP {status}); give the address it leads to", status=status)
        reason, code = self._error_of(response, deadline)
        message = f"{self.service} answered HTTP {status}" + (f": {reason}" if reason else "")
        # A 5xx may come from a gateway behind which the request was accepted; 429 means that it was not.
        transient = status >= HTTPStatus.INTERNAL_SERVER_ERROR and status not in _FINAL
        if status == HTTPStatus.TOO_MANY_REQUESTS or (transient and repeatable):
            after_s = retry_after(response.headers.get("Retry-After", ""))
            raise BusyError(message, status=status, code=code, after_s=after_s)
        if status in (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN) and origin(response.url) == origin(self._base):
            missing = "no key was sent; name one with key_env=VARIABLE"
            raise SetupError(f"{message}; {'is the key right, and meant for this address?' if self._key else missing}")
        raise ServiceError(message, status=status, code=code)

    def _error_of(self, response: httpx.Response, deadline: Deadline) -> tuple[str, str]:
        """Return message and error code of an answer that reports an error."""
        try:
            answer = self._object(b"".join(self._read(response, self.limits.json_bytes, deadline)), response)
        except ServiceError:
            return clean(response.reason_phrase), ""
        error = answer.get("error")
        details = error if isinstance(error, dict) else answer
        texts = (details.get("message"), answer.get("detail"), error, response.reason_phrase)
        text = next(text for text in texts if isinstance(text, str))
        code = details.get("code")
        return (clean(f"{code}: {text}"), code) if isinstance(code, str) else (clean(text), "")

    def _read(self, response: httpx.Response, most_bytes: int, deadline: Deadline) -> Iterator[bytes]:
        if (coding := response.headers.get("Content-Encoding", "identity")) != "identity":
            # Unpacked, a small answer may be large: its size would be known too late to keep limits and deadline.
            raise ServiceError(f"{self.service} answered with Content-Encoding {clean(coding)}; send it uncompressed")
        size = int(length) if (length := response.headers.get("Content-Length", "")).isdecimal() else 0
        if size <= most_bytes:
            size = 0
            for chunk in response.iter_bytes():
                deadline.left()
                size += len(chunk)
                if size > most_bytes:
                    break
                yield chunk
        if size > most_bytes:
            encoded = most_bytes == self.limits.encoded_video_bytes
            most = f"{(self.limits.video_bytes if encoded else most_bytes) / (1 << 20):g} MiB"
            raise ServiceError(
                f"{self.service} answered with more than {most}{' of video (base64)' if encoded else ''}"
            )

    def _object(self, data: bytes, response: httpx.Response) -> dict[str, Any]:
        try:
            answer = json.loads(data)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            kind = response.headers.get("Content-Type") or "no content type"
            text = clean(data[:_HEAD].decode(errors="replace"))[:_QUOTED]  # secrets are masked before the cut
            raise ServiceError(
                f"{self.service} answered with {clean(kind)}, expected a JSON object; it begins: {text!r}",
                status=response.status_code,
            )
        return answer

    def _download_address(self, address: str) -> httpx.URL:
        url = web_address(address)
        if url is None:
            raise ServiceError(f"{self.service} gave an address for the video that is not http or https")
        if is_loopback(url) and not self.is_local:
            raise ServiceError(f"{self.service} gave an address for the video that is on this machine")
        return url
