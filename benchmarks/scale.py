"""A run of very many samples without its measurements: time and memory of everything else, stage by stage.

Inputs, hashes, storage, aggregates, merge and report are the program's; only reading, grounding and judging a video are
replaced by a row and a track of a template run, its numbers scaled at random.
"""

import json
import multiprocessing
import os
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import markdown
from benchmarks.process import read_memory
from benchmarks.record import machine_text
from kinebench_drake.errors import KinebenchError, UsageError
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.report.page import write_report
from kinebench_drake.results.metadata import Shard
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import REPORT, RESULTS, SAMPLES, artifact_path, read_rows
from kinebench_drake.runs.config import RunKind, ScoreConfig
from kinebench_drake.runs.evaluator import SampleHashes, fail_row
from kinebench_drake.runs.merge import merge_folders
from kinebench_drake.runs.runner import NullRunObserver, run_samples
from kinebench_drake.runs.score import VideoEvaluator

_TASKS = 20
_MODELS = 4
MAX_LINKS = 60_000
"""Links of a file that are made; file systems allow about 65,000."""
_FAILURES = {
    997: (Status.ERROR, "the file holds no frame that can be decoded ({k} bytes)"),
    17: (Status.UNMEASURABLE, "the gripper was found in {k} of 49 frames, a path needs 2"),
}
"""One sample of so many has the status and reason; `k` varies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageCost:
    """Cost of one stage, in a process of its own."""

    stage: str
    wall_s: float
    cpu_s: float
    """Processor time of the main process [s]."""
    memory_mb: float
    """Peak resident memory of the main process, libraries included [MB]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleResult:
    """Measurements of one run."""

    rows: int
    stages: Sequence[StageCost]
    samples_mb: float
    """Size of samples.jsonl [MB]."""
    report_mb: float
    """Size of report.html [MB]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StubEvaluator(VideoEvaluator):
    """Evaluation that takes rows and files from a finished run in place of measuring videos."""

    template: Path
    """Output folder with at least one sample of status ok."""

    def setup(self) -> Any:
        """Read the rows of the template."""
        return [row for row in read_rows(self.template).values() if row.status is Status.OK]

    def row(self, sample: VideoSample, resources: Any, hashes: SampleHashes) -> SampleRow:
        """Return a row of the template under the sample's id, its numbers scaled; link its files."""
        rng = np.random.default_rng(list(sample.id.encode()))
        k = int(rng.integers(2**31))
        for every, (status, reason) in _FAILURES.items():
            if k % every == 0:
                return _label(fail_row(self.blank_row(sample, hashes), status, reason.format(k=k % 997)), k)
        model = resources[k % len(resources)]
        scale = float(rng.normal(1.0, 0.1))
        for kind in ("tracks", "thumbnails"):
            source = artifact_path(self.template, kind, model.id)
            target = artifact_path(self.config.out, kind, sample.id)
            if source.is_file():
                target.parent.mkdir(exist_ok=True)
                target.unlink(missing_ok=True)
                _link(source, target)
        scaled = {name: v * scale for name, v in model.metrics.numbers.items() if isinstance(v, float)}
        row = replace(model, id=sample.id, video=sample.video, content_hash=hashes.content).measured(scaled)
        return _label(row, k)


def _label(row: SampleRow, k: int) -> SampleRow:
    return replace(row, task=f"Task-{k % _TASKS:02d}", model=f"model-{k // _TASKS % _MODELS}")


def _link(source: Path, target: Path) -> None:
    """Link a file, or copy it where it has too many links."""
    if source.stat().st_nlink < MAX_LINKS:
        os.link(source, target)
    else:
        shutil.copyfile(source, target)


def measure(
    videos: Path, template: Path, work: Path, *, rows: int, jobs: int, log: Callable[[str], None]
) -> ScaleResult:
    """Measure every stage of a run in the folder `work`, which must hold none yet.

    The mp4 files of `videos` are linked under `rows` names; `template` is an output folder of `score`.

    Raises:
        UsageError: there is no video, or no sample in the template.
        KinebenchError: a stage failed.
    """
    source = work / "videos"
    out = work / "results"
    _link_videos(videos, source, rows)
    shards = [work / f"shard-{k}" for k in (1, 2)]
    stages: list[StageCost] = []

    def run(name: str, action: Callable[..., object], *arguments: Any) -> None:
        stages.append(_run_stage(name, action, arguments))
        log(f"{name}: {stages[-1].wall_s:.1f} s, {stages[-1].cpu_s:.1f} s of processor, {stages[-1].memory_mb:.0f} MB")

    run("score", _score, source, template, out, jobs, None)
    run("the same command again", _score, source, template, out, jobs, None)
    run("report", write_report, out)
    _split(out, shards)
    for k, shard in enumerate(shards, 1):
        run(f"shard {k} of 2, finished", _score, source, template, shard, 1, Shard(index=k, count=2))
    run("merge of the shards", merge_folders, shards, work / "merged")
    return ScaleResult(
        rows=rows,
        stages=stages,
        samples_mb=(out / SAMPLES).stat().st_size / 2**20,
        report_mb=(out / REPORT).stat().st_size / 2**20,
    )


def _link_videos(videos: Path, out: Path, count: int) -> None:
    pieces = sorted(videos.glob("*.mp4"))
    if not pieces:
        raise UsageError(f"{videos}: holds no mp4")
    out.mkdir(parents=True)
    copies = [shutil.copyfile(piece, out.parent / f".{piece.name}") for piece in pieces]
    for k in range(count):
        copy = Path(copies[k % len(copies)])
        _link(copy, out / f"{copy.stem[1:]}-{k:06d}.mp4")


def _score(source: Path, template: Path, out: Path, jobs: int, shard: Shard | None) -> None:
    config = ScoreConfig(
        kind=RunKind.SCORE, source=source, out=out, jobs=jobs, shard=shard, frame_period_s=0.2, replays=None
    )
    evaluator = StubEvaluator(config=config, overrides=config.overrides(), template=template)
    run_samples(find_samples(source, out=out).samples, evaluator, NullRunObserver())


def _split(out: Path, shards: Sequence[Path]) -> None:
    """Fill the folders of shards from the folder of the whole run, sample by sample in turn."""
    for shard in shards:
        for kind in ("tracks", "thumbnails"):
            (shard / kind).mkdir(parents=True)
        shutil.copyfile(out / RESULTS, shard / RESULTS)
    with ExitStack() as stack, (out / SAMPLES).open("rb") as lines:
        files = [stack.enter_context((shard / SAMPLES).open("wb")) for shard in shards]
        for line, shard, file in zip(lines, cycle(shards), cycle(files), strict=False):
            file.write(line)
            for kind in ("tracks", "thumbnails"):
                path = artifact_path(out, kind, json.loads(line)["id"])
                if path.is_file():
                    _link(path, shard / kind / path.name)


def _run_stage(name: str, action: Callable[..., object], arguments: tuple[Any, ...]) -> StageCost:
    """Run a stage in a new process.

    Raises:
        KinebenchError: the process died.
    """
    start = time.monotonic()
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            cpu_s, memory_mb = pool.submit(_stage, action, arguments).result()
        except BrokenProcessPool:
            raise KinebenchError(f"{name}: its process died") from None
    return StageCost(stage=name, wall_s=time.monotonic() - start, cpu_s=cpu_s, memory_mb=memory_mb)


def _stage(action: Callable[..., object], arguments: tuple[Any, ...]) -> tuple[float, float]:
    action(*arguments)
    memory = read_memory(os.getpid())
    return time.process_time(), memory.main_mb if memory else float("nan")


def figures(result: ScaleResult) -> dict[str, float]:
    """Return processor time and memory of each stage, and the size of the report."""
    return {
        **{f"{stage.stage}, s of processor": stage.cpu_s for stage in result.stages},
        **{f"{stage.stage}, MB": stage.memory_mb for stage in result.stages},
        "report.html, MB": result.report_mb,
    }


def section(result: ScaleResult) -> str:
    """Return the section of the document."""
    return markdown.section(
        "A hundred thousand samples",
        f"`python -m benchmarks scale` on {machine_text()}: a run of {result.rows} samples. Their reading, grounding "
        "and judging are replaced by rows and tracks of the example videos. Memory: peak of the main process, "
        "libraries included.",
        markdown.table(
            ("stage", "wall time, s", "memory, MB"),
            [[s.stage, f"{s.wall_s:.0f}", f"{s.memory_mb:.0f}"] for s in result.stages],
        ),
        f"`samples.jsonl`: {result.samples_mb:.0f} MB. `report.html`: {result.report_mb:.1f} MB.",
    )
