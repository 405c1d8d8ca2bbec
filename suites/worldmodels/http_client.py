"""HTTP client with deadlines, retries and confined keys.

Requests run in a thread of their own, which the caller leaves at the deadline, however slowly a server sends.
Retried, with exponential backoff and jitter: failed connections, answers 429 (after the time they ask for) and 5xx.
Never retried: any other answer. Of requests that cost money only those are retried that the service cannot have
accepted: failed connects and 429. A key is sent to the service's origin only, over https or within this machine.
"""

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Callable, Collection, Coroutine, Mapping
from contextlib import asynccontextmanager
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
from kinebench_drake.io.files import Budget
from kinebench_drake.suites.worldmodels.remote import (
    BusyError,
    Limits,
    ServiceError,
    UnreachableError,
    clean,
    is_loopback,
    origin,
    parse_answer,
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
            raise self.missed
        return left

    @property
    def missed(self) -> WorldModelError:
        """Error of a video that does not come in time."""
        return WorldModelError(f"no video within {self._limit_s:g} s; the option timeout= allows more")

    def wait(self, seconds: float) -> None:
        """Sleep; raise `WorldModelError` at once if the deadline would pass before."""
        self.left(seconds)
        time.sleep(seconds)


_REDIRECTS = 5
_HEAD = 4096
_QUOTED = 80
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
        self._clients: dict[bool, httpx.AsyncClient] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
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
        files: Collection[str] = (),
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
            files: keys of the answer that hold files in base64, one or a list.
            patient: whether the service may be silent until the deadline.
            repeatable: whether a request that the service may have accepted can be sent again.
            check: validates the answer; may raise `BusyError` for another attempt.
        """
        url = httpx.URL(f"{str(self._base).rstrip('/')}{path}") if path else self._base
        content = None if body is None else json.dumps(body).encode()
        kind = {} if body is None else {"Content-Type": "application/json"}
        sent = {"Accept": "application/json", **kind, **(headers or {})}

        async def receive() -> tuple[bytearray, httpx.Response]:
            async with self._stream(method, url, deadline, sent, content, patient, repeatable) as response:
                await self._accept(response, repeatable)
                budget = Budget(self.limits.encoded_video_bytes, self.video_budget().exceeded)
                return await self._load(response, budget if files else self._json_budget()), response

        def attempt() -> dict[str, Any]:
            answer = self._object(*self._run(receive(), deadline), files)
            deadline.left()
            check(answer)
            return answer

        return self._repeat(attempt, deadline)

    def require_connection(self, limit_s: float) -> None:
        """Check that a server listens at the base address, whatever it answers within `limit_s` seconds.

        Raises:
            SetupError: none does.
        """

        async def knock() -> None:
            async with self._stream("GET", self._base, deadline):
                return

        deadline = Deadline(limit_s)
        try:
            self._run(knock(), deadline)
        except UnreachableError as error:
            raise SetupError(f"{error}: is the server running, and is this its address?") from None
        except WorldModelError:
            return  # it listens

    def download(self, address: str, part: Path, deadline: Deadline) -> None:
        """Download a file, following http and https redirects.

        Raises:
            WorldModelError: the download failed.
            SetupError: the disk failed.
        """

        async def receive() -> None:
            url = self._download_address(address)
            for _ in range(_REDIRECTS + 1):
                async with self._stream("GET", url, deadline) as response:
                    if not response.has_redirect_location:
                        await self._accept(response, True)
                        budget = self.video_budget()
                        with disk_errors(part.name), part.open("wb") as file:
                            async for chunk in self._read(response, budget):
                                file.write(chunk)
                        return
                    url = self._download_address(str(url.join(response.headers["Location"])))
            raise ServiceError(f"{self.service}: the video's address redirects more than {_REDIRECTS} times")

        self._repeat(lambda: self._run(receive(), deadline), deadline)

    def video_budget(self) -> Budget:
        """Return the bytes that a video may take."""
        most = self.limits.video_bytes
        return Budget(most, ServiceError(f"{self.service} answered with more than {most / 2**20:g} MiB of video"))

    def _json_budget(self) -> Budget:
        """Return the bytes that a JSON answer may take apart from files."""
        most = self.limits.json_bytes
        return Budget(most, ServiceError(f"{self.service} answered with more than {most / 2**20:g} MiB of JSON"))

    def close(self) -> None:
        """Close all connections."""

        async def close_all() -> None:
            for client in self._clients.values():
                await client.aclose()
            self._clients.clear()

        if self._loop is not None:
            asyncio.run_coroutine_threadsafe(close_all(), self._loop).result(self.limits.silence_s)
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._loop = None

    def _run(self, request: Coroutine[Any, Any, _T], deadline: Deadline) -> _T:
        """Return the result of a request that runs in the client's thread."""
        if self._loop is None:
            self._loop = asyncio.new_event_loop()
            threading.Thread(target=self._loop.run_forever, daemon=True).start()
        running = asyncio.run_coroutine_threadsafe(request, self._loop)
        try:
            return running.result(deadline.left())
        except TimeoutError:
            raise deadline.missed from None
        finally:
            running.cancel()

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

    @asynccontextmanager
    async def _stream(
        self,
        method: str,
        url: httpx.URL,
        deadline: Deadline,
        headers: Mapping[str, str] | None = None,
        content: bytes | None = None,
        patient: bool = False,
        repeatable: bool = True,
    ) -> AsyncIterator[httpx.Response]:
        """Send a request; network failures become `BusyError` where a retry may help."""
        local = is_loopback(url)
        if local not in self._clients:
            # Proxies of the environment do not apply to services on this machine.
            self._clients[local] = httpx.AsyncClient(trust_env=not local, follow_redirects=False)
        sent = {"Accept-Encoding": "identity", **(headers or {})}
        if self._key is not None and origin(url) == origin(self._base):
            sent["Authorization"] = f"Bearer {self._key.get_secret_value()}"
        left = deadline.left()
        quiet = min(self.limits.silence_s, left)
        timeout = httpx.Timeout(quiet, read=left if patient else quiet)
        try:
            request = self._clients[local].stream(method, url, headers=sent, content=content, timeout=timeout)
            async with request as response:
                yield response
        except (httpx.TransportError, httpx.DecodingError) as error:
            deadline.left()  # raises if the deadline has passed meanwhile
            unsent = isinstance(error, _UNSENT)
            retry = unsent or (repeatable and not isinstance(error, httpx.UnsupportedProtocol))
            problem = "cannot be reached" if unsent else "broke off"
            message = f"{self.service} {problem} ({type(error).__name__})"
            raise (UnreachableError if unsent else BusyError if retry else ServiceError)(message) from None

    async def _accept(self, response: httpx.Response, repeatable: bool) -> None:
        """Raise the error of an answer that is no success."""
        status = response.status_code
        if response.is_success:
            return
        if response.is_redirect:
            raise ServiceError(f"{self.service} redirects (HTTP {status}); give the address it leads to", status=status)
        reason, code = await self._error_of(response)
        message = f"{self.service} answered HTTP {status}" + (f": {reason}" if reason else "")
        # A 5xx may come from a gateway behind which the request was accepted; 429 means that it was not.
        transient = status >= HTTPStatus.INTERNAL_SERVER_ERROR and status not in _FINAL
        if status == HTTPStatus.TOO_MANY_REQUESTS or (transient and repeatable):
            raise BusyError(
                message, status=status, code=code, after_s=retry_after(response.headers.get("Retry-After", ""))
            )
        if status in (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN) and origin(response.url) == origin(self._base):
            missing = "no key was sent; name one with key_env=VARIABLE"
            raise SetupError(f"{message}; {'is the key right, and meant for this address?' if self._key else missing}")
        raise ServiceError(message, status=status, code=code)

    async def _error_of(self, response: httpx.Response) -> tuple[str, str]:
        """Return message and error code of an answer that reports an error."""
        try:
            answer = self._object(await self._load(response, self._json_budget()), response)
        except ServiceError:
            return clean(response.reason_phrase), ""
        error = answer.get("error")
        details = error if isinstance(error, dict) else answer
        texts = (details.get("message"), answer.get("detail"), error, response.reason_phrase)
        text = next(text for text in texts if isinstance(text, str))
        code = details.get("code")
        return (clean(f"{code}: {text}"), code) if isinstance(code, str) else (clean(text), "")

    async def _read(self, response: httpx.Response, budget: Budget) -> AsyncIterator[bytes]:
        if (coding := response.headers.get("Content-Encoding", "identity")) != "identity":
            # Unpacked, a small answer may be large: its size would be known too late to keep limits and deadline.
            raise ServiceError(f"{self.service} answered with Content-Encoding {clean(coding)}; send it uncompressed")
        if (length := response.headers.get("Content-Length", "")).isdecimal():
            budget.require(int(length[:18]))  # of a length; longer ones are too large in any case
        async for chunk in response.aiter_bytes():
            budget.take(len(chunk))
            yield chunk

    async def _load(self, response: httpx.Response, budget: Budget) -> bytearray:
        data = bytearray()
        async for chunk in self._read(response, budget):
            data += chunk
        return data

    def _object(self, data: bytearray, response: httpx.Response, files: Collection[str] = ()) -> dict[str, Any]:
        try:
            answer = parse_answer(data, files, self._json_budget())
        except ValueError:
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
