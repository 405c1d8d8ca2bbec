"""Evaluation of one sample: the boundary that turns every failure into a row."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import KinebenchError, SetupError, UnmeasurableError, name_options, one_line
from kinebench_drake.io.jsonl import Json, as_object
from kinebench_drake.metrics.trust import TRUST, assess_trust
from kinebench_drake.results.inputs import describe_period
from kinebench_drake.results.provenance import code_hash
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.runs.config import RunConfig

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.kinematic_result import KinematicResult

ANOMALIES_OPEN = "anomalies_open"
"""Key of a row with the kinds of anomaly of which it is open whether they occur."""
PENDING = "pending"
"""Key of a row with the manifest's row of the video that it waits for."""
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
"""Metrics of every judged row; null where not measurable."""


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
class Evaluation:
    """Results of one measurable sample."""

    kinematics: "KinematicResult | None"
    """Verdict and metrics of the track; None where kinematics is not judged."""
    agreed: "KinematicResult | None" = None
    """Where it is not: the verdict that holds with every camera that may be right; None if it depends on the camera."""
    metrics: Mapping[str, Json] = field(default_factory=dict)
    """Metrics besides those of the kinematics."""
    extra: Mapping[str, Json] = field(default_factory=dict)
    """Further keys of the row."""
    video: str | None = None
    """Name of the video where it differs from the sample's."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Why metrics besides those of the kinematics are null, by name; where kinematics is not judged, that of all others
    by ""."""
    tracked: NDArray[np.bool_] | None = None
    """(T,) frames with a pose in the camera frame, where the run judges but there is no base frame to judge in."""
    unmeasurable: str | None = None
    """Reason why the sample cannot be measured, where the row still has further keys."""


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
    def evaluate(self, sample: SampleT, resources: ResourcesT) -> Evaluation:
        """Read the sample, measure it, write its artifacts.

        Raises:
            InputError: the sample is broken.
            UnmeasurableError: it is sound, but cannot be measured.
            SetupError: something is missing on this machine, or the disk is full.
        """

    def files_of(self, row: SampleRow) -> Sequence[Path]:
        """Return the files without which a stored row is not valid: of a sample of status ok one of each artifact."""
        artifacts = self.artifacts if row.status is Status.OK else ()
        return [artifact_path(self.config.out, name, row.id) for name in artifacts]

    def failed_row(self, sample: SampleT, status: Status, reason: str, hashes: SampleHashes) -> SampleRow:
        """Return the row of a sample without results: every metric is null."""
        row = self._ok_row(sample, Evaluation(kinematics=None), hashes)
        return replace(row, status=status, reason=one_line(name_options(reason)), null_reasons={})

    def row(self, sample: SampleT, resources: ResourcesT, hashes: SampleHashes) -> SampleRow:
        """Evaluate a sample; any failure but a SetupError ends here and becomes its row."""
        return self.row_of(sample, lambda: self.evaluate(sample, resources), hashes)

    def row_of(self, sample: SampleT, evaluate: Callable[[], Evaluation], hashes: SampleHashes) -> SampleRow:
        """Return the row of an evaluation; any failure of it but a SetupError becomes the row."""
        try:
            evaluation = evaluate()
            row = self._ok_row(sample, evaluation, hashes)
            if evaluation.unmeasurable is None:
                return row
            reason = one_line(name_options(evaluation.unmeasurable))
            return replace(row, status=Status.UNMEASURABLE, reason=reason, null_reasons={})
        except SetupError:
            raise
        except UnmeasurableError as error:
            return self.failed_row(sample, Status.UNMEASURABLE, str(error), hashes)
        except KinebenchError as error:
            return self.failed_row(sample, Status.ERROR, str(error), hashes)
        except Exception as error:
            reason = f"unexpected {type(error).__name__}: {error}"
            return self.failed_row(sample, Status.ERROR, reason, hashes)

    def _ok_row(self, sample: SampleT, evaluation: Evaluation, hashes: SampleHashes) -> SampleRow:
        kinematics = evaluation.kinematics
        verdict = evaluation.kinematics or evaluation.agreed
        metrics = {
            **dict.fromkeys(self.metric_names),
            **evaluation.metrics,
            **(kinematics.metrics if kinematics else {}),
        }
        executable, obstacles = judge_evaluation(evaluation)
        extra = {**self.labels(sample), "input_sha256": hashes.input, **evaluation.extra}
        if "domain" in extra:  # a video was grounded
            trust = assess_trust(extra, metrics, describe_period(extra), is_measured=evaluation.unmeasurable is None)
            extra[TRUST] = trust.to_json()
        return SampleRow(
            id=sample.id,
            video=evaluation.video or sample.video,
            task=sample.task,
            model=sample.model,
            status=Status.OK,
            reason=None,
            content_hash=hashes.content,
            feasible=verdict.feasible if verdict else None,
            executable=executable,
            executable_reasons=obstacles,
            violations=tuple(v.to_json() for v in verdict.violations) if verdict else (),
            metrics=metrics,
            null_reasons=_null_reasons(metrics, evaluation),
            details=dict(kinematics.details) if kinematics else {},
            extra=extra,
        )


def judge_evaluation(evaluation: Evaluation) -> tuple[bool | None, tuple[str, ...]]:
    """Return whether the sample can be executed, and why not or why it is open; None and () if the run does not judge.

    Bridges count in videos alone: of a trajectory every frame is expected.
    """
    kinematics = evaluation.kinematics or evaluation.agreed
    anomalies = evaluation.metrics.get("anomalies")
    tracked = kinematics.track.tracked if kinematics else evaluation.tracked
    if tracked is None:
        return None, ()
    from kinebench_drake.metrics.executable import judge_evidence

    lost = ~tracked
    faults = []
    if isinstance(anomalies, list):
        faults = list(map(as_object, anomalies))
        if kinematics:
            lost &= kinematics.curves["bridged"] == 0.0
    open_kinds = evaluation.extra.get(ANOMALIES_OPEN)
    return judge_evidence(
        kinematics.feasible if kinematics else None,
        int(lost.sum()),
        faults,
        kinematics.unchecked if kinematics else (),
        [str(kind) for kind in open_kinds] if isinstance(open_kinds, list) else [],
    )


def _null_reasons(metrics: Mapping[str, Json], evaluation: Evaluation) -> dict[str, str]:
    """Return why each null metric is null, in the metrics' order."""
    kinematics = evaluation.kinematics
    others = evaluation.reasons
    stated = {**others, **(kinematics.reasons if kinematics else {})}
    reasons = {}
    for name, value in metrics.items():
        if value is None:
            reasons[name] = stated.get(name) or stated.get("") or "cannot be measured on this sample"
        elif isinstance(value, float) and not math.isfinite(value):
            reasons[name] = stated.get(name) or f"came out as {value}"
    if "feasible" in others and kinematics is None and evaluation.agreed is None:
        reasons["feasible"] = others["feasible"]
    if kinematics and kinematics.feasible is None:
        reasons["feasible"] = stated.get("feasible", "cannot be measured on this sample")
    return reasons
