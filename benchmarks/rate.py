"""Rate, accuracy and memory of the reward: with the camera of each clip checked, with one camera, and with strides.

Clips are 25 frames of videos with exact poses, at 256 px. The settings take turns clip by clip. A fault is planted in
one frame, at random, and counts as detected if the clip is no longer executable or is worth less than `WORTH` of the
clean one, by the same setting.
"""

import os
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial, wraps
from pathlib import Path
from types import MappingProxyType
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks import markdown
from benchmarks.process import WORKER, children, command_line
from benchmarks.reward import Clip, Pictures, blur, hide, read_clips
from kinebench_drake.api.scorer import Score, Scorer
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import pipeline
from kinebench_drake.grounding.anomaly.camera_motion import FeatureTracks
from kinebench_drake.grounding.camera import choice
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.refinement import EdgeRefinement
from kinebench_drake.grounding.tracking.smoothing import RawTrack
from kinebench_drake.grounding.tracking.stride import StridedTracker
from kinebench_drake.grounding.tracking.tracker import CadTracker
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.runs.score import VideoEvaluator, VideoMeasurement
from kinebench_drake.suites.clock import FRAME_PERIOD_S

FRAMES = 25
WIDTH_PX = 256
WORTH = 0.8
"""Share of the reward of the clean clip below which a fault counts as detected."""
MEMORY_STEP = 50
"""Clips between two readings of the memory."""
TAIL = 95.0
"""Percentile of the seconds a clip that stands for the slow ones."""
SETTINGS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {"every camera checked": {}, "one camera": {"stride": 1}, "stride 2": {"stride": 2}, "stride 3": {"stride": 3}}
)
"""Arguments of `Scorer`; without any its camera is an argument of each call."""
FULL = "every camera checked"
WITH_FAULTS = (FULL, "stride 2", "stride 3")
"""Settings by which clips with faults are scored."""
STAGES: Sequence[tuple[str, Any, str]] = (
    ("networks", NetworkEstimator, "_run"),
    ("detection of the gripper", CadTracker, "_detect"),
    ("fits of hand and arm", CadTracker, "_measure"),
    ("hand alone", StridedTracker, "_between"),
    ("hand alone", CadTracker, "fit_hands"),
    ("fits to edges", EdgeRefinement, "run"),
    ("fits to edges", EdgeRefinement, "_sharpened"),
    ("ICP", CadTracker, "_register_all"),
    ("motion of the camera", FeatureTracks, "track"),
    ("following the camera", pipeline, "follow_camera"),
    ("anomalies", pipeline, "gather_evidence"),
    ("anomalies", pipeline, "find_anomalies"),
    ("confidence and smoothing", RawTrack, "features"),
    ("confidence and smoothing", RawTrack, "on_path"),
    ("confidence and smoothing", RawTrack, "smooth"),
    ("check of the camera", choice, "check_named"),
    ("verdict", TrackJudge, "judge_poses"),
)
"""Stages with the functions that they consist of; a function within another counts for itself alone."""
REST = "rest"


@dataclass(frozen=True, slots=True)
class Stopwatch:
    """Processor time by stage, and the last measurement."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    measured: list[VideoMeasurement] = field(default_factory=list)
    _inner: dict[int, list[float]] = field(default_factory=lambda: defaultdict(list))

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that adds its processor time, without that of other stages in it."""

        @wraps(function)
        def run(*args: Any, **kwargs: Any) -> Any:
            inner = self._inner[threading.get_ident()]
            inner.append(0.0)
            start = time.thread_time()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.thread_time() - start
                self.seconds[stage] += spent - inner.pop()
                if inner:
                    inner[-1] += spent

        return run

    def kept(self, function: Callable[..., VideoMeasurement]) -> Callable[..., VideoMeasurement]:
        """Return a function that keeps its result."""

        @wraps(function)
        def run(*args: Any, **kwargs: Any) -> VideoMeasurement:
            self.measured[:] = [function(*args, **kwargs)]
            return self.measured[0]

        return run

    @contextmanager
    def running(self) -> Iterator[None]:
        """Measure the stages within the context."""
        with ExitStack() as stack:
            for stage, owner, name in STAGES:
                stack.enter_context(patch.object(owner, name, self.timed(stage, getattr(owner, name))))
            stack.enter_context(patch.object(VideoEvaluator, "measure", self.kept(VideoEvaluator.measure)))
            yield


def cut_clips(folder: Path) -> list[Clip]:
    """Return the first and the last 25 frames, and every second one, of the clean videos of a folder."""
    clips = []
    for clip in read_clips(folder):
        count = len(clip.frames)
        for first, step in ((0, 1), (count - FRAMES, 1), (0, (count - 1) // (FRAMES - 1))):
            rows = first + step * np.arange(FRAMES)
            size = (WIDTH_PX, round(WIDTH_PX * clip.frames.shape[1] / clip.frames.shape[2]))
            frames = np.stack([cv2.resize(f, size, interpolation=cv2.INTER_AREA) for f in clip.frames[rows]])
            hand_px = clip.hand_px[rows] * WIDTH_PX / clip.frames.shape[2]
            own = {"frames": frames.astype(np.uint8), "hand_px": hand_px, "p_C": clip.p_C[rows]}
            clips.append(replace(clip, id=f"{clip.id} from {first} by {step}", **own))
    return clips


def period_s(clip: Clip) -> float:
    """Return the task time between two frames [s]."""
    return FRAME_PERIOD_S * float(clip.id.rpartition(" ")[2])


def _with_frame(clip: Clip, number: int, image: Pictures) -> Pictures:
    frames = clip.frames.copy()
    frames[number] = image
    return frames


def _stretch(part: Pictures) -> Pictures:
    rows, columns = part.shape[:2]
    wide = cv2.resize(part, (round(1.5 * columns), rows))
    offset = (wide.shape[1] - columns) // 2
    return np.asarray(wide[:, offset : offset + columns], dtype=np.uint8)


FAULTS: Mapping[str, Callable[[Clip, int], Pictures]] = MappingProxyType(
    {
        "jump: a frame of elsewhere": lambda c, i: _with_frame(c, i, c.frames[(i + FRAMES // 2) % FRAMES]),
        "teleport: frames left out": lambda c, i: c.at(np.where(np.arange(FRAMES) < i, 0.0, 8.0) + np.arange(FRAMES)),
        "hand hidden": lambda c, i: hide(c, 1, i),
        "hand blurred": lambda c, i: c.change_hand(blur(8.0), i, i + 1),
        "hand stretched by a half": lambda c, i: c.change_hand(_stretch, i, i + 1),
        "picture shifted by 12 px": lambda c, i: _with_frame(c, i, np.roll(c.frames[i], 12, axis=1)),
        "black picture": lambda c, i: _with_frame(c, i, np.zeros_like(c.frames[i])),
        "frame of another clip": lambda c, i: _with_frame(c, i, _small(c.other[i], c)),
    }
)
"""Faults that begin in one frame; all but the second are over in the next one."""


def _small(image: Pictures, clip: Clip) -> Pictures:
    height, width = clip.frames.shape[1:3]
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipRun:
    """A clean clip by one setting."""

    setting: str
    seconds: Mapping[str, float]
    """Processor time by stage [s]; `REST` beside them."""
    error_m: Array
    """(T,) error of the position [m]; NaN where it is not tracked."""
    score: Score

    @property
    def total_s(self) -> float:
        """Processor time [s]."""
        return sum(self.seconds.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A clip with a fault, by all settings."""

    fault: str
    detected: Mapping[str, bool]
    """By setting."""


class RateStudy:
    """Scorers of all settings in this process."""

    def __init__(self, camera: Path) -> None:
        self._camera = camera
        self._scorers = {name: Scorer(camera=camera, **own) if own else Scorer() for name, own in SETTINGS.items()}

    def _score(self, setting: str, frames: Pictures, clip: Clip) -> Score:
        camera = None if SETTINGS[setting] else self._camera
        return self._scorers[setting](np.ascontiguousarray(frames), period_s=period_s(clip), camera=camera)

    def warm_up(self, clip: Clip) -> None:
        """Load the models, and have the camera checked."""
        for setting in self._scorers:
            self._score(setting, clip.frames, clip)

    def run(self, clip: Clip) -> Iterator[ClipRun]:
        """Yield the clean clip by each setting."""
        for setting in self._scorers:
            watch = Stopwatch()
            with watch.running():
                start = time.process_time()
                score = self._score(setting, clip.frames, clip)
                total = time.process_time() - start
            track = watch.measured[0].grounding.track
            error_m = np.linalg.norm(track.X_CH[:, :3, 3] - clip.p_C, axis=1)
            seconds = {**watch.seconds, REST: total - sum(watch.seconds.values())}
            yield ClipRun(setting=setting, seconds=seconds, error_m=error_m, score=score)

    def plant(self, clip: Clip, clean: Mapping[str, Score], faults: int, rng: np.random.Generator) -> Iterator[Trial]:
        """Yield the clip with some faults in random frames, but for the first and last three."""
        for name in rng.permutation(list(FAULTS))[:faults]:
            frames = FAULTS[name](clip, int(rng.integers(3, FRAMES - 3)))
            scores = {setting: self._score(setting, frames, clip) for setting in WITH_FAULTS}
            detected = {
                s: not score.executable or score.reward < WORTH * clean[s].reward for s, score in scores.items()
            }
            yield Trial(fault=str(name), detected=detected)


def measure(
    clips: Sequence[Clip], camera: Path, *, faults: int, log: Callable[[str], None]
) -> tuple[list[ClipRun], list[Trial]]:
    """Score every clip by each setting, also with some faults."""
    study = RateStudy(camera)
    study.warm_up(clips[0])
    rng = np.random.default_rng(0)
    runs: list[ClipRun] = []
    trials: list[Trial] = []
    for clip in clips:
        own = list(study.run(clip))
        runs += own
        log(f"{clip.id}: " + ", ".join(f"{r.setting} {r.total_s:.2f} s, {r.score.reward:.2f}" for r in own))
        clean = {run.setting: run.score for run in own}
        if all(score.executable for score in clean.values()):
            trials += study.plant(clip, clean, faults, rng)
            log(f"{sum(t.detected[FULL] for t in trials)} of {len(trials)} faults detected in full")
    return runs, trials


def wall_rates(clips: Sequence[Clip], camera: Path, jobs: int) -> dict[str, float]:
    """Return the clips a second of `jobs` processes by setting, start-up and the first clips apart."""
    rates = {}
    frames = [clip.frames for clip in clips if period_s(clip) == FRAME_PERIOD_S]
    for setting, own in SETTINGS.items():
        with Scorer(jobs=jobs, camera=camera, **own) if own else Scorer(jobs=jobs) as scorer:
            score = partial(scorer.batch, period_s=FRAME_PERIOD_S, camera=None if own else camera)
            score(frames[:1] * 2 * jobs)
            start = time.monotonic()
            score(frames)
            rates[setting] = len(frames) / (time.monotonic() - start)
    return rates


def rate_section(runs: Sequence[ClipRun], trials: Sequence[Trial], walls: Mapping[str, float]) -> str:
    """Return the tables: rate and accuracy, faults, processor time by stage."""
    settings = list(dict.fromkeys(run.setting for run in runs))
    by = {setting: [run for run in runs if run.setting == setting] for setting in settings}
    by_full = [trial for trial in trials if trial.detected[FULL]]
    rows = []
    for setting, own in by.items():
        seconds = np.array([run.total_s for run in own])
        error_mm = 1e3 * np.concatenate([run.error_m for run in own])
        detected = sum(trial.detected.get(setting, False) for trial in by_full)
        rows.append(
            [
                setting,
                f"{seconds.mean():.2f}",
                f"{np.percentile(seconds, TAIL):.2f}",
                f"{2.0 / seconds.mean():.2f}",
                *([f"{walls[setting]:.2f}"] if walls else []),
                f"{np.nanmedian(error_mm):.1f} / {np.nanpercentile(error_mm, TAIL):.1f}",
                f"{np.isfinite(error_mm).mean():.1%}",
                f"{sum(not run.score.executable for run in own)} of {len(own)}",
                f"{detected} of {len(by_full)}" if setting in WITH_FAULTS else "",
            ]
        )
    head = ["setting", "s a clip", "95 %", "clips a second of two processors", *(["measured"] if walls else [])]
    of_clips = ["error, mm, median / 95 %", "tracked", "clean ones not executable", "faults"]
    tables = [markdown.table([*head, *of_clips], rows)]
    if by_full:
        faults = [
            [name, str(sum(t.fault == name for t in trials))]
            + [str(sum(t.fault == name and t.detected[s] for t in trials)) for s in WITH_FAULTS]
            for name in FAULTS
        ]
        tables.append(markdown.table(["fault in one frame", "clips", *WITH_FAULTS], faults))
    stages = [*dict.fromkeys(stage for stage, _, _ in STAGES), REST]
    costs = [
        [stage, *(f"{1e3 * np.mean([run.seconds.get(stage, 0.0) for run in by[s]]):.0f}" for s in settings)]
        for stage in stages
    ]
    tables.append(markdown.table(["processor time a clip, ms", *settings], costs))
    return "\n\n".join("\n".join(table) for table in tables)


def measure_memory(
    clips: Sequence[Clip], camera: Path, count: int, stride: int, jobs: int
) -> Iterator[tuple[int, float, list[float]]]:
    """Score clips in turn, and yield after every 50 their number, the time since the start [s] and the memory [MB].

    That is the resident memory of this process and of each worker.
    """
    frames = [clip.frames for clip in clips]
    page_mb = os.sysconf("SC_PAGE_SIZE") / 1e6
    start = time.monotonic()
    with Scorer(jobs=jobs, camera=camera, stride=stride) as scorer:
        for number in range(0, count, MEMORY_STEP):
            scorer.batch(
                [frames[k % len(frames)] for k in range(number, number + MEMORY_STEP)], period_s=FRAME_PERIOD_S
            )
            workers = [pid for pid in children(os.getpid()) if WORKER in command_line(pid)]
            pages = [int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in (os.getpid(), *workers)]
            yield number + MEMORY_STEP, time.monotonic() - start, [page_mb * own for own in pages]
