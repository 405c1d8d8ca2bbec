"""Episodes with one planted cause of failure, to validate the attribution.

Each cause is planted where it acts: in the video (the oracle with a fault), in the grounding (poses removed), in the
robot (a servo with an offset, or fingers that do not move), or in the plan (the expert stops half-way). Only episodes
that fail have a verdict; those that succeed in spite of the cause are not counted.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from benchmarks.faults.fault import FaultGrade
from benchmarks.faults.oracle import FaultyOracle
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.grounding.priors import Clip
from kinebench_drake.grounding.video import Grounder
from kinebench_drake.grounding.video_result import GroundingResult
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.executable import FailureVerdict
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.closed_loop.attribution import find_cause
from kinebench_drake.suites.closed_loop.execution import CommandPlanner
from kinebench_drake.suites.closed_loop.loop import ClosedLoop, LoopOptions
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.registry import Expert, find_expert
from kinebench_drake.suites.families.task import Scene
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator, SimulatorState
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.worldmodels.reference import OracleModel, OracleRenderer
from kinebench_drake.suites.worldmodels.worldmodel import Request
from kinebench_drake.track import GripperTrack

FAULTS = (
    FaultGrade(kind=AnomalyKind.TELEPORT, size=0.15, form=None),
    FaultGrade(kind=AnomalyKind.VANISH, size=10, form=None),
    FaultGrade(kind=AnomalyKind.FREEZE, size=8, form=None),
)
"""Faults of the video, in turn: those that change the gripper's path, so that episodes fail by them."""
LOST_SHARE = (0.3, 0.7)
"""Range of the share of consecutive frames that the grounding loses."""
SERVO_OFFSET_RAD = 0.2
"""Offset of the first joint's servo [rad]."""
_SIZE_PX = 384


class PlantedCause(Enum):
    """Place of the cause, with the verdict that should name it."""

    READING = FailureVerdict.GROUNDING
    VIDEO = FailureVerdict.GENERATION
    ROBOT = FailureVerdict.EXECUTION
    PLAN = FailureVerdict.TASK


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseCase:
    """One episode with one cause."""

    spec: EpisodeSpec
    planted: PlantedCause
    number: int
    """Number of the episode; selects the variant of the cause."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseResult:
    """Verdict on a case."""

    case: CauseCase
    verdict: FailureVerdict | None
    """None if the episode succeeded or could not be run."""
    text: str
    """Explanation of the verdict, or why there is none."""


class _LossyGrounder(Grounder):
    """A grounding that loses the gripper in consecutive frames."""

    lost: tuple[float, float] | None = None
    """First lost frame and number of lost frames, as shares of the clip."""

    @override
    def ground(self, clip: Clip, *arguments: Any, **options: Any) -> GroundingResult:
        result = super().ground(clip, *arguments, **options)
        if self.lost is None:
            return result
        start, length = (round(part * len(clip.frames)) for part in self.lost)
        track = _without(result.measured.track, slice(start, start + length))
        return replace(result, measured=replace(result.measured, track=track))


def _without(track: GripperTrack, lost: slice) -> GripperTrack:
    kept = np.ones(len(track.t_s), dtype=bool)
    kept[lost] = False
    return replace(
        track,
        X_CH=np.where(kept[:, None, None], track.X_CH, np.nan),
        X_BG=np.where(kept[:, None, None], track.X_BG, np.nan),
        finger_width_m=np.where(kept, track.finger_width_m, np.nan),
        tracked=track.tracked & kept,
        confidence=np.where(kept, track.confidence, 0.0),
    )


class _FaultyRobot(Simulator):
    """A simulator whose robot does not execute the commands exactly."""

    servo_offset_rad = 0.0
    fingers_stuck = False

    @override
    def step(self, q: ArrayLike, finger_width_m: float) -> None:
        off = np.asarray(q, dtype=np.float64) + self.servo_offset_rad * (np.arange(7) == 0)
        width = self.snapshot().finger_width_m if self.fingers_stuck else finger_width_m
        super().step(np.clip(off, *self.joint_limits), width)


class _HalfWayModel:
    """A world model that renders the first half of the expert's plan."""

    name = "half-way"

    def __init__(self) -> None:
        self._renderer = OracleRenderer()

    def set_state(self, episode: Episode, state: SimulatorState) -> None:
        self._renderer.set_state(episode, state)

    def generate(self, request: Request, out: Path) -> Path:
        return self._renderer.write_clip(partial(_first_half, find_expert(request.task)), request, out)

    def close(self) -> None:
        self._renderer.close()


def _first_half(expert: Expert, scene: Scene) -> Sequence[Waypoint]:
    moves = expert(scene)
    *begun, last = moves[: max(1, len(moves) // 2)]
    return [*begun, replace(last, through=False)]


class CauseWorker:
    """Runs cases."""

    def __init__(self) -> None:
        self._grounder = _LossyGrounder()
        self._tools = Resources(RobotOptions())
        self._simulators = SimulatorCache(_FaultyRobot, _SIZE_PX)
        options = LoopOptions(rounds=1, pixels_only=True)
        make: Any = partial(ClosedLoop, self._grounder, CommandPlanner(ArmPlant()))
        self._plain = make(OracleModel(), options)
        self._half = make(_HalfWayModel(), options)
        self._faulty = [make(FaultyOracle(fault.kind.value, fault.size), options) for fault in FAULTS]

    def __call__(self, case: CauseCase) -> CauseResult:
        """Run one case."""
        episode = case.spec.episode()
        simulator = self._simulators.get(episode.task, episode.variant)
        rng = generator("causes", episode.id, case.planted.name)
        length = float(rng.uniform(*LOST_SHARE))
        self._grounder.lost = (
            (float(rng.uniform(0.05, 1.0 - length)), length) if case.planted is PlantedCause.READING else None
        )
        robot = case.planted is PlantedCause.ROBOT
        simulator.servo_offset_rad = SERVO_OFFSET_RAD if robot and case.number % 2 == 0 else 0.0
        simulator.fingers_stuck = robot and case.number % 2 == 1
        loop = {PlantedCause.VIDEO: self._faulty[case.number % len(FAULTS)], PlantedCause.PLAN: self._half}.get(
            case.planted, self._plain
        )
        with TemporaryDirectory() as folder:
            try:
                run = loop.run(simulator, episode, Path(folder) / episode.id)
            except InputError as error:  # the expert has no path, the clip no place for the fault
                return CauseResult(case=case, verdict=None, text=str(error))
        cause = find_cause(run, [self._tools.judge(r.grounding.track) for r in run.rounds])
        return CauseResult(
            case=case,
            verdict=None if cause is None else FailureVerdict(cause.verdict),
            text="succeeded in spite of the cause" if cause is None else cause.text,
        )


def cause_cases(specs: Sequence[EpisodeSpec]) -> list[CauseCase]:
    """Return each cause on each episode."""
    return [CauseCase(spec=spec, planted=planted, number=i) for i, spec in enumerate(specs) for planted in PlantedCause]


def cause_table(results: Sequence[CauseResult]) -> Iterator[str]:
    """Yield the lines of a table of verdicts by planted cause, then the wrong verdicts."""
    failed = [r for r in results if r.verdict is not None]
    yield f"{'planted in':12}{'failed':>8}{'right':>8}   verdicts"
    for planted in PlantedCause:
        own = [r for r in failed if r.case.planted is planted]
        verdicts = Counter(r.verdict.value for r in own if r.verdict)
        right = sum(r.verdict is planted.value for r in own)
        names = ", ".join(f"{name} {n}" for name, n in verdicts.most_common())
        yield f"{planted.name.lower():12}{len(own):8}{right:8}   {names}"
    right = sum(r.verdict is r.case.planted.value for r in failed)
    yield f"{'all':12}{len(failed):8}{right:8}   {right / max(len(failed), 1):.1%}"
    for r in failed:
        if r.verdict is not None and r.verdict is not r.case.planted.value:
            yield f"  {r.case.spec.id}, planted in {r.case.planted.name.lower()}: {r.verdict.value}, {r.text}"
