"""Processor time of a round of the closed loop by stage: episodes of the oracle in one process, their stages timed."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from enum import Enum
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks import markdown
from benchmarks.record import machine_text
from kinebench_drake.errors import KinebenchError
from kinebench_drake.grounding.video import Grounder
from kinebench_drake.runs.evaluator import Evaluation
from kinebench_drake.runs.resources import Resources
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.suites.closed_loop import loop
from kinebench_drake.suites.closed_loop.execution import CommandPlanner
from kinebench_drake.suites.runs import episodes
from kinebench_drake.suites.runs.episodes import EpisodeEvaluator, EpisodeResources, EpisodeSample, run_suite
from kinebench_drake.suites.runs.suite_config import SuiteConfig
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.worldmodels.reference import OracleModel


class Stage(Enum):
    """Stages of a round."""

    RESET = "reset of the scene"
    IMAGE = "first image"
    MODEL = "world model (the oracle renders the expert)"
    GROUNDING = "grounding"
    COMMANDS = "commands"
    EXECUTION = "execution"
    EXECUTED_IMAGES = "images of the execution"
    KINEMATICS = "kinematics"
    GAP = "gap between video and execution"
    FILM = "film of the round"
    REST = "rest"


_SHOWN_S = 0.3
"""Least processor time of a stage in the table [s]."""
_FUNCTIONS: tuple[tuple[Any, str, Stage], ...] = (
    (Simulator, "reset", Stage.RESET),
    (Simulator, "render", Stage.IMAGE),
    (OracleModel, "generate", Stage.MODEL),
    (Grounder, "ground", Stage.GROUNDING),
    (CommandPlanner, "plan", Stage.COMMANDS),
    (loop, "execute", Stage.EXECUTION),
    (episodes, "render_video", Stage.EXECUTED_IMAGES),
    (Resources, "judge", Stage.KINEMATICS),
    (episodes, "measure_gap", Stage.GAP),
    (episodes, "write_video", Stage.FILM),
)
"""Owner and name of the function of each stage; a stage that another one calls counts as part of that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundTiming:
    """Processor times of rounds."""

    rounds: int
    episodes: int
    successes: int
    seconds: dict[Stage, float]
    """Sum over all rounds [s]."""


class StageClock:
    """Processor times of the stages of each episode."""

    def __init__(self) -> None:
        self.episodes: dict[str, dict[Stage, float]] = {}
        """Seconds by stage, by id of the episode in the order in which they ran."""
        self._seconds = dict.fromkeys(Stage, 0.0)
        self._busy = False

    @contextmanager
    def running(self) -> Iterator[None]:
        """Time all episodes that are evaluated in the meantime."""
        with ExitStack() as stack:
            for owner, name, stage in _FUNCTIONS:
                stack.enter_context(patch.object(owner, name, self._timed(getattr(owner, name), stage)))
            stack.enter_context(patch.object(EpisodeEvaluator, "evaluate", self._episode(EpisodeEvaluator.evaluate)))
            yield

    def _timed(self, function: Callable[..., Any], stage: Stage) -> Callable[..., Any]:
        @wraps(function)
        def timed(*arguments: Any, **options: Any) -> Any:
            if self._busy:
                return function(*arguments, **options)
            self._busy = True
            start = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                self._busy = False
                self._seconds[stage] += time.process_time() - start

        return timed

    def _episode(self, evaluate: Callable[..., Evaluation]) -> Callable[..., Evaluation]:
        @wraps(evaluate)
        def timed(evaluator: EpisodeEvaluator, sample: EpisodeSample, resources: EpisodeResources) -> Evaluation:
            self._seconds = dict.fromkeys(Stage, 0.0)
            start = time.process_time()
            result = evaluate(evaluator, sample, resources)
            self._seconds[Stage.REST] = time.process_time() - start - sum(self._seconds.values())
            self.episodes[sample.id] = self._seconds
            return result

        return timed


def measure(tasks: Sequence[str] | None, episodes: int, out: Path, observer: RunObserver) -> RoundTiming:
    """Run episodes of each task of suite 0 (None: all) with the oracle in this process, into the new folder `out`.

    Raises:
        UsageError: a task or the folder cannot be used.
        KinebenchError: an episode failed, or there is one only.
    """
    clock = StageClock()
    config = SuiteConfig(suite=0, tasks=tasks, episodes=episodes, world_model="oracle", out=out, jobs=1, replays=None)
    with clock.running():
        rows = {row.id: row for row in run_suite(config, observer).rows}
    ids = list(clock.episodes)[1:]  # the first episode loads networks and simulator
    rounds = [n for id in ids if isinstance(n := rows[id].extra.get("rounds"), int)]
    if not ids or len(rounds) < len(rows) - 1:
        raise KinebenchError(f"{len(rows) - 1 - len(rounds)} of {len(rows)} episodes failed; {out} has the reasons")
    return RoundTiming(
        rounds=sum(rounds),
        episodes=len(ids),
        successes=sum(rows[id].extra["success"] is True for id in ids),
        seconds={stage: sum(clock.episodes[id][stage] for id in ids) for stage in Stage},
    )


def figures(timing: RoundTiming) -> dict[str, float]:
    """Return the mean processor time of each stage in a round [s]."""
    return {f"{stage.value} [s]": timing.seconds[stage] / timing.rounds for stage in Stage}


def section(timing: RoundTiming) -> str:
    """Return the section of the page, in Markdown."""
    total = sum(timing.seconds.values())
    rows = [[stage.value, f"{s:.1f}"] for stage in Stage if (s := timing.seconds[stage] / timing.rounds) >= _SHOWN_S]
    own_s = (total - timing.seconds[Stage.MODEL]) / timing.rounds
    return markdown.section(
        "A round of the closed loop",
        f"`python -m benchmarks rounds` on {machine_text()}: {timing.rounds} rounds of {timing.episodes} episodes of "
        f"suite 0 with the oracle. {timing.successes} episodes succeed. Processor times of all threads; "
        f"stages of {_SHOWN_S:g} s or more.",
        markdown.table(("stage", "s a round"), [*rows, ["all", f"{total / timing.rounds:.1f}"]]),
        f"Without the world model a round takes {own_s:.1f} s of processor time.",
    )
