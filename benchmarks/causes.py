"""Episodes with one planted cause of failure, and whether the verdict names it.

Each cause is planted where it acts: in the video (the oracle with a fault), in the reading (poses taken away), in the
robot (servos off by an angle, fingers that stay as they are), or in the plan (the expert stops half-way). Only episodes
that fail have a verdict; where the task succeeds in spite of the cause there is nothing to explain.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.closed_loop.attribution import FailureVerdict, find_cause
from kinebench_drake.closed_loop.commands import CommandPlanner
from kinebench_drake.closed_loop.loop import ClosedLoop, LoopOptions
from kinebench_drake.errors import InputError, KinebenchError
from kinebench_drake.evaluation.analyzer import Analyzer, RobotOptions
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.pipeline import GroundingResult
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.experts.registry import Expert, find_expert
from kinebench_drake.suites.faults.fault import FaultGrade
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.suite import EpisodeSpec
from kinebench_drake.suites.tasks.task import Scene
from kinebench_drake.suites.worldmodels.reference import OracleModel, OracleRenderer
from kinebench_drake.suites.worldmodels.worldmodel import Request, SimulatorState
from kinebench_drake.types import AnomalyKind, GripperTrack, Priors

FAULTS = (
    FaultGrade(kind=AnomalyKind.TELEPORT, size=0.15, form=None),
    FaultGrade(kind=AnomalyKind.VANISH, size=10, form=None),
    FaultGrade(kind=AnomalyKind.FREEZE, size=8, form=None),
)
"""Faults of the video, in turn: those that move the gripper's path, so that episodes fail by them."""
LOST_SHARE = (0.3, 0.7)
"""Part of the frames, in a row, that the reader loses."""
SLACK_RAD = 0.2
"""How far the first joint's servo is off."""
_SIZE_PX = 384


class Planted(Enum):
    """Where the cause is, and the verdict that should name it."""

    READING = FailureVerdict.GROUNDING
    VIDEO = FailureVerdict.GENERATION
    ROBOT = FailureVerdict.EXECUTION
    PLAN = FailureVerdict.TASK


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One episode with one cause."""

    draw: EpisodeSpec
    planted: Planted
    number: int
    """Which of its kind it is; decides the details."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What came of a case."""

    case: Case
    verdict: FailureVerdict | None
    """None where the episode succeeded all the same."""
    text: str
    """The cause in words, or why there was no episode."""


class _ForgetfulAnalyzer(Analyzer):
    """An analyzer that loses the gripper for a while."""

    share: tuple[float, float] | None = None
    """First frame and number of frames that are lost, as parts of the clip."""

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array, known: Priors) -> GroundingResult:
        """Track the gripper, then lose it."""
        grounding = super().ground(frames, camera, t_s, known)
        if self.share is None:
            return grounding
        start, length = (round(part * len(frames)) for part in self.share)
        return replace(grounding, track=_without(grounding.track, slice(start, start + length)))


def _without(track: GripperTrack, lost: slice) -> GripperTrack:
    X_CH, X_BG, width = track.X_CH.copy(), track.X_BG.copy(), track.finger_width_m.copy()
    tracked, confidence = track.tracked.copy(), track.confidence.copy()
    X_CH[lost], X_BG[lost], width[lost], tracked[lost], confidence[lost] = np.nan, np.nan, np.nan, False, 0.0
    return replace(track, X_CH=X_CH, X_BG=X_BG, finger_width_m=width, tracked=tracked, confidence=confidence)


class _SlackStage(Simulator):
    """A stage whose robot does something else than it is told."""

    slack_rad = 0.0
    stuck = False

    def step(self, q: ArrayLike, finger_width_m: float) -> None:
        """See `Stage.step`."""
        off = np.asarray(q, dtype=np.float64) + self.slack_rad * (np.arange(7) == 0)
        width = float(self.snapshot().fingers_m.sum()) if self.stuck else finger_width_m
        super().step(np.clip(off, *self.joint_limits), width)


class _HalfWay:
    """Imagines the first half of what the expert would do, and no more."""

    name = "half-way"

    def __init__(self) -> None:
        self._private = OracleRenderer()

    def set_state(self, episode: Episode, state: SimulatorState) -> None:
        self._private.set_state(episode, state)

    def generate(self, request: Request, out: Path) -> Path:
        return self._private.write_clip(partial(_first_half, find_expert(request.task)), request, out)

    def close(self) -> None:
        self._private.close()


def _first_half(expert: Expert, scene: Scene) -> Sequence[Waypoint]:
    moves = expert(scene)
    *begun, last = moves[: max(1, len(moves) // 2)]
    return [*begun, replace(last, through=False)]


class _Worker:
    """Runs cases."""

    def __init__(self) -> None:
        plant = ArmPlant()
        self._analyzer = _ForgetfulAnalyzer(RobotOptions())
        self._hand = SimulatorCache(_SlackStage, _SIZE_PX)
        commander, options = CommandPlanner(plant), LoopOptions(rounds=1, pixels_only=True)
        make: Any = partial(ClosedLoop, self._analyzer.ground, commander)
        self._plain, self._half = make(OracleModel(), options), make(_HalfWay(), options)
        self._faulty = [make(OracleModel(fault=fault), options) for fault in FAULTS]

    def __call__(self, case: Case) -> Finding:
        episode = case.draw.episode()
        stage = self._hand.get(episode.task, episode.variant)
        rng = generator("causes", episode.id, case.planted.name)
        length = float(rng.uniform(*LOST_SHARE))
        self._analyzer.share = (
            (float(rng.uniform(0.05, 1.0 - length)), length) if case.planted is Planted.READING else None
        )
        stage.slack_rad = SLACK_RAD if case.planted is Planted.ROBOT and case.number % 2 == 0 else 0.0
        stage.stuck = case.planted is Planted.ROBOT and case.number % 2 == 1
        loop = {Planted.VIDEO: self._faulty[case.number % len(FAULTS)], Planted.PLAN: self._half}.get(
            case.planted, self._plain
        )
        with TemporaryDirectory() as folder:
            try:
                run = loop.run(stage, episode, Path(folder) / episode.id)
            except InputError as error:  # the expert finds no path, the clip has no place for the fault
                return Finding(case=case, verdict=None, text=str(error))
        cause = find_cause(run, [self._analyzer.judge(r.grounded.track) for r in run.rounds])
        return Finding(
            case=case,
            verdict=None if cause is None else cause.verdict,
            text="succeeded all the same" if cause is None else cause.text,
        )


@dataclass(frozen=True, slots=True)
class _Make:
    """Makes a worker in each process."""

    def __call__(self) -> Callable[[Case], Finding]:
        return _Worker()


def cases(draws: Sequence[EpisodeSpec]) -> list[Case]:
    """Each cause on each of some episodes."""
    return [Case(draw=draw, planted=planted, number=i) for i, draw in enumerate(draws) for planted in Planted]


def run_cases(engine: Executor, todo: Sequence[Case]) -> Iterator[Finding]:
    """Run cases, in any order.

    Raises:
        KinebenchError: a worker died.
    """
    for done in engine.run(_Make(), list(todo)):
        if isinstance(done, WorkerCrash):
            raise KinebenchError(f"{done.item.draw.id}: {done.reason}")
        yield done.result


def finding_lines(findings: Sequence[Finding]) -> Iterator[str]:
    """Verdicts beside the planted causes, to print."""
    failed = [f for f in findings if f.verdict is not None]
    yield f"{'planted in':12}{'failed':>8}{'right':>8}   verdicts"
    for planted in Planted:
        own = [f for f in failed if f.case.planted is planted]
        told = Counter(f.verdict.value for f in own if f.verdict)
        right = sum(f.verdict is planted.value for f in own)
        named = ", ".join(f"{name} {n}" for name, n in told.most_common())
        yield f"{planted.name.lower():12}{len(own):8}{right:8}   {named}"
    right = sum(f.verdict is f.case.planted.value for f in failed)
    yield f"{'all':12}{len(failed):8}{right:8}   {right / max(len(failed), 1):.1%}"
    for f in failed:
        if f.verdict is not f.case.planted.value:
            said = "" if f.verdict is None else f.verdict.value
            yield f"  {f.case.draw.id}, planted in {f.case.planted.name.lower()}: {said}, {f.text}"
