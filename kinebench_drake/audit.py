"""Trajectories to kinematic metrics to an output folder, no video."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.measure import Kind
from kinebench_drake.models.arm import choose_robot
from kinebench_drake.row import Json, SampleRow
from kinebench_drake.run import Observer, RunConfig, RunSummary, Silence, run_samples
from kinebench_drake.stages import StageOptions
from kinebench_drake.trajectories.source import find_trajectories
from kinebench_drake.trajectories.trajectory import Choice
from kinebench_drake.trajectory_measure import TrajectoryMeasure

_MOST_WARNINGS = 5  # told on the screen


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditConfig(RunConfig):
    """Everything a run over trajectories is told. `source`: file, LeRobot dataset, output folder or folder of these."""

    source: Path
    """Trajectory, folder of trajectories, or dataset."""
    task: str | None = None
    """Task of samples that name none."""
    kind: Kind = Kind.AUDIT
    rate_hz: float | None = None
    """Frames per second, over the files' times [Hz]."""
    joints: str | None = None
    """Name of the array, data set or column that holds the joint angles."""
    poses: str | None = None
    """Name of the array or column that holds the poses of the TCP."""
    urdf: Path | None = None
    """The robot's URDF; None for mani_skill's Panda."""
    tcp_frame: str | None = None
    """Name of the URDF's TCP frame."""
    robot_remarks: tuple[str, ...] = ()
    """What was assumed or left out when the URDF was read; `audit_trajectories` fills it in."""

    def __post_init__(self) -> None:
        """Check the numbers and names.

        Raises:
            UsageError: one of them makes no sense.
        """
        RunConfig.__post_init__(self)
        self.choice()

    def choice(self) -> Choice:
        """What the user says about the data.

        Raises:
            UsageError: it cannot be used.
        """
        return Choice(rate_hz=self.rate_hz, joints=self.joints, poses=self.poses)

    def stage_options(self) -> StageOptions:
        """What the stages are told.

        Raises:
            UsageError: it cannot be used.
        """
        return StageOptions(table_height_m=self.table_height_m, urdf=self.urdf, tcp_frame=self.tcp_frame)

    def to_json(self) -> dict[str, Json]:
        """What results tell of the configuration; paths by their last name only."""
        return {
            **RunConfig.to_json(self),
            "source": self.source.resolve().name,
            "task": self.task,
            "rate_hz": self.rate_hz,
            "joints": self.joints,
            "poses": self.poses,
            "robot": self.urdf.name if self.urdf else None,
            "tcp_frame": self.tcp_frame,
            "robot_remarks": list(self.robot_remarks),
        }


def audit_trajectories(config: AuditConfig, observer: Observer | None = None) -> RunSummary:
    """Judge every trajectory of `config.source` and fill the output folder.

    Raises:
        UsageError: the configuration, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.
    """
    observer = observer or Silence()
    samples = find_trajectories(config.source, config.choice(), out=config.out, model=config.model, task=config.task)
    if config.urdf is not None:
        remarks = robot_remarks(config.urdf, config.tcp_frame)
        for remark in remarks:
            observer.warned(f"{config.urdf.name}: {remark}")
        config = replace(config, robot_remarks=remarks)
    measure = TrajectoryMeasure(
        kind=config.kind,
        out=config.out,
        stages=config.stages,
        stage_options=config.stage_options(),
        choice=config.choice(),
    )
    summary = run_samples(config, samples, measure, observer)
    warnings = _warnings(summary.rows)
    for text, ids in list(warnings.items())[:_MOST_WARNINGS]:
        observer.warned(f"{ids[0]}: {text}" + (f" (and {len(ids) - 1} more)" if ids[1:] else ""))
    if len(warnings) > _MOST_WARNINGS:
        observer.warned(f"{len(warnings) - _MOST_WARNINGS} more kinds of warnings; the rows have them all")
    return summary


def robot_remarks(urdf: Path, tcp_frame: str | None) -> tuple[str, ...]:
    """What was assumed or left out when a robot's URDF was read.

    Raises:
        UsageError: the robot cannot be used.
    """
    try:
        return choose_robot(urdf, tcp_frame).remarks
    except InputError as error:
        raise UsageError(f"--robot and --tcp-frame: {error}") from None


def _warnings(rows: Sequence[SampleRow]) -> dict[str, list[str]]:
    """What rows warn of, with the ids of those that do."""
    found: dict[str, list[str]] = {}
    for row in rows:
        texts = row.extra.get("warnings")
        for text in texts if isinstance(texts, list) else ():
            found.setdefault(str(text), []).append(row.id)
    return found
