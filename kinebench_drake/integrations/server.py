"""Rewards over HTTP: clips are queued, scored by worker processes, and their scores asked for by id.

POST /score                 body: npz or npy of frames, or a video file; ?period_s=0.2 &camera=NAME &wait=SECONDS
GET  /jobs/ID               the score of a clip, once it is there
POST /api/reward/enqueue    batches of cosmos-rl: a line of JSON, then an npy file of clips (B, 3, T, H, W)
POST /api/reward/pull       their scores
GET  /health, /metrics      state, and numbers in the text form of Prometheus
"""

import hmac
import io
import json
import uuid
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import parse_qs

import numpy as np
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from kinebench_drake.api.scorer import Score, Scorer
from kinebench_drake.errors import InputError, KinebenchError, one_line
from kinebench_drake.executors.queue import JobQueue
from kinebench_drake.integrations.rewards import cosmos_result, to_frames
from kinebench_drake.io.npz import open_npz
from kinebench_drake.io.reader import read_video

MOST_TICKETS = 4096
"""Requests whose scores can be asked for; the oldest are forgotten, so that memory stays bounded."""
_SUFFIXES = {b"PK\x03\x04": ".npz", b"\x93NUM": ".npy"}
"""Name endings of files by their first bytes; others are videos."""
_ARRAYS = {"frames", "first_frame", "motion_m", "period_s"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipRequest:
    """A clip as it was sent."""

    body: bytes
    """Content of a file: a video, an npy of frames (T, H, W, 3), or an npz of `frames` and perhaps `first_frame`,
    `motion_m`, `period_s`."""
    period_s: float | None = None
    """Task time between two frames [s]; None: that of the file, else of the server."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipWorkerFactory:
    """Function that creates the worker of a process; picklable."""

    camera: str | None
    """Name or path of the camera; None: read off the clips."""
    period_s: float
    stride: int = 1
    """Every how many frames are measured in full."""

    def __call__(self) -> Callable[[ClipRequest], Score]:
        """Return the function that scores a clip."""
        return partial(self._score, Scorer(camera=self.camera, stride=self.stride))

    def _score(self, scorer: Scorer, request: ClipRequest) -> Score:
        suffix = _SUFFIXES.get(request.body[:4], ".mp4")
        options: dict[str, Any] = {}
        with TemporaryDirectory() as folder:
            path = Path(folder, "clip" + suffix)
            path.write_bytes(request.body)
            if suffix == ".npz":
                with open_npz(path) as archive:
                    options = {name: archive[name] for name in _ARRAYS.intersection(archive.files)}
            frames = np.asarray(options.pop("frames") if "frames" in options else read_video(path).frames)
        period_s = float(options.pop("period_s", self.period_s))
        return scorer(frames, period_s=request.period_s or period_s, **options)


class RewardService:
    """Application that answers the requests."""

    def __init__(self, jobs: JobQueue[ClipRequest, Score], *, most_bytes: int, token: str | None = None) -> None:
        """Create the application.

        Args:
            jobs: queue of clips.
            most_bytes: greatest size of a request.
            token: what a request has to bear in its header `Authorization: Bearer TOKEN`; None: nothing.
        """
        self._jobs = jobs
        self._most_bytes = most_bytes
        self._token = token
        self._tickets: OrderedDict[str, list[Future[Score]]] = OrderedDict()
        self.app = Starlette(
            routes=[
                Route("/score", self._guarded(self._post), methods=["POST"]),
                Route("/jobs/{id}", self._guarded(self._get)),
                Route("/api/reward/enqueue", self._guarded(self._enqueue), methods=["POST"]),
                Route("/api/reward/pull", self._guarded(self._pull), methods=["POST"]),
                Route("/metrics", self._guarded(self._metrics)),
                Route("/health", self._health),
            ]
        )

    def _guarded(self, answer: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
        """Return a handler that refuses requests without the token, and words expected errors."""

        async def handle(request: Request) -> Response:
            bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
            if self._token is not None and not hmac.compare_digest(bearer.encode(), self._token.encode()):
                return JSONResponse({"error": "the token is absent or wrong"}, 401, {"WWW-Authenticate": "Bearer"})
            try:
                return await answer(request)
            except HTTPException as error:
                return JSONResponse({"error": error.detail}, error.status_code, error.headers)
            except KeyError as error:
                return JSONResponse({"error": f"there is no {error}, or it is forgotten"}, 404)
            except (KinebenchError, ValueError, TypeError) as error:
                return JSONResponse({"error": one_line(str(error))}, 400)

        return handle

    async def _body(self, request: Request) -> bytes:
        """Return the body, at most as large as is allowed."""
        body = bytearray()
        async for part in request.stream():
            body += part
            if len(body) > self._most_bytes:
                raise HTTPException(413, f"more than {self._most_bytes} bytes")
        return bytes(body)

    def _submit(self, clips: list[ClipRequest]) -> str:
        """Queue clips and return the id of their ticket."""
        jobs = self._jobs.submit(clips)
        if jobs is None:
            raise HTTPException(429, "the queue is full, ask again later", {"Retry-After": "1"})
        id = uuid.uuid4().hex
        self._tickets[id] = jobs
        while len(self._tickets) > MOST_TICKETS:
            self._tickets.popitem(last=False)
        return id

    async def _post(self, request: Request) -> Response:
        period = request.query_params.get("period_s")
        period_s = None if period is None else float(period)
        id = self._submit([ClipRequest(body=await self._body(request), period_s=period_s)])
        return JSONResponse({"id": id, "state": "queued"}, 202)

    async def _get(self, request: Request) -> Response:
        id = request.path_params["id"]
        [future] = self._tickets[id]
        if not future.done():
            return JSONResponse({"id": id, "state": "queued"}, 202)
        score = _result(future)
        return JSONResponse({"id": id, "state": "done", "reward": score.reward, **asdict(score)})

    async def _enqueue(self, request: Request) -> Response:
        line, _, data = (await self._body(request)).partition(b"\n")
        infos = json.loads(line).get("video_infos", [])
        clips = np.load(io.BytesIO(data), allow_pickle=False)
        if clips.ndim != 5 or clips.shape[1] != 3:
            raise InputError(f"clips have the shape {clips.shape}, expected (B, 3, T, H, W) pixels, not latents")
        requests = []
        for k, clip in enumerate(clips):
            file = io.BytesIO()
            np.save(file, to_frames(clip))
            rate = infos[k].get("video_fps") if k < len(infos) else None
            requests.append(ClipRequest(body=file.getvalue(), period_s=None if rate is None else 1.0 / float(rate)))
        return JSONResponse({"uuid": self._submit(requests)})

    async def _pull(self, request: Request) -> Response:
        form = parse_qs((await self._body(request)).decode())
        futures = self._tickets[form["uuid"][0]]
        if not all(future.done() for future in futures):  # cosmos-rl asks again after this status
            return JSONResponse({"message": "the scores are not there yet"}, 400)
        return JSONResponse(cosmos_result(list(map(_result, futures)), {}, 0.0))

    async def _health(self, request: Request) -> Response:
        return JSONResponse({"status": "ok", "workers": len(self._jobs.pids), "open": self._jobs.open})

    async def _metrics(self, request: Request) -> Response:
        numbers = {
            "open_clips": self._jobs.open,
            "workers": len(self._jobs.pids),
            **{f"{name}_total": count for name, count in self._jobs.counts.items()},
        }
        lines = []
        for name, value in numbers.items():
            kind = "counter" if name.endswith("_total") else "gauge"
            lines.append(f"# TYPE kinebench_{name} {kind}\nkinebench_{name} {value:g}\n")
        return PlainTextResponse("".join(lines), media_type="text/plain; version=0.0.4")


def _result(future: "Future[Score]") -> Score:
    """Return the score of a clip, or that of one without a result."""
    try:
        return future.result()
    except KinebenchError as error:
        return Score.failed(str(error))
