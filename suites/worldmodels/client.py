"""HTTP as services of world models need it: patient, but not for ever, and close-mouthed about keys.

Repeated, with waits that double and vary: connections that fail, answers 429 (after the time they ask for) and 5xx.
Never repeated: any other answer; and what the service may have begun to work on, where that may cost: then only
connections that never stood and 429 are. A key goes to the service's own origin alone, over https or within this
machine.
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
from kinebench_drake.suites.worldmodels.service import (
    BusyError,
    Limits,
    ServiceError,
    is_loopback,
    origin,
    remark,
    retry_after,
    web_address,
)
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError

_Found = TypeVar("_Found")


class Deadline:
    """A moment after which nobody waits any more."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._end = time.monotonic() + limit_s

    def left(self) -> float:
        """Seconds that are left.

        Raises:
            WorldModelError: none is.
        """
        left = self._end - time.monotonic()
        if left <= 0:
            raise self.passed()
        return left

    def passed(self) -> WorldModelError:
        """The error that says so."""
        return WorldModelError(f"no video within {self._limit_s:g} s; the option timeout= allows more")

    def wait(self, seconds: float) -> None:
        """Wait.

        Raises:
            WorldModelError: so long may not be waited.
        """
        if seconds >= self.left():
            raise self.passed()
        time.sleep(seconds)

    def poll(self, ask: Callable[[], _Found | None], every_s: float) -> _Found:
        """Ask until there is an answer.

        Args:
            ask: returns what is wanted, or None while there is none.
            every_s: pause between two questions [s].

        Raises:
            WorldModelError: there was none in time, or `ask` said that there will be none.
        """
        while (found := ask()) is None:
            self.wait(every_s)
        return found


_REDIRECTS = 5
_FINAL = (HTTPStatus.NOT_IMPLEMENTED, HTTPStatus.HTTP_VERSION_NOT_SUPPORTED)
_UNSENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout, httpx.ProxyError)
"""Failures before the service has seen anything of a request."""
_Got = TypeVar("_Got")


class HttpClient:
    """Calls to one service.

    Args:
        service: its name in messages.
        base: its address; only this origin is shown the key.
        key: its key, if it wants one.
        limits: how long and how much.

    Raises:
        SetupError: the key would travel in the clear.
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
        """Ask the service something and return the JSON object it answers with.

        Args:
            method: GET or POST.
            path: what follows the base address; empty for the address itself.
            deadline: when to give up.
            body: sent as JSON.
            headers: further ones.
            most_bytes: largest answer, `json_bytes` if not given.
            patient: whether the answer may be as long in coming as the deadline allows.
            repeatable: whether a request that the service may have begun to work on can be sent again.
            check: looks at the answer; may raise `BusyError`.

        Raises:
            WorldModelError: there was no such answer.
            SetupError: the service does not accept the key.
        """
        url = httpx.URL(f"{str(self._base).rstrip('/')}{path}") if path else self._base
        most = most_bytes or self.limits.json_bytes
        content = json.dumps(body).encode() if body is not None else None
        kind = {"Content-Type": "application/json"} if body is not None else {}

        def attempt() -> dict[str, Any]:
            timeout = self._timeout(deadline, patient)
            sent = {"Accept": "application/json", **kind, **(headers or {}), **self._authorization(url)}
            with self._stream(method, url, deadline, repeatable, content=content, headers=sent, timeout=timeout) as got:
                self._accept(got, deadline, repeatable)
                data = b"".join(self._read(got, most, deadline))
            answer = self._object(data, got.status_code)
            check(answer)
            return answer

        return self._repeat(attempt, deadline)

    def download(self, address: str, part: Path, deadline: Deadline) -> None:
        """Fetch a file; redirects are followed, http and https only.

        Raises:
            WorldModelError: it did not come whole.
            SetupError: the disk failed.
        """

        def attempt() -> None:
            url = self._download_address(address)
            for _ in range(_REDIRECTS):
                headers = {"Accept-Encoding": "identity", **self._authorization(url)}
                timeout = self._timeout(deadline, False)
                with self._stream("GET", url, deadline, True, headers=headers, timeout=timeout) as got:
                    if not got.has_redirect_location:
                        self._accept(got, deadline, True)
                        with disk_errors(part.name), part.open("wb") as file:
                            for chunk in self._read(got, self.limits.video_bytes, deadline):
                                file.write(chunk)
                        return
                    url = self._download_address(str(url.join(got.headers["Location"])))
            raise ServiceError(f"{self.service}: the video's address redirects more than {_REDIRECTS} times")

        self._repeat(attempt, deadline)

    def close(self) -> None:
        """Close all connections."""
        for client in self._clients.values():
            client.close()
        self._clients.clear()

    def _repeat(self, attempt: Callable[[], _Got], deadline: Deadline) -> _Got:
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
        self, method: str, url: httpx.URL, deadline: Deadline, repeatable: bool, **request: Any
    ) -> Iterator[httpx.Response]:
        """Send a request; failures of the network come out as `BusyError` where trying again may help."""
        local = is_loopback(url)
        if local not in self._clients:
            # What the environment says of proxies is not for this machine's own services.
            self._clients[local] = httpx.Client(trust_env=not local, follow_redirects=False)
        try:
            with self._clients[local].stream(method, url, **request) as response:
                yield response
        except (httpx.TransportError, httpx.DecodingError) as error:
            deadline.left()  # a silence that outlasts the deadline is told as such
            again = isinstance(error, _UNSENT) or (repeatable and not isinstance(error, httpx.UnsupportedProtocol))
            kind = BusyError if again else ServiceError
            fate = "cannot be reached" if isinstance(error, _UNSENT) else "broke off"
            raise kind(f"{self.service} {fate} ({type(error).__name__})") from None

    def _accept(self, response: httpx.Response, deadline: Deadline, repeatable: bool) -> None:
        status = response.status_code
        if response.is_success:
            return
        if response.is_redirect:
            raise ServiceError(f"{self.service} redirects (HTTP {status}); give the address it leads to", status=status)
        said, code = self._complaint(response, deadline)
        message = f"{self.service} answered HTTP {status}" + (f": {said}" if said else "")
        # Any 5xx may come from a gateway behind which the request was taken all the same; 429 says that it was not.
        passing = status >= HTTPStatus.INTERNAL_SERVER_ERROR and status not in _FINAL
        if status == HTTPStatus.TOO_MANY_REQUESTS or (passing and repeatable):
            busy = BusyError(message, status=status, code=code)
            busy.after_s = retry_after(response.headers.get("Retry-After", ""))
            raise busy
        if status in (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN) and origin(response.url) == origin(self._base):
            raise SetupError(f"{message}; is the key right, and meant for this address?")
        raise ServiceError(message, status=status, code=code)

    def _complaint(self, response: httpx.Response, deadline: Deadline) -> tuple[str, str]:
        """What a service says of a request it refused, and its code for it."""
        try:
            answer = self._object(
                b"".join(self._read(response, self.limits.json_bytes, deadline)), response.status_code
            )
        except ServiceError:
            return remark(response.reason_phrase), ""
        inner = answer.get("error")
        told = inner if isinstance(inner, dict) else answer
        texts = (told.get("message"), answer.get("detail"), inner, response.reason_phrase)
        code = told.get("code")
        said = next(text for text in texts if isinstance(text, str))
        return remark(f"{code}: {said}" if isinstance(code, str) else said), code if isinstance(code, str) else ""

    def _read(self, response: httpx.Response, most_bytes: int, deadline: Deadline) -> Iterator[bytes]:
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
            raise ServiceError(f"{self.service} answered with more than {most_bytes / (1 << 20):g} MiB")

    def _object(self, data: bytes, status: int) -> dict[str, Any]:
        try:
            answer = json.loads(data)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            raise ServiceError(f"{self.service} answered with something else than a JSON object", status=status)
        return answer

    def _authorization(self, url: httpx.URL) -> dict[str, str]:
        if self._key is None or origin(url) != origin(self._base):
            return {}
        return {"Authorization": f"Bearer {self._key.get_secret_value()}"}

    def _download_address(self, address: str) -> httpx.URL:
        url = web_address(address)
        if url is None:
            raise ServiceError(f"{self.service} gave an address for the video that is not http or https")
        if is_loopback(url) and not self.is_local:
            raise ServiceError(f"{self.service} gave an address for the video that is on this machine")
        return url

    def _timeout(self, deadline: Deadline, patient: bool) -> httpx.Timeout:
        left = deadline.left()
        quiet = min(self.limits.silence_s, left)
        return httpx.Timeout(quiet, read=left if patient else quiet)
