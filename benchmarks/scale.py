"""Commands of `python -m benchmarks` that measure whole runs of the program."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from benchmarks.markdown import replace_section
from kinebench_drake.errors import KinebenchError

EXAMPLES = Path("examples/videos")

_out = click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False, exists=True), help="Markdown file to write a section into."
)
_work = click.option(
    "--work", type=click.Path(path_type=Path, file_okay=False), help="Empty folder for input and results, kept."
)
_videos = click.option(
    "--videos", type=click.Path(path_type=Path, file_okay=False, exists=True), default=EXAMPLES, show_default=True,
    help="Folder of mp4.",
)  # fmt: skip
_note = partial(click.echo, err=True)


@contextmanager
def _place(work: Path | None) -> Iterator[Path]:
    """A folder to work in."""
    if work is not None:
        work.mkdir(parents=True, exist_ok=True)
        yield work
    else:
        with TemporaryDirectory() as folder:
            yield Path(folder)


def _write(out: Path | None, work: Path | None, measured: Callable[[Path], str]) -> None:
    """Measure, then put what came of it into a page and on the screen."""
    try:
        with _place(work) as folder:
            text = measured(folder)
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    click.echo(text)
    if out is not None:
        out.write_text(replace_section(out.read_text(), text))


@click.command(epilog="\b\nExample:\n  python -m benchmarks throughput --out docs/benchmarks.md")
@_out
@_work
@click.option(
    "--video", type=click.Path(path_type=Path, dir_okay=False, exists=True),
    default=EXAMPLES / "StackCube-v1_s0010_unseen.mp4", show_default=True, help="Video whose copies are scored.",
)  # fmt: skip
@click.option("--count", type=click.IntRange(3), default=12, show_default=True, help="Copies of the video.")
@click.option("--tracks", type=click.IntRange(3), default=200, show_default=True, help="Trajectories audited.")
@click.option("--turns", type=click.IntRange(1), default=3, show_default=True, help="How often everything is run.")
def throughput(out: Path | None, work: Path | None, video: Path, count: int, tracks: int, turns: int) -> None:
    """Measure runs of score and audit with one and two processes, and on the GPU if there is one."""
    import torch

    from benchmarks.throughput import measure, section

    options: Any = {"videos": count, "tracks": tracks, "turns": turns, "gpu": torch.cuda.is_available(), "note": _note}
    _write(out, work, lambda folder: section(measure(video, folder, **options), videos=count, tracks=tracks))


@click.command(epilog="\b\nExample:\n  python -m benchmarks streaming --out docs/benchmarks.md")
@_out
@_work
@_videos
@click.option("--samples", type=click.IntRange(80), default=2000, show_default=True, help="Videos scored.")
@click.option("--frames", type=click.IntRange(2), default=4, show_default=True, help="Of each.")
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True, help="Worker processes.")
def streaming(out: Path | None, work: Path | None, videos: Path, samples: int, frames: int, jobs: int) -> None:
    """Score very many short videos and see what memory, the report and a second run take."""
    from benchmarks.streaming import measure, section

    options: Any = {"samples": samples, "frames": frames, "jobs": jobs, "note": _note}
    _write(out, work, lambda folder: section(measure(videos, folder, **options)))


@click.command(epilog="\b\nExample:\n  python -m benchmarks cluster --out docs/cluster.md")
@_out
@_work
@click.option(
    "--videos", type=click.Path(path_type=Path, exists=True), default=EXAMPLES / "manifest.jsonl", show_default=True,
    help="What is scored.",
)  # fmt: skip
@click.option(
    "--tasks", default="PullCube-v1,OpenDrawer-v1", show_default=True, help="Tasks of the suite run.", metavar="A,B"
)
@click.option("--episodes", type=click.IntRange(1), default=2, show_default=True, help="Of each task.", metavar="K")
def cluster(out: Path | None, work: Path | None, videos: Path, tasks: str, episodes: int) -> None:
    """Score and run a suite on a Ray cluster of two local nodes, kill a worker, and compare with a local run."""
    from benchmarks.cluster import SUITE, section, try_out

    suite = ["suite", "run", *SUITE, "--tasks", tasks, "--episodes", str(episodes)]
    _write(out, work, lambda folder: section(try_out([["score", str(videos), "--overlay"], suite], folder, _note)))


COMMANDS = (throughput, streaming, cluster)
