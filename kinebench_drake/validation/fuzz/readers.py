"""The program's readers as it calls them itself, up to where what was read would be worked on."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NoReturn, cast

import numpy as np

from kinebench_drake.errors import InputError, KinebenchError, SetupError, UnmeasurableError
from kinebench_drake.grounding.sources.sources import Sources
from kinebench_drake.inputs import find_samples
from kinebench_drake.measure import Kind
from kinebench_drake.merge import merge_folders
from kinebench_drake.results import ResultStore
from kinebench_drake.run import RunConfig, close_run, run_header, summarize
from kinebench_drake.stages import StageOptions, Stages
from kinebench_drake.suite_report import read_comparison, write_comparison
from kinebench_drake.suite_report.comparison import comparison_lines
from kinebench_drake.suites.worldmodels.dashscope import KEY as DASHSCOPE_KEY
from kinebench_drake.suites.worldmodels.dashscope import DashScope
from kinebench_drake.suites.worldmodels.factory import create
from kinebench_drake.suites.worldmodels.http import Http
from kinebench_drake.suites.worldmodels.minimax import KEY as MINIMAX_KEY
from kinebench_drake.suites.worldmodels.minimax import MiniMax
from kinebench_drake.suites.worldmodels.service import Limits
from kinebench_drake.suites.worldmodels.spec import Spec, parse
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModel
from kinebench_drake.trackfile import read_track
from kinebench_drake.trajectories.source import find_trajectories
from kinebench_drake.trajectories.trajectory import Choice
from kinebench_drake.trajectory_measure import TrajectoryMeasure
from kinebench_drake.validation.fuzz.answers import EPISODE, TASK
from kinebench_drake.validation.fuzz.service import serving
from kinebench_drake.video_measure import VideoMeasure

_HURRIED = Limits(
    attempts=2,
    first_wait_s=0.001,
    longest_wait_s=0.001,
    silence_s=1.0,
    poll_s=0.001,
    json_bytes=1 << 20,
    video_bytes=1 << 20,
)
_PATIENCE_S = 1


class Reached(Exception):  # noqa: N818 - no failure
    """What was read has got to where it is worked on."""


class _NoStages:
    """Stages that work on nothing."""

    def ground(self, *_: object) -> NoReturn:
        raise Reached

    judge = judge_joints = ground


def read_videos(folder: Path, source: str = "", sources: Sources | None = None) -> None:
    """Read all videos as `score` does, up to the grounding."""
    inputs = find_samples(folder / source if source else folder)
    measure = VideoMeasure(
        kind=Kind.SCORE,
        out=folder,
        stages="",
        stage_options=StageOptions(),
        frame_period_s=None,
        overlay=False,
        sources=sources or Sources(),
    )
    with _last_refusal() as attempt:
        for sample in inputs.samples:
            measure.content_hash(sample)
            attempt(partial(measure.measure, sample, cast(Stages, _NoStages())))


def read_file(folder: Path) -> None:
    """Read the only file of a folder as `score` does where it is named."""
    names = sorted(path.name for path in folder.iterdir())
    read_videos(folder, names[0] if len(names) == 1 else "")


def read_manifest(folder: Path) -> None:
    """Read a manifest's videos."""
    read_videos(folder, "manifest.jsonl")


def read_layouts(folder: Path) -> None:
    """Read EWMBench's and WorldArena's folders where they are named, as well as from above."""
    for name in ("wan_dataset", "wan_test"):
        if (folder / name).is_dir():
            return read_videos(folder, name)
    read_videos(folder)


def read_given(folder: Path) -> None:
    """Read a video with masks, depth and poses given."""
    sources = Sources(masks=folder / "masks", depth=str(folder / "depth"), poses=folder / "poses")
    read_videos(folder, "", sources)


def read_trajectories(folder: Path) -> None:
    """Read all trajectories as `audit` does, up to the judgement."""
    choice = Choice()
    measure = TrajectoryMeasure(kind=Kind.AUDIT, out=folder, stages="", stage_options=StageOptions(), choice=choice)
    with _last_refusal() as attempt:
        for sample in find_trajectories(folder, choice):
            measure.content_hash(sample)
            attempt(partial(measure.measure, sample, cast(Stages, _NoStages())))


def resume(folder: Path) -> None:
    """Go on with a run, as if nothing were left to do, and write its report."""
    header = run_header(RunConfig(out=folder, kind=Kind.AUDIT), found=4)
    with ResultStore(folder) as store:
        store.begin(header.to_json())
        store.keep(lambda row: True)
        store.finish(summarize(store.sorted_rows(), header))
        close_run(store, Kind.AUDIT, 0)


def audit_results(folder: Path) -> None:
    """Read the tracks of an output folder, as `audit` does and as `view` does."""
    with _last_refusal() as attempt:
        for path in sorted((folder / "tracks").glob("*.npz")):
            attempt(partial(read_track, path))
        attempt(lambda: read_trajectories(folder))


def merge(folder: Path) -> None:
    """Merge two shards."""
    merge_folders([folder / "one", folder / "two"], folder / "merged")


def compare(folder: Path) -> None:
    """Compare two suite runs."""
    for _ in comparison_lines(read_comparison([folder / "wan", folder / "hailuo"]).table):
        pass


def compare_drawn(folder: Path) -> None:
    """Compare two suite runs and write the page with its figures."""
    write_comparison(read_comparison([folder / "wan", folder / "hailuo"]), folder / "compared")


def ask_simple(folder: Path) -> None:
    """Ask a server for a video."""
    with serving(folder) as address:
        _ask(lambda: Http(_spec(f"http:{address}?style=simple&timeout={_PATIENCE_S}"), _HURRIED), folder)


def ask_predict(folder: Path) -> None:
    """Ask a server for frames."""
    with serving(folder) as address:
        _ask(lambda: Http(_spec(f"http:{address}?timeout={_PATIENCE_S}"), _HURRIED), folder)


def ask_dashscope(folder: Path) -> None:
    """Ask what answers as DashScope does."""
    os.environ[DASHSCOPE_KEY] = "none-at-all"
    with serving(folder) as address:
        _ask(lambda: DashScope(_spec(f"dashscope:?base={address}&timeout={_PATIENCE_S}"), _HURRIED), folder)


def ask_minimax(folder: Path) -> None:
    """Ask what answers as MiniMax does."""
    os.environ[MINIMAX_KEY] = "none-at-all"
    with serving(folder) as address:
        _ask(lambda: MiniMax(_spec(f"minimax:?base={address}&timeout={_PATIENCE_S}"), _HURRIED), folder)


def ask_folder(folder: Path) -> None:
    """Take a video from a folder of finished ones."""
    _ask(lambda: create(f"folder:{folder}"), folder)


def _spec(text: str) -> Spec:
    return parse(text)


def _ask(make: Callable[[], WorldModel], folder: Path) -> None:
    (folder / "answers").mkdir(exist_ok=True)
    request = Request(
        episode=EPISODE,
        task=TASK,
        round=0,
        prompt="stack",
        negative_prompt="",
        seed=3,
        first_frame=np.zeros((96, 96, 3), np.uint8),
        num_frames=4,
        fps=10.0,
    )
    model = make()
    try:
        model.generate(request, folder / "answers" / EPISODE)
    finally:
        model.close()


@contextmanager
def _last_refusal() -> Iterator[Callable[[Callable[[], object]], None]]:
    """Try several things; the last refusal is raised in the end, any other failure at once.

    Raises:
        RuntimeError: one of them would end a whole run.
    """
    refusals: list[KinebenchError] = []

    def attempt(read: Callable[[], object]) -> None:
        try:
            read()
        except Reached:
            pass
        except (InputError, UnmeasurableError) as error:
            refusals.append(error)
        except SetupError as error:
            raise RuntimeError(f"one sample ends the run: {error}") from error

    yield attempt
    if refusals:
        raise refusals[-1]
