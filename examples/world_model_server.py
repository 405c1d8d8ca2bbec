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
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake import write_video


class Handler(BaseHTTPRequestHandler):
    def imagine(self, first: NDArray[np.uint8], ask: dict[str, Any]) -> NDArray[np.uint8]:
        """Return the frames (T, H, W, 3) that follow the first frame (H, W, 3): put your model here."""
        return np.repeat(first[None], ask["num_frames"], axis=0)

    def do_GET(self) -> None:
        self.send_error(404)  # no /v1/capabilities: so the client knows that the contract is the simple one

    def do_POST(self) -> None:
        ask = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        png = base64.b64decode(ask["first_frame"].partition(",")[2])  # data:image/png;base64,...
        frames = self.imagine(np.asarray(Image.open(io.BytesIO(png)).convert("RGB")), ask)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "video.mp4"
            write_video(path, frames, ask.get("fps", 17))
            body = json.dumps({"video_base64": base64.b64encode(path.read_bytes()).decode()}).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


if __name__ == "__main__":
    with ThreadingHTTPServer(("127.0.0.1", int(sys.argv[1]) if sys.argv[1:] else 8000), Handler) as server:
        print(f"listening on http://127.0.0.1:{server.server_port}/generate", flush=True)
        server.serve_forever()
