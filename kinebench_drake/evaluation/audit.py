"""Trajectories to kinematic metrics to an output folder, no video."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinebench_drake.datasets.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.datasets.trajectories.trajectory import Trajectory, TrajectoryOptions, TrajectorySample
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.evaluation.evaluator import KINEMATIC_METRICS, Evaluation, Evaluator, RunKind
from kinebench_drake.evaluation.runner import NullRunObserver, RunConfig, RunObserver, RunSummary, run_samples
from kinebench_drake.evaluation.stages import Judgement, RobotOptions, Stages, load_stages
from kinebench_drake.models.arm import choose_robot
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.types import GripperTrack, Json


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryEvaluator(Evaluator[TrajectorySample, Stages]):
    """How the trajectories of one run are measured."""

    choice: TrajectoryOptions
    """What the user says about the data."""

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `Measure`."""
        return KINEMATIC_METRICS

    @property
    def parts(self) -> tuple[str, ...]:
        """See `Measure`."""
        return ("tracks",)

    def facts(self, sample: TrajectorySample) -> Mapping[str, Json]:
        """See `Measure`."""
        return {
            "choice": [self.choice.rate_hz, self.choice.joints, self.choice.poses],
            "labels": [sample.seed, sample.prompt, sample.success, sample.rate_hz, sample.warnings, sample.problem],
            "part": [sample.format.value, sample.part],
        }

    def files(self, sample: TrajectorySample) -> Sequence[Path]:
        """See `Measure`."""
        return () if sample.problem is not None else (sample.path, *sample.about)

    def labels(self, sample: TrajectorySample) -> Mapping[str, Json]:
        """See `Measure`."""
        told = {} if sample.success is None else {"success": sample.success}
        return {"format": sample.format.value, "seed": sample.seed, "prompt": sample.prompt, **told}

    def equip(self) -> Stages:
        """See `Measure`."""
        return load_stages(self.stages, self.stage_options)

    def measure(self, sample: TrajectorySample, stages: Stages) -> Evaluation:
        """See `Measure`."""
        trajectory = read_trajectory(sample, self.choice)
        judgement = judge_trajectory(stages, trajectory)
        write_track(artifact_path(self.out, "tracks", sample.id), judgement.track, judgement.joints, judgement.curves)
        return Evaluation(
            judgement=judgement,
            extra={
                "frames": len(trajectory.t_s),
                "frames_tracked": int(trajectory.tracked.sum()),
                "duration_s": float(trajectory.t_s[-1] - trajectory.t_s[0]),
                "frame_period_s": float(np.median(np.diff(trajectory.t_s))),
                "judged": "poses" if trajectory.q is None else "joints",
                "columns": trajectory.columns,
                "warnings": list(trajectory.warnings),
            },
        )


def judge_trajectory(stages: Stages, trajectory: Trajectory) -> Judgement:
    """Hold a trajectory against the robot: joint angles as they are, poses by the best joint path that does them."""
    if trajectory.q is not None:
        return stages.judge_joints(trajectory.t_s, trajectory.q, trajectory.finger_width_m)
    return stages.judge(gripper_track(trajectory))


def gripper_track(trajectory: Trajectory) -> GripperTrack:
    """The track of given poses: without a camera, and sure where it is tracked.

    Raises:
        InputError: the trajectory holds joint angles.
    """
    n = len(trajectory.t_s)
    nothing = np.full((n, 4, 4), np.nan)
    return GripperTrack(
        t_s=trajectory.t_s,
        X_CH=nothing,
        X_BG=nothing if trajectory.X_BG is None else trajectory.X_BG,
        tracked=trajectory.tracked,
        confidence=trajectory.tracked.astype(np.float64),
        finger_width_m=trajectory.finger_width_m,
    )


_MOST_WARNINGS = 5  # told on the screen


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditConfig(RunConfig):
    """Everything a run over trajectories is told. `source`: file, LeRobot dataset, output folder or folder of these."""

    source: Path
    """Trajectory, folder of trajectories, or dataset."""
    task: str | None = None
    """Task of samples that name none."""
    kind: RunKind = RunKind.AUDIT
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

    def choice(self) -> TrajectoryOptions:
        """What the user says about the data.

        Raises:
            UsageError: it cannot be used.
        """
        return TrajectoryOptions(rate_hz=self.rate_hz, joints=self.joints, poses=self.poses)

    def stage_options(self) -> RobotOptions:
        """What the stages are told.

        Raises:
            UsageError: it cannot be used.
        """
        return RobotOptions(table_height_m=self.table_height_m, urdf=self.urdf, tcp_frame=self.tcp_frame)

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


def audit_trajectories(config: AuditConfig, observer: RunObserver | None = None) -> RunSummary:
    """Judge every trajectory of `config.source` and fill the output folder.

    Raises:
        UsageError: the configuration, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.
    """
    observer = observer or NullRunObserver()
    samples = find_trajectories(config.source, config.choice(), out=config.out, model=config.model, task=config.task)
    if config.urdf is not None:
        remarks = robot_remarks(config.urdf, config.tcp_frame)
        for remark in remarks:
            observer.warn(f"{config.urdf.name}: {remark}")
        config = replace(config, robot_remarks=remarks)
    measure = TrajectoryEvaluator(
        kind=config.kind,
        out=config.out,
        stages=config.stages,
        stage_options=config.stage_options(),
        choice=config.choice(),
    )
    summary = run_samples(config, samples, measure, observer)
    warnings = _warnings(summary.rows)
    for text, ids in list(warnings.items())[:_MOST_WARNINGS]:
        observer.warn(f"{ids[0]}: {text}" + (f" (and {len(ids) - 1} more)" if ids[1:] else ""))
    if len(warnings) > _MOST_WARNINGS:
        observer.warn(f"{len(warnings) - _MOST_WARNINGS} more kinds of warnings; the rows have them all")
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
