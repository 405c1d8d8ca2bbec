"""What is done to one sample, whatever it is: the boundary where its failures end, and the row that sums it up."""

import hashlib
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from kinebench_drake.errors import KinebenchError, SetupError, UnmeasurableError, one_line
from kinebench_drake.evaluation.stages import Judgement, RobotOptions
from kinebench_drake.executors.base import SupportsClose
from kinebench_drake.io.files import open_file
from kinebench_drake.io.jsonl import dump, finite
from kinebench_drake.models.urdf import robot_files
from kinebench_drake.results.provenance import code_hash
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.types import Json

SCHEMA_VERSION = 1

KINEMATIC_METRICS = (
    *("sparc", "sparc_rotation", "ldlj", "manipulability_mean", "manipulability_min", "manipulability_integral"),
    *("manipulability_cost_mean", "ik_success_rate", "ik_position_error_max_m", "joint_limit_margin_min"),
    *("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "time_scale"),
    *("slowdown_min", "trajopt_feasible", "trajopt_position_tube_m", "self_distance_min_m", "table_distance_min_m"),
)
"""Names every judged row bears; null where there is nothing to measure."""

MIN_TRACKED = 2
"""Frames whose pose must be known: a path needs two poses."""


class RunKind(Enum):
    """What a run does with its samples."""

    SCORE = "score"
    GROUND = "ground"
    AUDIT = "audit"
    SUITE = "suite"

    @property
    def noun(self) -> str:
        """What its samples are, in the plural."""
        return {RunKind.AUDIT: "trajectories", RunKind.SUITE: "episodes"}.get(self, "videos")

    @property
    def judges(self) -> bool:
        """Whether tracks are held against the robot."""
        return self is not RunKind.GROUND


class SampleInfo(Protocol):
    """What every sample tells about itself."""

    @property
    def id(self) -> str:
        """Unique, safe as a file name."""
        ...

    @property
    def video(self) -> str:
        """What the sample is taken from, as results name it."""
        ...

    @property
    def task(self) -> str | None:
        """The task shown."""
        ...

    @property
    def model(self) -> str | None:
        """Who made it."""
        ...


SampleT = TypeVar("SampleT", bound=SampleInfo)
ResourcesT = TypeVar("ResourcesT")
"""What a worker process loads once to measure samples with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """What came of a sample that could be measured."""

    judgement: Judgement | None
    """None where nothing was asked of the robot."""
    metrics: Mapping[str, Json] = field(default_factory=dict)
    """Metrics besides the judgement's."""
    extra: Mapping[str, Json] = field(default_factory=dict)
    """Further keys of the row."""
    video: str | None = None
    """The video, where it is known only now; None where the sample names it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluator(ABC, Generic[SampleT, ResourcesT]):
    """How samples of one run are measured; picklable. `make` turns it into the function a worker calls."""

    kind: RunKind
    out: Path
    stages: str
    """Import path of the `Stages`."""
    stage_options: RobotOptions
    code: str = field(default_factory=code_hash)
    """SHA-256 of the program's sources when the run began; workers take it over."""

    @property
    @abstractmethod
    def metric_names(self) -> tuple[str, ...]:
        """Metrics that every row of the run bears."""

    @property
    @abstractmethod
    def parts(self) -> tuple[str, ...]:
        """Files that every sample with status ok has: "tracks", "overlays"."""

    @abstractmethod
    def facts(self, sample: SampleT) -> Mapping[str, Json]:
        """All that a sample's row follows from, but the bytes of its files, the code and the robot."""

    @abstractmethod
    def files(self, sample: SampleT) -> Sequence[Path]:
        """The files that a sample is read from; none where it cannot be read."""

    @abstractmethod
    def labels(self, sample: SampleT) -> Mapping[str, Json]:
        """Further keys of the row that are known before the sample is read."""

    @abstractmethod
    def equip(self) -> ResourcesT:
        """Load what measuring takes; called once a process, and closed at its end if it can be.

        Raises:
            SetupError: a library, a driver or the weights are missing.
            UsageError: something that the command line named cannot be used.
        """

    @abstractmethod
    def measure(self, sample: SampleT, equipment: ResourcesT) -> Evaluation:
        """Read the sample, measure it, write its files.

        Raises:
            InputError: the sample is broken.
            UnmeasurableError: it is sound, but cannot be measured.
            SetupError: something is missing on this machine, or the disk is full.
        """

    def content_hash(self, sample: SampleT) -> str:
        """SHA-256 of all that a sample's row follows from: its files' bytes, labels, options, code and robot."""
        told: dict[str, Json] = {
            "schema": SCHEMA_VERSION,
            "kind": self.kind.value,
            "stages": self.stages,
            "code": self.code,
            "table_height_m": self.stage_options.table_height_m,
            "tcp_frame": self.stage_options.tcp_frame,
            "sample": [sample.id, sample.video, sample.task, sample.model],
            **self.facts(sample),
        }
        digest = hashlib.sha256(dump(finite(told)).encode())  # a hash is made of any sample, also of a broken one
        robot = self.stage_options.urdf
        for file in (*self.files(sample), *(robot_files(robot) if robot else ())):
            digest.update(file.name.encode(errors="surrogateescape") + b"\0" + _digest(file))
        return digest.hexdigest()

    def holds(self, sample: SampleT, row: SampleRow) -> bool:
        """Whether a kept row still is what comes of this sample."""
        needed = self.parts if row.status is Status.OK else ()
        return all(
            artifact_path(self.out, p, row.id).is_file() for p in needed
        ) and row.content_hash == self.content_hash(sample)

    def make(self) -> "SampleWorker[SampleT, ResourcesT]":
        """Load the equipment.

        Raises:
            SetupError: a library, a driver or the weights are missing.
            UsageError: something that the command line named cannot be used.
        """
        return SampleWorker(self, self.equip())

    def failed(self, sample: SampleT, status: Status, reason: str) -> SampleRow:
        """Row of a sample that came to nothing: every metric is null."""
        return SampleRow(
            id=sample.id,
            video=sample.video,
            task=sample.task,
            model=sample.model,
            status=status,
            reason=one_line(reason),
            content_hash=self.content_hash(sample),
            metrics=dict.fromkeys(self.metric_names),
            extra=self.labels(sample),
        )

    def row(self, sample: SampleT, equipment: ResourcesT) -> SampleRow:
        """The per-sample boundary: whatever goes wrong with a sample ends here, in its row."""
        try:
            return self._finished(sample, self.measure(sample, equipment))
        except SetupError:
            raise
        except UnmeasurableError as error:
            return self.failed(sample, Status.UNMEASURABLE, str(error))
        except KinebenchError as error:
            return self.failed(sample, Status.ERROR, str(error))
        except Exception as error:
            return self.failed(sample, Status.ERROR, f"unexpected {type(error).__name__}: {error}")

    def _finished(self, sample: SampleT, found: Evaluation) -> SampleRow:
        judgement = found.judgement
        metrics = {**dict.fromkeys(self.metric_names), **found.metrics, **(judgement.metrics if judgement else {})}
        return SampleRow(
            id=sample.id,
            video=found.video or sample.video,
            task=sample.task,
            model=sample.model,
            status=Status.OK,
            reason=None,
            content_hash=self.content_hash(sample),
            feasible=judgement.feasible if judgement else None,
            violations=judgement.violations if judgement else (),
            metrics=metrics,
            null_reasons=_null_reasons(metrics, judgement),
            details=judgement.details if judgement else {},
            extra={**found.extra, **self.labels(sample)},
        )


@dataclass(frozen=True, slots=True)
class SampleWorker(Generic[SampleT, ResourcesT]):
    """What one process measures samples with."""

    measure: Evaluator[SampleT, ResourcesT]
    equipment: ResourcesT

    def __call__(self, sample: SampleT) -> tuple[SampleRow, float]:
        """A sample's row and the seconds it took."""
        start = time.perf_counter()
        return self.measure.row(sample, self.equipment), time.perf_counter() - start

    def close(self) -> None:
        """Free the equipment."""
        if isinstance(self.equipment, SupportsClose):
            self.equipment.close()


def _null_reasons(metrics: Mapping[str, Json], judgement: Judgement | None) -> dict[str, str]:
    """Why each null metric is null, in the metrics' order."""
    reasons = {}
    for name, value in metrics.items():
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            given = judgement.reasons.get(name) if judgement else None
            unsaid = "cannot be told from this sample" if value is None else f"came out as {value}"
            reasons[name] = given or unsaid
    if judgement and judgement.feasible is None:
        reasons["feasible"] = judgement.reasons.get("feasible", "cannot be told from this sample")
    return reasons


def _digest(file: Path) -> bytes:
    """SHA-256 of a file's bytes; many samples may share one file, which is then read once."""
    try:
        state = file.stat()
        return _digest_of(file, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
    except OSError as error:
        return f"unreadable: {error.strerror}".encode()


@lru_cache(maxsize=256)
def _digest_of(file: Path, *_state: int) -> bytes:
    with open_file(file) as data:
        return hashlib.file_digest(data, "sha256").digest()
