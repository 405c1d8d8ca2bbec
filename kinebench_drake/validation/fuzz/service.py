"""A web server whose answers are the files of a folder, sent as they are."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kinebench_drake.validation.fuzz.answers import HOST

_PATIENCE_S = 2.0


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """Serve within this context; yields the server's address.

    A question is answered by `LAST.http`, LAST being the last part of its path, or `root.http` of a bare address; what
    has no file by 404. Where an answer names `HOST`, the server's own address is put.
    """
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"http://127.0.0.1:{listener.getsockname()[1]}"
        thread = threading.Thread(target=_serve, args=(listener, folder, address), daemon=True)
        thread.start()
        try:
            yield address
        finally:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            thread.join(_PATIENCE_S)


def _serve(listener: socket.socket, folder: Path, address: str) -> None:
    while True:
        try:
            connection, _ = listener.accept()
        except OSError:
            return
        with connection, suppress(OSError, ValueError):
            connection.settimeout(_PATIENCE_S)
            connection.sendall(_answer(_question(connection), folder, address))
            connection.shutdown(socket.SHUT_WR)


def _question(connection: socket.socket) -> str:
    """The last part of the path that is asked for; what is sent along is read and thrown away."""
    data = b""
    while b"\r\n\r\n" not in data and (chunk := connection.recv(65536)):
        data += chunk
    head, _, body = data.partition(b"\r\n\r\n")
    told = [line for line in head.split(b"\r\n") if line.lower().startswith(b"content-length:")]
    left = int(told[0].partition(b":")[2]) - len(body) if told else 0
    while left > 0 and (chunk := connection.recv(65536)):
        left -= len(chunk)
    path = head.split(b" ")[1].decode(errors="replace").partition("?")[0]
    return path.rstrip("/").rpartition("/")[2] or "root"


def _answer(question: str, folder: Path, address: str) -> bytes:
    file = folder / f"{question}.http"
    if not file.is_file():
        return b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    head, mark, body = file.read_bytes().partition(b"\r\n\r\n")
    longer = body.replace(HOST.encode(), address.encode())
    head = head.replace(b"Content-Length: %d" % len(body), b"Content-Length: %d" % len(longer))
    return head + mark + longer
