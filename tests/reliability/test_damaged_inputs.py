"""Valid inputs made wrong: each is read or refused in one line, within bounded memory, and no pickle is loaded."""

import resource
import shutil
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kinebench_drake.errors import KinebenchError
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.metadata import read_metadata
from kinebench_drake.results.store import ResultStore
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.suites.report.comparison import read_comparison
from kinebench_drake.suites.worldmodels.http import HttpModel
from kinebench_drake.suites.worldmodels.remote import Limits
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request
from tests.reliability.damage import PICKLE_MARK, Tree, damage
from tests.reliability.inputs import FRAMES, INPUTS, REQUEST_ID
from tests.suites.worldmodels.servant import Asked, Reply, Servant

MEMORY_MB = 1024.0
"""Most that reading one damaged input may add to the peak resident size of the process."""
LIMITS = Limits(
    attempts=2, first_wait_s=0.001, longest_wait_s=0.001, silence_s=1.0, poll_s=0.001, json_bytes=1 << 20,
    video_bytes=1 << 20,
)  # fmt: skip
OPTIONS = TrajectoryOptions()


def source_of(folder: Path) -> Path:
    names = sorted(path.name for path in folder.iterdir())
    if "manifest.jsonl" in names:
        return folder / "manifest.jsonl"
    return folder / names[0] if len(names) == 1 else folder


def read_videos(folder: Path) -> Iterator[Callable[[], object]]:
    for sample in find_samples(source_of(folder)).samples:
        if sample.problem is None:
            yield lambda sample=sample: read_video(sample.path, sample.part).require_measurable()


def read_trajectories(folder: Path) -> Iterator[Callable[[], object]]:
    for sample in find_trajectories(folder, OPTIONS):
        yield lambda sample=sample: read_trajectory(sample, OPTIONS)


def read_results(folder: Path) -> Iterator[Callable[[], object]]:
    shards = [folder / "one", folder / "two"]
    yield lambda: read_comparison(shards)
    yield lambda: read_metadata(shards[0])
    yield lambda: ResultStore(shards[0]).close()
    for path in (shards[0] / "tracks").glob("*.npz"):
        yield lambda path=path: read_track(path)


STILL = ActionTrack(
    t_s=np.arange(FRAMES), X_BG=np.zeros((FRAMES, 4, 4)), finger_width_m=np.zeros(FRAMES), q=np.zeros((FRAMES, 7))
)


def ask_for_video(folder: Path) -> Iterator[Callable[[], object]]:
    servant = Servant()

    def answer(asked: Asked) -> Reply:
        path = folder / f"{asked.path.partition('?')[0].rpartition('/')[2]}.json"
        if not path.is_file():
            return Reply({"message": "no such page"}, status=404)
        id = (asked.body or {}).get("request_id", REQUEST_ID)
        return Reply(path.read_bytes().replace(REQUEST_ID.encode(), id.encode()))

    servant.routes = dict.fromkeys(("/make", "/v1/health", "/v1/capabilities", "/v1/predict"), answer)
    request = Request(
        episode="StackCube-v1_s0003", task="StackCube-v1", round=0, prompt="stack", negative_prompt="", seed=3,
        first_frame=np.zeros((96, 96, 3), np.uint8), num_frames=FRAMES, fps=10.0, actions=STILL,
    )  # fmt: skip
    spec = f"{servant.url}/make?timeout=5" if (folder / "make.json").exists() else f"{servant.url}?timeout=5"
    try:
        yield lambda: HttpModel(parse(spec), LIMITS).generate(request, folder / "answer")
    finally:
        servant.stop()


READERS: Mapping[str, Callable[[Path], Iterator[Callable[[], object]]]] = {
    "videos": read_videos,
    "LeRobot videos": read_videos,
    "trajectories": read_trajectories,
    "results": read_results,
    "answers": ask_for_video,
}


def attempt(read: Callable[[], object]) -> object:
    """Read; None where the input is refused in one printable line. Any other exception is the reader's fault."""
    try:
        return read()
    except KinebenchError as error:
        message = str(error)
    assert message.isprintable()
    return None


@cache
def trees(kind: str) -> list[Tree]:
    return INPUTS[kind]()


def write(tree: Tree, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in tree.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder


@pytest.mark.parametrize("kind", INPUTS)
def test_undamaged_inputs_are_read(tmp_path, kind):
    for k, tree in enumerate(trees(kind)):
        for read in READERS[kind](write(tree, tmp_path / str(k))):
            read()


@pytest.mark.parametrize("kind", INPUTS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_damaged_inputs_are_read_or_refused_within_bounded_memory(tmp_path, kind, data):
    tree = data.draw(st.sampled_from(range(len(trees(kind)))).map(lambda k: trees(kind)[k]))
    random = data.draw(st.randoms(use_true_random=False))
    folder = write(damage(random, tree), tmp_path / "input")
    before = peak_mb()
    attempt(lambda: [attempt(read) for read in READERS[kind](folder)])
    assert peak_mb() - before < MEMORY_MB
    assert not PICKLE_MARK.exists()


def peak_mb() -> float:
    """Peak resident size of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
