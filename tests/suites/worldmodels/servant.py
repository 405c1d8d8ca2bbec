"""A web server in a thread that answers as it is told, and remembers what it was asked."""

import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


@dataclass(frozen=True)
class Asked:
    """One request."""

    method: str
    path: str
    headers: Mapping[str, str]
    body: Any


@dataclass
class Reply:
    """One answer: `body` as JSON if it is no bytes; `drip_s` between its bytes; `endless` is sent for ever instead."""

    body: Any = b""
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    drip_s: float = 0.0
    endless: bytes = b""

    def data(self) -> bytes:
        return self.body if isinstance(self.body, bytes) else json.dumps(self.body).encode()


class Servant:
    """Answers with `answer(asked)`; a list is answered one after the other, its last for ever."""

    def __init__(self) -> None:
        self.asked: list[Asked] = []
        self.routes: dict[str, list[Reply] | Callable[[Asked], Reply]] = {}
        self._stopping = threading.Event()
        servant = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                servant.serve(self)

            do_POST = do_GET

            def log_message(self, *args: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_port}"

    def at(self, path: str) -> list[Asked]:
        return [asked for asked in self.asked if asked.path.partition("?")[0] == path]

    def stop(self) -> None:
        self._stopping.set()
        self._server.shutdown()
        self._server.server_close()

    def serve(self, handler: BaseHTTPRequestHandler) -> None:
        length = int(handler.headers.get("Content-Length", 0))
        data = handler.rfile.read(length)
        asked = Asked(handler.command, handler.path, handler.headers, json.loads(data) if data else None)
        route = self.routes.get(asked.path.partition("?")[0], [Reply({"message": "no such page"}, status=404)])
        if callable(route):
            reply = route(asked)
        else:
            reply = route[min(len(self.at(asked.path.partition("?")[0])), len(route) - 1)]
        self.asked.append(asked)
        body = reply.data()
        try:
            while reply.endless and not self._stopping.wait(reply.drip_s):
                handler.wfile.write(reply.endless)
            handler.send_response(reply.status)
            for name, value in {"Content-Length": str(len(body)), **reply.headers}.items():
                handler.send_header(name, value)
            handler.end_headers()
            for start in range(0, len(body), 1 if reply.drip_s else len(body) or 1):
                if reply.drip_s and self._stopping.wait(reply.drip_s):
                    return
                handler.wfile.write(body[start : start + 1] if reply.drip_s else body)
        except OSError:
            pass  # the other side has hung up: that is what some tests are about
