"""Hostile inputs, each read by a process of its own under a limit of memory: outcome, time and peak memory.

As a script (`python benchmarks/hostile.py`) it measures whatever `kinebench_drake` is on the path, also an older one.
"""

import base64
import io
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

LIMIT_BYTES = 8 * 2**30
LIMIT_S = 120.0
"""Address space and time that each process gets."""
TIMEOUT_S = 6.0
"""Time-out of a request to a world model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostileResult:
    """What came of one input."""

    name: str
    outcome: str
    """Last line of the process, or how it was ended."""
    wall_s: float
    """Time of the reading alone [s]; that of the process where it was ended."""
    peak_gib: float
    """Largest resident memory of the process, libraries included [GiB]; where it was ended, or that of this."""


def _hdf5(path: Path, shape: tuple[int, ...], chunks: tuple[int, ...]) -> None:
    import h5py
    import numpy as np

    with h5py.File(path, "w") as file:
        data = file.create_dataset("images", shape, "u1", chunks=chunks, compression="gzip")
        data[0, : chunks[1]] = np.frombuffer(b"\x89PNG".ljust(chunks[1], b"\0"), np.uint8)


def _npz(path: Path, shape: tuple[int, ...]) -> None:
    import numpy as np

    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": shape})
    left = int(np.prod(shape))
    block = bytes(1 << 24)
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
        archive.open("frames.npy", "w", force_zip64=True) as file,
    ):
        file.write(head.getvalue())
        while left > 0:
            file.write(block[:left])
            left -= len(block)


def _mp4(path: Path, width: int, height: int, count: int) -> None:
    import av

    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=5, options={"preset": "ultrafast"})
        stream.width = width
        stream.height = height
        stream.pix_fmt = "yuv420p"
        frame = av.VideoFrame(width, height, "yuv420p")
        for plane in frame.planes:
            plane.update(bytes(plane.buffer_size))
        for k in range(count):
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _pngs(path: Path, side: int, count: int) -> None:
    from PIL import Image

    path.mkdir()
    for k in range(count):
        Image.new("RGB", (side, side)).save(path / f"{k}.png")


def _lerobot(path: Path, rows: int) -> None:
    import numpy as np
    import pyarrow
    from pyarrow import parquet

    (path / "meta").mkdir(parents=True)
    (path / "data" / "chunk-000").mkdir(parents=True)
    feature = {"dtype": "float32", "shape": [7], "names": [f"joint_{k}" for k in range(7)]}
    info = {"codebase_version": "v2.1", "fps": 10, "features": {"observation.state": feature}}
    (path / "meta" / "info.json").write_text(json.dumps(info))
    (path / "meta" / "episodes.jsonl").write_text('{"episode_index": 0}\n')
    state = pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(np.zeros(7 * rows, np.float32)), 7)
    table = pyarrow.table({"observation.state": state, "episode_index": np.zeros(rows, np.int64)})
    parquet.write_table(table, path / "data" / "chunk-000" / "episode_000000.parquet", row_group_size=rows)


def _text(path: Path, text: str, times: int, tail: str = "") -> None:
    path.write_text(text * times + tail)


FILES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "HDF5, a row of 12 GB": ("row.h5", partial(_hdf5, shape=(2, 12 * 10**9), chunks=(1, 1 << 20))),
    "HDF5, a chunk of 3.7 GiB": ("chunk.h5", partial(_hdf5, shape=(1, 4 * 10**9), chunks=(1, 4 * 10**9 - 9))),
    "npz, 7 GiB of zeros": ("zeros.npz", partial(_npz, shape=(7000, 600, 600, 3))),
    "mp4 of 8192 x 8192 px": ("large.mp4", partial(_mp4, width=8192, height=8192, count=3)),
    "mp4, 1,000 frames of 1080p": ("long.mp4", partial(_mp4, width=1920, height=1080, count=1000)),
    "mp4, 100,000 frames": ("many.mp4", partial(_mp4, width=64, height=64, count=100_000)),
    "folder of png of 9000 x 9000 px": ("pngs", partial(_pngs, side=9000, count=3)),
    "csv, a million commas": ("commas.csv", partial(_text, text=",", times=10**6, tail="\n")),
    "csv, 200 MB in one line": ("line.csv", partial(_text, text="0,", times=10**8, tail="\n0\n")),
    "LeRobot, 60 million rows": ("lerobot", partial(_lerobot, rows=6 * 10**7)),
    "manifest, 200 MB of line feeds": ("manifest.jsonl", partial(_text, text="\n", times=2 * 10**8)),
}
"""File and its maker by the name of the input."""


def _json(value: object) -> bytes:
    body = value if isinstance(value, bytes) else json.dumps(value).encode()
    return b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n" % len(body) + body


_CAPABILITIES = {
    "status": "ready",
    "api_version": "1.0",
    "model_version": "x",
    "profiles": [
        {
            "profile_id": "x",
            "image": {"height": 384, "width": 384},
            **{key: {"min": 1, "max": 48} for key in ("context_frames", "prediction_frames")},
            "action": {"dimension": 8},
        }
    ],
}
_REQUEST_ID = b"0" * 36
"""Place of the request's id in an answer."""


def _pictures(side: int, count: int) -> bytes:
    from PIL import Image

    Image.new("RGB", (side, side)).save(buffer := io.BytesIO(), "png")
    frames = [{"data": base64.b64encode(buffer.getvalue()).decode()}] * count
    predictions = [{"sample_id": "sample-0", "frames": frames}]
    return _json({"request_id": _REQUEST_ID.decode(), "model_version": "x", "predictions": predictions})


def _drip(data: bytes, wait_s: float) -> Iterator[bytes]:
    for byte in data:
        time.sleep(wait_s)
        yield bytes([byte])


def _endless(data: bytes, wait_s: float = 0.0) -> Iterator[bytes]:
    while True:
        time.sleep(wait_s)
        yield data


def _sparse_file() -> bytes:
    path = Path(tempfile.gettempdir()) / f"hostile-{os.getuid()}.mp4"
    with path.open("wb") as file:
        file.truncate(3 * 2**30)
    return _json({"video_path": str(path)})


ANSWERS: dict[str, Callable[[], Iterator[bytes]]] = {
    "header bytes every 0.5 s": lambda: _drip(_json({"video_base64": "AAAA"}), 0.5),
    "endless 100 Continue": lambda: _endless(b"HTTP/1.1 100 Continue\r\n\r\n", 0.001),
    "endless body": lambda: iter(
        [b"HTTP/1.1 200 OK\r\nContent-Length: 999999999999\r\n\r\n", *([bytes(1 << 20)] * 10**5)]
    ),
    "JSON of 60 million objects": lambda: iter([_json(b'{"video_base64":"x","p":[' + b"{}," * (60 << 20) + b"0]}")]),
    "JSON of 170 million escapes": lambda: iter([_json(b'{"video_base64":"' + b'\\"' * (170 << 20) + b'"}')]),
    "400 pictures of 4096 x 4096 px": lambda: iter([_pictures(4096, 400)]),
    "20,000 pictures for 48": lambda: iter([_pictures(64, 20_000)]),
    "48 pictures of 4096 x 4096 px": lambda: iter([_pictures(4096, 48)]),
    "video_path of 3 GiB": lambda: iter([_sparse_file()]),
    "video_path of 300 characters": lambda: iter([_json({"video_path": "/" + "a" * 300})]),
    "Retry-After beyond all dates": lambda: iter(
        [b"HTTP/1.1 429 Busy\r\nRetry-After: 1 Jan 99999999999999999999 0:0:0 GMT\r\nContent-Length: 0\r\n\r\n"]
    ),
}
"""Answers of a world model to a POST, by name."""


@contextmanager
def _serve(answer: Callable[[], Iterator[bytes]]) -> Iterator[str]:
    """Serve the contracts of world models on this machine; yields the address."""
    prepared = [answer()]

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.wfile.write(_json(_CAPABILITIES))

        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            try:
                for part in prepared.pop() if prepared else answer():
                    self.wfile.write(part.replace(_REQUEST_ID, body.get("request_id", "").encode() or _REQUEST_ID))
            except OSError:
                return  # the client has gone

        def log_message(self, *_: object) -> None:
            return

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()


def _read(kind: str, source: str) -> str:
    """Read one input and return what came of it, a line."""
    from kinebench_drake.errors import KinebenchError

    try:
        if kind in ANSWERS:
            return _request(source, "predict" if "pictures" in kind else "simple")
        path = Path(source)
        if path.suffix == ".csv" or path.name == "lerobot":
            from kinebench_drake.runs.audit import AuditConfig, audit_trajectories

            config = AuditConfig(source=path, out=path.parent / "out", overwrite=True, replays=None)
            return str(audit_trajectories(config).rows[0].reason)
        if path.suffix == ".jsonl":
            from kinebench_drake.formats.videos.find import find_samples

            return f"{len(find_samples(path).samples)} samples"
        from kinebench_drake.io.reader import read_video

        return f"read, {read_video(path).frames.shape}"
    except KinebenchError as error:
        return str(error)
    except BaseException as error:
        return f"UNEXPECTED {type(error).__name__}: {str(error)[:80]}"


def _request(address: str, style: str) -> str:
    import numpy as np

    from kinebench_drake.suites.worldmodels.factory import create
    from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request

    model = create(f"{address}?timeout={TIMEOUT_S:g}&style={style}")
    still = {"t_s": (49,), "X_BG": (49, 4, 4), "finger_width_m": (49,), "q": (49, 7)}
    request: dict[str, Any] = {
        "actions": ActionTrack(**{name: np.zeros(shape) for name, shape in still.items()}),
        **dict.fromkeys(("episode", "task", "prompt", "negative_prompt"), "x"),
        **{"round": 0, "seed": 1, "num_frames": 49, "fps": 17.0, "first_frame": np.zeros((384, 384, 3), np.uint8)},
    }
    with tempfile.TemporaryDirectory() as folder:
        return f"video of {model.generate(Request(**request), Path(folder) / 'x').stat().st_size} bytes"


def _measure(name: str, source: str) -> HostileResult:
    """Read one input in a process of its own."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))

    start = time.monotonic()
    child = subprocess.Popen(
        [sys.executable, __file__, name, source], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, preexec_fn=limit
    )
    timer = threading.Timer(LIMIT_S, child.kill)
    timer.start()
    output = child.stdout.read().decode(errors="replace") if child.stdout else ""
    _, status, usage = os.wait4(child.pid, 0)
    timer.cancel()
    ended = f"{time.monotonic() - start} {usage.ru_maxrss} ENDED by status {os.waitstatus_to_exitcode(status)}"
    wall_s, peak_kib, outcome = (output.strip() or ended).split(" ", 2)
    return HostileResult(name=name, outcome=outcome, wall_s=float(wall_s), peak_gib=int(peak_kib) / 2**20)


def measure(report: Callable[[HostileResult], None]) -> list[HostileResult]:
    """Make and read every input, and report each result at once."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (file, make) in FILES.items():
            make(Path(folder) / file)
            results.append(_measure(name, str(Path(folder) / file)))
            report(results[-1])
    for name, answer in ANSWERS.items():
        with _serve(answer) as address:
            results.append(_measure(name, address))
            report(results[-1])
    return results


def table_line(result: HostileResult) -> str:
    """Return the result as a line of a Markdown table."""
    return f"| {result.name} | {result.outcome[:110]} | {result.wall_s:.1f} | {result.peak_gib:.2f} |"


if __name__ == "__main__":
    if len(sys.argv) == 3:
        import kinebench_drake.io.reader
        import kinebench_drake.kinematics.plant
        import kinebench_drake.suites.worldmodels.factory  # noqa: F401 - loaded before the time is taken

        begin = time.monotonic()
        text = _read(*sys.argv[1:])
        wall_s = time.monotonic() - begin
        status = Path("/proc/self/status").read_text()  # its own peak, not that of the process that started it
        print(f"{wall_s:.2f} {status.split('VmHWM:')[1].split()[0]} {text}", flush=True)
        os._exit(0)
    measure(lambda result: print(table_line(result), flush=True))
