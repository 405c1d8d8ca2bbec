"""Oracles that are wrong on purpose, as world models: `--world-model 'benchmarks.faults.oracle:FaultyOracle?...'`."""

from typing import cast

from typing_extensions import override

from benchmarks.faults.fault import GRADES, FaultGrade
from benchmarks.faults.fault_simulator import FaultSimulator
from benchmarks.faults.plant import plant
from benchmarks.faults.recording import Recording
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import member_of
from kinebench_drake.suites.rollout import Rollout, RolloutVideo
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.worldmodels.reference import OracleModel
from kinebench_drake.suites.worldmodels.worldmodel import Request


class FaultyOracle(OracleModel):
    """Oracle with a fault planted into the first clip of each episode, in the first form of its kind.

    Args:
        kind: kind of the fault, such as "teleport".
        size: its size in the unit of `PlantedFault.size`.
    """

    simulator = FaultSimulator

    def __init__(self, kind: str, size: str | float) -> None:
        own = member_of(AnomalyKind, kind, "kind")
        self._fault = FaultGrade(kind=own, size=float(size), form=GRADES[own].forms[0])
        super().__init__(f"oracle, {self._fault.label}")

    @override
    def film(self, simulator: Simulator, rollout: Rollout, request: Request) -> RolloutVideo:
        video = super().film(simulator, rollout, request)
        if request.round > 0 or not len(rollout.controls):
            return video
        recording = Recording(simulator=cast(FaultSimulator, simulator), rollout=rollout, video=video)
        return plant(recording, self._fault)[0]
