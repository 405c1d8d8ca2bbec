"""Answers of web services made wrong: in their JSON, their headers, or in what goes over the wire."""

from numpy.random import Generator

from kinebench_drake.validation.fuzz.octets import mutate_bytes
from kinebench_drake.validation.fuzz.values import mutate_json

_STATUS = (b"200 OK", b"204 No Content", b"302 Found", b"400 Bad Request", b"401 No", b"404 Not Found", b"429 Busy")
_FURTHER_STATUS = (b"500 Oops", b"503 Later", b"999 What", b"200", b"100 Continue", b"304 Not Modified", b"\xff\xff")
_HEADERS = (
    *(b"Location: /clip", b"Location: file:///etc/passwd", b"Location: http://[::1", b"Location: \xff\xfe"),
    *(b"Retry-After: 0", b"Retry-After: -1", b"Retry-After: Wed, 99 Foo", b"Retry-After: 1e9", b"Retry-After: \xb2"),
    *(
        b"Content-Encoding: gzip",
        b"Content-Encoding: br, deflate",
        b"Transfer-Encoding: chunked",
        b"Content-Length: -1",
    ),
    *(b"Content-Length: 99999999999999", b"Content-Length: x", b"Content-Type: text/html; charset=utf-7"),
    *(b"no colon", b": empty", b"X: " + b"y" * 70_000, b"Set-Cookie: a=\x1b[2J", b"Content-Length: \xb2"),
)


def reply(body: bytes, kind: str = "application/json") -> bytes:
    """An answer as it goes over the wire."""
    return head(b"200 OK", [f"Content-Type: {kind}".encode(), b"Content-Length: %d" % len(body)]) + body


def head(status: bytes, headers: list[bytes]) -> bytes:
    """The lines before an answer's body."""
    return b"\r\n".join([b"HTTP/1.1 " + status, *headers, b"Connection: close", b"", b""])


def mutate_reply(rng: Generator, data: bytes) -> bytes:
    """An answer after a change to its body, its head or its bytes."""
    if rng.random() < 0.15:
        return mutate_bytes(rng, data)
    kind, body = data.partition(b"\r\n\r\n")[::2]
    status, headers = b"200 OK", [b"Content-Type: application/json"]
    if rng.random() < 0.85:
        body = mutate_json(rng, body) if b"json" in kind else mutate_bytes(rng, body)
    if rng.random() < 0.25:
        every = _STATUS + _FURTHER_STATUS
        status = every[int(rng.integers(len(every)))]
    if rng.random() < 0.2:
        headers.append(_HEADERS[int(rng.integers(len(_HEADERS)))])
    if rng.random() < 0.95:
        headers.append(b"Content-Length: %d" % len(body))
    return head(status, headers) + body
