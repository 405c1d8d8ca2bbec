r"""A world model behind HTTP, with the standard library only: the contract "simple" of docs/worldmodels.md.

    python examples/world_model_server.py [PORT]        # 0: any free port

This placeholder answers with the first frame, repeated. Use it with

    kinebench-drake suite run --suite 0 --tasks PullCube-v1 --episodes 1 --out served \
        --world-model http://127.0.0.1:8000/generate
"""

import base64
import io
import json
import sys
import tempfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from kinebench_drake.io.container import write_video


def imagine(ask: dict[str, Any]) -> bytes:
    """The mp4 that answers a request: put your model here."""
    png = base64.b64decode(ask["first_frame"].partition(",")[2])  # data:image/png;base64,...
    first = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        write_video(path, np.repeat(first[None], ask["num_frames"], axis=0), ask["fps"])
        return path.read_bytes()


class Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_error(404)  # no /v1/capabilities: so the client knows that the contract is the simple one

    def do_POST(self) -> None:
        ask = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        body = json.dumps({"video_base64": base64.b64encode(imagine(ask)).decode()}).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


if __name__ == "__main__":
    with ThreadingHTTPServer(("127.0.0.1", int(sys.argv[1]) if sys.argv[1:] else 8000), Handler) as server:
        print(f"listening on http://127.0.0.1:{server.server_port}/generate", flush=True)
        server.serve_forever()
