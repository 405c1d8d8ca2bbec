"""Command `serve`: scores as a service."""

import os
from typing import IO

import click

from kinebench_drake.cli.click_options import echo
from kinebench_drake.errors import UsageError

TOKEN_VARIABLE = "KINEBENCH_TOKEN"
LOOPBACK = ("127.0.0.1", "::1", "localhost")


@click.command(
    epilog="\b\nExample:\n"
    "  kinebench-drake serve --port 8001 --workers 2 --camera camera.json\n"
    "  curl --data-binary @clip.mp4 'http://127.0.0.1:8001/score?period_s=0.2'\n"
    "  curl http://127.0.0.1:8001/jobs/ID"
)
@click.option("--port", type=click.IntRange(0, 65535), required=True, metavar="N", help="Port; 0: any free one.")
@click.option(
    "--host", default=LOOPBACK[0], show_default=True, help="Address; another than this machine's needs a token."
)
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, metavar="N", help="Processes.")
@click.option("--queue", type=click.IntRange(1), default=256, show_default=True, metavar="N", help="Most open clips.")
@click.option("--camera", metavar="NAME|FILE", help="Camera of the clips.  [default: read off the clips]")
@click.option(
    "--stride",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    metavar="K",
    help="Measure every K-th frame in full, which is faster.",
)
@click.option("--frame-period", default=0.2, show_default=True, metavar="S", help="Task time between frames.")
@click.option("--timeout", default=600.0, show_default=True, metavar="S", help="Time limit of a clip.")
@click.option(
    "--most-mb", type=click.IntRange(1), default=256, show_default=True, metavar="MB", help="Largest request."
)
@click.option("--token-file", type=click.File(), metavar="FILE", help="File with the token.")
def serve(
    port: int,
    host: str,
    workers: int,
    queue: int,
    camera: str | None,
    stride: int,
    frame_period: float,
    timeout: float,
    most_mb: int,
    token_file: IO[str] | None,
) -> None:
    """Score clips that are sent over HTTP (docs/reward.md), until interrupted.

    With --token-file, or the environment variable KINEBENCH_TOKEN, requests have to bear this token.
    """
    import socket

    import uvicorn

    from kinebench_drake.api.single import camera_setting
    from kinebench_drake.executors.queue import JobQueue
    from kinebench_drake.integrations.server import ClipWorkerFactory, RewardService
    from kinebench_drake.runs.config import check_period

    check_period(frame_period)
    camera_setting(camera)
    token = token_file.read().strip() if token_file else os.environ.get(TOKEN_VARIABLE)
    if not token and host not in LOOPBACK:
        raise UsageError(f"--host {host}: other machines can reach it, so it needs --token-file or {TOKEN_VARIABLE}")
    make_worker = ClipWorkerFactory(camera=camera, period_s=frame_period, stride=stride)
    jobs = JobQueue(make_worker, workers=workers, most=queue, timeout_s=timeout)
    service = RewardService(jobs, most_bytes=most_mb << 20, token=token or None)
    with socket.create_server((host, port)) as listener:
        echo(f"listening on http://{host}:{listener.getsockname()[1]}")
        try:
            uvicorn.Server(uvicorn.Config(service.app, log_level="warning")).run(sockets=[listener])
        finally:
            jobs.close()
