"""`audit`: read a trajectory, judge it, write its file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, name_options
from kinebench_drake.formats.lerobot.dataset import INFO
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import Trajectory, TrajectorySample
from kinebench_drake.io.jsonl import Json, as_type, read_object
from kinebench_drake.metrics.recording_faults import find_action_lag, fingerprint, idle_ends
from kinebench_drake.models.arm import PANDA, ROBOTS
from kinebench_drake.models.joint_limits import JOINT_COUNTS
from kinebench_drake.models.named_arm import UNNAMED, find_arm
from kinebench_drake.results.inputs import PeriodSource
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import track_arrays, write_tracks
from kinebench_drake.runs.config import RunConfig, RunKind, SourceConfig
from kinebench_drake.runs.evaluator import EXECUTABILITY, KINEMATIC_METRICS, Evaluator, judge_row
from kinebench_drake.runs.gate import close_gate
from kinebench_drake.runs.option import Option
from kinebench_drake.runs.reading_check import assess_readings, doubt_frame, doubt_robot
from kinebench_drake.runs.resources import Resources, load_resources
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary, run_samples
from kinebench_drake.runs.two_arms import ArmChoice, choose_arms, find_arm_collisions, join_rows, load_pair, share_times
from kinebench_drake.track import GripperTrack
from kinebench_drake.violation import Violation

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.kinematic_result import KinematicResult

FOLLOWED_BY_FIVE = "position and the direction of one axis of the tool: five joints cannot set the turn about it"
"""What an audit checks of the poses of an arm of five joints."""
_MOST_WARNINGS = 5  # shown on the terminal


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditConfig(SourceConfig):
    """Options of a run over trajectories."""

    kind: RunKind = RunKind.AUDIT
    rate_hz: Annotated[
        float | None, Option("Frames per second, in place of the times of the files (t_s = k / rate).", metavar="HZ")
    ] = None
    reading: Annotated[
        Path | None,
        Option(
            "How to read the files: columns, units, rotations, frames (docs/formats.md).  [default: by their names]",
            metavar="FILE",
        ),
    ] = None
    tool: Annotated[
        str | None,
        Option(
            "TCP whose poses are judged: a link, or its pose in the flange, or in LINK.  [default: panda_hand_tcp]",
            metavar="LINK|[LINK:]x,y,z,qw,qx,qy,qz",
        ),
    ] = None
    package_path: Annotated[
        Path | None, Option("Folder of the packages that package:// URIs of the URDF name.", metavar="DIR")
    ] = None

    robot: Annotated[
        str,
        Option(
            "Arm to judge by: a name of `kinebench-drake robots`, or the URDF or MJCF of another one.  [default: by "
            "the robot_type of the data set, else panda]",
            metavar="NAME|FILE",
        ),
    ] = UNNAMED

    def __post_init__(self) -> None:
        """Convert and check the options.

        Raises:
            UsageError: one of them is invalid.
        """
        SourceConfig.__post_init__(self)
        self.trajectory_options()

    def choose_robot(self) -> "AuditConfig":
        """Return the options with the arm that the data set names, unless the user does."""
        if self.robot != UNNAMED:
            return self
        info = self.source / INFO
        named = as_type(read_object(info).get("robot_type"), str) if info.is_file() else None
        return replace(self, robot=find_arm(named or "") or PANDA)

    def trajectory_options(self) -> TrajectoryOptions:
        """Return the options of reading trajectories."""
        return TrajectoryOptions(
            rate_hz=self.rate_hz, reading=None if self.reading is None else Reading.parse(self.reading)
        )

    def robot_json(self) -> dict[str, Json]:
        """Serialize the robot, or both of two arms, into `config` of results.json."""
        arms = choose_arms(self.choose_robot().robot_options(), self.trajectory_options().reading)
        robots = [arm.options.load() for arm in arms]
        remarks = dict.fromkeys(name_options(remark) for robot in robots for remark in robot.remarks)
        return {"robot_id": "+".join(robot.id for robot in robots), "robot_remarks": [*remarks]}

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json; paths by their last name only."""
        return {**RunConfig.to_json(self), "robot": Path(self.robot).name}


def audit_trajectories(config: AuditConfig, observer: RunObserver | None = None) -> RunSummary:
    """Judge every trajectory of `config.source` and fill the output folder."""
    observer = observer or NullRunObserver()
    config = config.choose_robot()
    warnings: list[str] = []
    choice = config.trajectory_options()
    labels = {"model": config.model, "task": config.task}
    arms = choose_arms(config.robot_options(), choice.reading)
    robots = [arm.options.load() for arm in arms]
    choice = replace(choice, joints=robots[0].column_names, reading=arms[0].reading)
    samples = find_trajectories(config.source, choice, out=config.out, warnings=warnings, **labels)
    for warning in warnings:
        observer.warn(warning)
    samples = config.name_models(samples)
    for remark in dict.fromkeys(remark for robot in robots for remark in robot.remarks):
        observer.warn(f"{Path(config.robot).name}: {remark}")
    if len(arms) > 1:
        observer.warn("collisions of the two arms with each other are checked")
    if len(arms) > 1 and config.replays:
        observer.warn("rows of two arms have no 3D replays")
        config = replace(config, replays=0)
    evaluator = TrajectoryEvaluator(
        config=config,
        arms=arms,
        joints=tuple(robot.column_names for robot in robots),
        robot_id="+".join(robot.id for robot in robots),
    )
    summary = close_gate(config, run_samples(samples, evaluator, observer))
    by_text = _warnings(summary.rows)
    for text, ids in list(by_text.items())[:_MOST_WARNINGS]:
        observer.warn(f"{ids[0]}: {text}" + (f" (and {len(ids) - 1} more)" if ids[1:] else ""))
    if len(by_text) > _MOST_WARNINGS:
        observer.warn(f"{len(by_text) - _MOST_WARNINGS} more kinds of warnings: see the rows")
    return summary


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryEvaluator(Evaluator[TrajectorySample, tuple[Resources, ...]]):
    """Evaluation of the trajectories of one run."""

    config: AuditConfig
    arms: tuple[ArmChoice, ...]
    """The arm, or both of a pair."""
    joints: tuple[tuple[str, ...], ...]
    """Names of the joints of each arm in data sets."""

    def setup(self) -> tuple[Resources, ...]:
        """Load the robots."""
        return tuple(load_resources(self.config.make_resources, arm.options) for arm in self.arms)

    def evaluate(self, sample: TrajectorySample, tools: tuple[Resources, ...], row: SampleRow) -> SampleRow:
        """Read, judge, write; without a verdict where it is doubtful how the numbers are to be read."""
        options = self.config.trajectory_options()
        choices = [
            replace(options, joints=joints, reading=arm.reading)
            for arm, joints in zip(self.arms, self.joints, strict=True)
        ]
        doubts = [self._doubt(sample, choice, tool) for choice, tool in zip(choices, tools, strict=True)]
        trajectories = []
        for choice, tool, doubt in zip(choices, tools, doubts, strict=True):
            try:
                trajectories.append(tool.undo_turns(read_trajectory(sample, choice)))
            except InputError as error:
                raise InputError(f"{error}; {doubt}" if doubt else str(error)) from None
        sides = [arm.side for arm in self.arms] if len(self.arms) > 1 else [""]
        rows: dict[str, SampleRow] = {}
        files: dict[str, Mapping[str, NDArray[np.generic]]] = {}
        results: list[KinematicResult] = []
        for side, choice, tool, own, asked in zip(
            sides, choices, tools, share_times(trajectories), doubts, strict=True
        ):
            result, doubt = self._judge(sample, choice, tool, own, asked)
            rows[side] = self._row(row, own, result, doubt, len(choice.joints))
            if result is None:
                files[side] = track_arrays(_pose_track(own), None, {})
            else:
                files[side] = track_arrays(result.track, result.joints, result.curves)
                results.append(result)
        write_tracks(artifact_path(self.config.out, "tracks", sample.id), files)
        if len(sides) == 1:
            return rows[sides[0]]
        contacts: list[Violation] = []
        doubt = None
        if len(results) == len(sides):
            of_poses = any(trajectory.q is None for trajectory in trajectories)
            pair = load_pair(tools, tuple(arm.place for arm in self.arms))
            contacts, doubt = find_arm_collisions(pair, results, sides, of_poses=of_poses)
        return join_rows(row, rows, contacts, doubt)

    def _judge(
        self,
        sample: TrajectorySample,
        choice: TrajectoryOptions,
        tools: Resources,
        trajectory: Trajectory,
        doubt: str | None,
    ) -> tuple["KinematicResult | None", str | None]:
        """Return the verdict on an arm's trajectory, or why there is none where its reading is doubtful."""
        result = None if doubt else judge_trajectory(tools, trajectory)
        if result is not None and trajectory.q is None:
            judge = partial(judge_trajectory, tools)
            doubt = doubt_frame(tools, sample, choice, result, judge, is_franka=self.config.robot in ROBOTS)
            result = None if doubt else result
        return result, doubt

    def _row(
        self,
        row: SampleRow,
        trajectory: Trajectory,
        result: "KinematicResult | None",
        doubt: str | None,
        joints: int,
    ) -> SampleRow:
        """Return the row of an arm with so many joints."""
        period_s = float(np.median(np.diff(trajectory.t_s)))
        lag = trajectory.commands and find_action_lag(*trajectory.commands, period_s)
        source = PeriodSource.TIME_STAMPS if self.config.rate_hz is None else PeriodSource.RATE
        doubts = [name_options(doubt)] if doubt else []
        track = _pose_track(trajectory) if result is None else result.track
        is_partial = joints == JOINT_COUNTS[0]
        row = row.extended(
            **({"base_frame_reason": doubts[0]} if doubts else {}),
            frames=len(trajectory.t_s),
            frames_tracked=int(trajectory.tracked.sum()),
            duration_s=float(trajectory.t_s[-1] - trajectory.t_s[0]),
            frame_period_s=period_s,
            frame_period_source=source.value,
            judged="poses" if trajectory.q is None else "joints",
            **({"followed": FOLLOWED_BY_FIVE} if is_partial else {}),
            columns=trajectory.columns,
            dropped_samples=trajectory.dropped,
            idle_ends=idle_ends(track),
            fingerprint=fingerprint(trajectory.X_BG if trajectory.q is None else trajectory.q),
            **({} if lag is None else {"action_lag": lag}),
            warnings=[*doubts, *map(name_options, trajectory.warnings)],
        )
        reasons = dict.fromkeys(("", "feasible"), doubts[0]) if doubts else {}
        return judge_row(row, result, reasons=reasons, tracked=trajectory.tracked)

    def _doubt(self, sample: TrajectorySample, choice: TrajectoryOptions, tools: Resources) -> str | None:
        """Return why the numbers have no verdict; None if there is no doubt how to read them."""
        if other := doubt_robot(sample, choice, self.config.robot):
            return other
        alike = sample.alike or (sample,)
        assessment = assess_readings(tools, alike, choice, is_franka=self.config.robot in ROBOTS)
        return assessment.doubt if assessment else None

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Kinematic metrics."""
        return (EXECUTABILITY, *KINEMATIC_METRICS)

    @property
    def artifacts(self) -> tuple[str, ...]:
        """Tracks."""
        return ("tracks",)

    def cache_key(self, sample: TrajectorySample) -> Mapping[str, Json]:
        """Return reading options and labels."""
        reading = self.config.trajectory_options().reading
        return {
            "choice": [self.config.rate_hz, reading.to_json() if reading else None],
            "labels": [sample.seed, sample.prompt, sample.success, sample.rate_hz, sample.warnings, sample.problem],
            "part": [sample.format.value, sample.part, *(sample.rows or ())],
        }

    def input_files(self, sample: TrajectorySample) -> Sequence[Path]:
        """Return the trajectory's file and those that describe it."""
        alike = (other.path for other in sample.alike)
        return () if sample.problem is not None else (*dict.fromkeys((sample.path, *sample.about, *alike)),)

    def labels(self, sample: TrajectorySample) -> Mapping[str, Json]:
        """Return format, seed, prompt and success."""
        success = {} if sample.success is None else {"success": sample.success}
        return {"format": sample.format.value, "seed": sample.seed, "prompt": sample.prompt, **success}


def judge_trajectory(tools: Resources, trajectory: Trajectory) -> "KinematicResult":
    """Judge a trajectory: joint angles as recorded, poses by the best joint path that follows them."""
    if trajectory.q is not None:
        return tools.judge_joints(trajectory.t_s, trajectory.q, trajectory.finger_width_m)
    return tools.judge(_pose_track(trajectory))


def _pose_track(trajectory: Trajectory) -> GripperTrack:
    """Return the track of recorded poses: without a camera, with confidence 1 where tracked."""
    no_poses = np.full((len(trajectory.t_s), 4, 4), np.nan)
    return GripperTrack(
        t_s=trajectory.t_s,
        X_CH=no_poses,
        X_BG=no_poses if trajectory.X_BG is None else trajectory.X_BG,
        tracked=trajectory.tracked,
        confidence=trajectory.tracked.astype(np.float64),
        finger_width_m=trajectory.finger_width_m,
    )


def _warnings(rows: Sequence[SampleRow]) -> dict[str, list[str]]:
    """Return the warnings of the rows, each with the ids of its rows."""
    ids: dict[str, list[str]] = {}
    for row in rows:
        for text in row.warnings or ():
            ids.setdefault(text, []).append(row.id)
    return ids
