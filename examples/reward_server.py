"""Rewards over HTTP for a training loop elsewhere, with the standard library.

    python examples/reward_server.py [PORT]        # 0: any free port

POST an npz file with `frames` (T, H, W, 3) uint8 RGB and `period_s`; where the camera is known, also `K` (3, 3) and
`base_from_camera` (4, 4). The answer is JSON: reward, executable, feasible, reasons, numbers. Trusted machines only.
"""

import io
import json
import sys
import zipfile
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np

from kinebench_drake import Camera, KinebenchError, Scorer

MOST_BYTES = 1 << 30


class Handler(BaseHTTPRequestHandler):
    scorer = Scorer()

    def do_POST(self) -> None:
        try:
            size = int(self.headers.get("Content-Length", 0))
            if size > MOST_BYTES:
                raise ValueError(f"{size} bytes, at most {MOST_BYTES} are read")
            body = io.BytesIO(self.rfile.read(size))
            if not zipfile.is_zipfile(body):
                raise ValueError(f"{size} bytes that are no whole npz file")
            body.seek(0)
            with np.load(body, allow_pickle=False) as ask:
                frames = ask["frames"]
                camera = None
                if "K" in ask:
                    K = ask["K"]
                    (height, width) = frames.shape[1:3]
                    focal = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
                    camera = Camera(width=width, height=height, X_BC=ask["base_from_camera"], **focal)
                answer = asdict(self.scorer(frames, camera=camera, period_s=float(ask["period_s"])))
            self.reply(200, answer)
        except (KinebenchError, ValueError, KeyError, OSError) as error:
            self.reply(400, {"error": str(error)})

    def reply(self, status: int, answer: dict[str, object]) -> None:
        body = json.dumps(answer).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


if __name__ == "__main__":
    with HTTPServer(("127.0.0.1", int(sys.argv[1]) if sys.argv[1:] else 8001), Handler) as server:
        print(f"listening on http://127.0.0.1:{server.server_port}", flush=True)
        server.serve_forever()
