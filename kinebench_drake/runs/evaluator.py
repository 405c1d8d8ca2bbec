"""Evaluation of one sample: the boundary that turns every failure into a row."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly
from kinebench_drake.errors import KinebenchError, SetupError, UnmeasurableError, name_options, one_line
from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json
from kinebench_drake.metrics.trust import assess_trust
from kinebench_drake.results.inputs import describe_period
from kinebench_drake.results.provenance import code_hash
from kinebench_drake.results.row import Metrics, MetricValue, SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.runs.config import RunConfig

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.kinematic_result import KinematicResult

KINEMATIC_METRICS = (
    *("sparc", "sparc_rotation", "ldlj", "manipulability_mean", "manipulability_min", "manipulability_integral"),
    *("manipulability_cost_mean", "ik_success_rate", "ik_position_error_max_m", "joint_limit_margin_min"),
    *("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "time_scale"),
    *(
        "slowdown_min",
        "feasible_from_period_s",
        "path_length_m",
        "motionless",
        "trajopt_feasible",
        "trajopt_position_tube_m",
        "self_distance_min_m",
        "table_distance_min_m",
    ),
)
"""Metrics of every track that is judged; null where not measurable."""
EXECUTABILITY = "executability"
"""Metric of every judged row: the score of the motion, 0 to 1 (`metrics.executability`)."""


class SampleInfo(Protocol):
    """Fields common to all samples."""

    @property
    def id(self) -> str:
        """Unique id, safe as a file name."""
        ...

    @property
    def video(self) -> str:
        """Source of the sample as results name it."""
        ...

    @property
    def task(self) -> str | None:
        """Task name."""
        ...

    @property
    def model(self) -> str | None:
        """Name of the model that made the sample."""
        ...


SampleT = TypeVar("SampleT", bound=SampleInfo)
ResourcesT = TypeVar("ResourcesT")
"""Resources that a worker process loads once: networks, robot, simulator."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleHashes:
    """Hashes of a sample before it is evaluated."""

    content: str
    """SHA-256 of all that determines its row (`runs.resume`)."""
    input: str | None
    """SHA-256 of its input files; None without files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluator(ABC, Generic[SampleT, ResourcesT]):
    """Evaluation of the samples of one run; picklable, for worker processes."""

    config: RunConfig
    code: str = ""
    """SHA-256 of the measuring sources when the run began, shared by all workers."""
    robot_id: str = ""
    """`Robot.id` of the robot when the run began, likewise."""

    def __post_init__(self) -> None:
        """Hash the sources and the robot."""
        object.__setattr__(self, "code", self.code or code_hash(type(self).__module__))
        object.__setattr__(self, "robot_id", self.robot_id or self.config.robot_options().load().id)

    @property
    @abstractmethod
    def metric_names(self) -> tuple[str, ...]:
        """Metrics of every row of the run."""

    @property
    @abstractmethod
    def artifacts(self) -> tuple[str, ...]:
        """Folders in which every sample of status ok has a file: "tracks", "overlays", ..."""

    @abstractmethod
    def cache_key(self, sample: SampleT) -> Mapping[str, Json]:
        """Return the options and labels that determine the row, besides input files, code and robot."""

    @abstractmethod
    def input_files(self, sample: SampleT) -> Sequence[Path]:
        """Return the files that the sample is read from; none where it cannot be read."""

    @abstractmethod
    def labels(self, sample: SampleT) -> Mapping[str, Json]:
        """Return further keys of the row that are defined before the sample is read."""

    def prepare(self, samples: Sequence[SampleT], warn: Callable[[str], None]) -> None:
        """Check once, before the first of the `samples` is evaluated, what all of them need; by default nothing.

        Raises:
            SetupError: none of them can succeed.
        """
        return

    @abstractmethod
    def setup(self) -> ResourcesT:
        """Load the resources; called once a process, and closed at its end if they have `close`.

        Raises:
            SetupError: a library, a driver or the weights are missing.
            UsageError: an option cannot be used.
        """

    @abstractmethod
    def evaluate(self, sample: SampleT, resources: ResourcesT, row: SampleRow) -> SampleRow:
        """Read the sample, measure it, write its artifacts, complete its blank `row`.

        Raises:
            InputError: the sample is broken.
            UnmeasurableError: it is sound, but cannot be measured.
            SetupError: something is missing on this machine, or the disk is full.
        """

    def files_of(self, row: SampleRow) -> Sequence[Path]:
        """Return the files without which a stored row is not valid: of a sample of status ok one of each artifact."""
        artifacts = self.artifacts if row.status is Status.OK else ()
        return [artifact_path(self.config.out, name, row.id) for name in artifacts]

    def blank_row(self, sample: SampleT, hashes: SampleHashes) -> SampleRow:
        """Return the row of a sample before it is evaluated: its labels, and every metric null."""
        row = SampleRow(
            id=sample.id,
            video=sample.video,
            task=sample.task,
            model=sample.model,
            status=Status.OK,
            reason=None,
            content_hash=hashes.content,
            metrics=Metrics(dict.fromkeys(self.metric_names)),
        )
        return row.extended(**self.labels(sample), input_sha256=hashes.input)

    def row(self, sample: SampleT, resources: ResourcesT, hashes: SampleHashes) -> SampleRow:
        """Evaluate a sample; any failure but a SetupError becomes its row."""
        return complete_row(self.blank_row(sample, hashes), lambda row: self.evaluate(sample, resources, row))


def complete_row(blank: SampleRow, evaluate: Callable[[SampleRow], SampleRow]) -> SampleRow:
    """Evaluate the sample of a blank row; any failure but a SetupError ends here and becomes the row."""
    try:
        row = evaluate(blank)
        if row.domain is None:
            return row
        trust = assess_trust(row, describe_period(row), is_measured=row.status is Status.OK)
        return row.extended(trust=trust)
    except SetupError:
        raise
    except UnmeasurableError as error:
        return fail_row(blank, Status.UNMEASURABLE, str(error))
    except KinebenchError as error:
        return fail_row(blank, Status.ERROR, str(error))
    except Exception as error:
        return fail_row(blank, Status.ERROR, f"unexpected {type(error).__name__}: {error}")


def fail_row(row: SampleRow, status: Status, reason: str) -> SampleRow:
    """Return the row with a status other than ok; its reason stands for those of its null metrics."""
    return replace(row, status=status, reason=one_line(name_options(reason)), null_reasons={})


def judge_row(
    row: SampleRow,
    kinematics: "KinematicResult | None",
    *,
    agreed: "KinematicResult | None" = None,
    reasons: Mapping[str, str] = MappingProxyType({}),
    tracked: NDArray[np.bool_] | None = None,
    curves: Mapping[str, Array] = MappingProxyType({}),
) -> SampleRow:
    """Return a row, whose other metrics are measured, with the verdict on the motion and the metrics behind it.

    Args:
        kinematics: verdict and metrics of the track; None where kinematics is not judged.
        agreed: where it is not: the verdict that holds with every camera that may be right.
        reasons: why metrics besides those of the kinematics are null, by name; where kinematics is not judged, that of
            all others by "".
        tracked: (T,) frames with a pose, where the run judges but there is no base frame to judge in.
        curves: curves of the grounding.
    """
    verdict = kinematics or agreed
    executable, obstacles = judge_execution(verdict, row.metrics.anomalies, row.anomalies_open or (), tracked)
    details: dict[str, Json] = {}
    if kinematics:
        from kinebench_drake.metrics.executability import gather_faults, rate_faults

        faults = gather_faults(kinematics, curves)
        rating = rate_faults(faults) if faults else None
        row = row.measured({**kinematics.metrics, EXECUTABILITY: rating.score if rating else None})
        details = {**kinematics.details, EXECUTABILITY: dict(rating.terms) if rating else None}
    return replace(
        row,
        feasible=verdict.feasible if verdict else None,
        executable=executable,
        executable_reasons=obstacles,
        violations=verdict.violations if verdict else (),
        null_reasons=_null_reasons(row.metrics, reasons, kinematics, is_judged=verdict is not None),
        details=details,
    )


def judge_execution(
    verdict: "KinematicResult | None",
    anomalies: Sequence[Anomaly] | None,
    open_kinds: Sequence[str] = (),
    tracked: NDArray[np.bool_] | None = None,
) -> tuple[bool | None, tuple[str, ...]]:
    """Return whether the sample can be executed, and why not or why it is open; None and () if the run does not judge.

    Bridges count in videos alone, which have `anomalies`: of a trajectory every frame is expected. Without a verdict
    the frames with a pose are `tracked` (T,).
    """
    tracked = verdict.track.tracked if verdict else tracked
    if tracked is None:
        return None, ()
    from kinebench_drake.metrics.executable import judge_evidence

    lost = ~tracked
    if verdict and anomalies is not None:
        lost &= verdict.curves["bridged"] == 0.0
    feasible = verdict.feasible if verdict else None
    unchecked = verdict.unchecked if verdict else ()
    return judge_evidence(feasible, int(lost.sum()), anomalies or (), unchecked, open_kinds)


def _null_reasons(
    metrics: Mapping[str, MetricValue],
    others: Mapping[str, str],
    kinematics: "KinematicResult | None",
    *,
    is_judged: bool,
) -> dict[str, str]:
    """Return why each null metric is null, in the metrics' order, and why the verdict on the motion is open."""
    stated = {**others, **(kinematics.reasons if kinematics else {})}
    reasons = {}
    for name, value in metrics.items():
        if value is None:
            reasons[name] = stated.get(name) or stated.get("") or "unmeasurable on this sample"
        elif isinstance(value, float) and not math.isfinite(value):
            reasons[name] = stated.get(name) or f"came out as {value}"
    if "feasible" in others and not is_judged:
        reasons["feasible"] = others["feasible"]
    if kinematics and kinematics.feasible is None:
        reasons["feasible"] = stated.get("feasible", "unmeasurable on this sample")
    return reasons
