"""What is done to one trajectory: read, check, judge, write its file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinebench_drake.measure import KINEMATIC_METRICS, Measure, Measured
from kinebench_drake.products import GripperTrack
from kinebench_drake.results import part_path
from kinebench_drake.row import Json
from kinebench_drake.stages import Judgement, Stages, load_stages
from kinebench_drake.trackfile import write_track
from kinebench_drake.trajectories.sample import TrajectorySample
from kinebench_drake.trajectories.source import read_trajectory
from kinebench_drake.trajectories.trajectory import Choice, Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryMeasure(Measure[TrajectorySample, Stages]):
    """How the trajectories of one run are measured."""

    choice: Choice
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

    def measure(self, sample: TrajectorySample, stages: Stages) -> Measured:
        """See `Measure`."""
        trajectory = read_trajectory(sample, self.choice)
        judgement = judge_trajectory(stages, trajectory)
        write_track(part_path(self.out, "tracks", sample.id), judgement.track, judgement.joints, judgement.curves)
        return Measured(
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
