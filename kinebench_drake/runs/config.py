"""Configuration of a run over videos, and the options common to all runs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, TypeVar

from kinebench_drake.errors import UsageError, name_options, suggestion
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S, Sample
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.trajectory import SLOW_STEP_S, parse_number
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.arm import PANDA, ROBOTS
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.report.metric import BY_NAME
from kinebench_drake.results.drops import DropReason
from kinebench_drake.results.metadata import Shard
from kinebench_drake.results.row import VERDICT_SHARES
from kinebench_drake.runs.option import Option, options_json, parse_options
from kinebench_drake.runs.resources import Resources, ResourcesFactory, RobotOptions
from kinebench_drake.view_name import AUTO_VIEW, check_view
from kinebench_drake.violation import ViolationKind

AUTO = "auto"
"""Value of `camera` by which it is chosen for each video."""
MAX_SEED = 2**63 - 1
"""Largest seed: JSON readers take a larger integer for a float."""
_Sample = TypeVar("_Sample")
_Named = TypeVar("_Named", bound=Sample)


class ModelSource(Enum):
    """Where the names of models come from."""

    FOLDER = "folder"
    """The first folder below the source."""


class ActionFileFormat(Enum):
    """Format of actions."""

    LEROBOT = "lerobot-v3"
    ROBOWM = "robowm"

    @property
    def folder(self) -> str:
        """Name of its folder in the output folder."""
        return self.value.partition("-")[0]


class RunKind(Enum):
    """What a run does with its samples."""

    SCORE = "score"
    GROUND = "ground"
    AUDIT = "audit"
    FOLLOW = "follow"
    SUITE = "suite"

    @property
    def noun(self) -> str:
        """Plural noun for the samples of the run."""
        return {RunKind.AUDIT: "trajectories", RunKind.SUITE: "episodes"}.get(self, "videos")

    @property
    def judges(self) -> bool:
        """True if the run judges kinematics."""
        return self not in (RunKind.GROUND, RunKind.FOLLOW)

    @property
    def reports(self) -> bool:
        """True if the run writes a report."""
        return self is not RunKind.GROUND


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Options common to all runs."""

    out: Annotated[Path, Option("Output folder; created if absent.", key=None, also="-o")]
    kind: RunKind
    limit: Annotated[int | None, Option("Process only the first N samples.", least=1, metavar="N")] = None
    shard: Annotated[Shard | None, Option("Process only part I of N, for several machines.", metavar="I/N")] = None
    jobs: Annotated[int, Option("Worker processes; 1 works in the calling process.", least=1, metavar="N")] = 1
    engine: Annotated[ExecutorKind, Option("Where workers run: processes of this machine, or a Ray cluster.")] = (
        ExecutorKind.LOCAL
    )
    address: Annotated[
        str | None,
        Option("Ray cluster.  [default: RAY_ADDRESS, or that of this machine]", metavar="HOST:PORT", key=None),
    ] = None
    overwrite: Annotated[
        bool,
        Option(
            "Start anew, or keep finished samples whose input and options are unchanged.  [default: resume]",
            also="--resume",
            key=None,
        ),
    ] = False
    seed: Annotated[
        int,
        Option(
            "Seed of the bootstrap; of `suite` commands also the number of the first of the split's seeds.", least=0
        ),
    ] = 0
    model: Annotated[
        str | None,
        Option(
            "World model behind the samples, where the input does not name it; of `suite run` its name in tables.",
            metavar="NAME",
        ),
    ] = None
    tags: Annotated[Mapping[str, str], Option("Label kept in results; repeatable.", metavar="KEY=VALUE", key=None)] = (
        field(default_factory=dict)
    )
    table_height_m: Annotated[float, Option("Height of the table top in the robot base frame.", metavar="METRES")] = 0.0
    replays: Annotated[
        int | None,
        Option("Write 3D replays of the N worst samples (3 MB each); `view` writes one of any.", least=0, metavar="N"),
    ] = 3
    """None keeps the replays that `view` wrote and writes none."""
    make_resources: ResourcesFactory = Resources
    """Creates the tools of a worker process; picklable."""

    def __post_init__(self) -> None:
        """Convert and check the options.

        Raises:
            UsageError: one of them is invalid.
        """
        parse_options(self)
        if self.seed > MAX_SEED:
            raise UsageError(f"$seed is {self.seed}, expected {MAX_SEED} or less")
        self.robot_options()

    @property
    def suite_version(self) -> str | None:
        """Version of the suites; None for runs without episodes."""
        return None

    def robot_options(self) -> RobotOptions:
        """Return robot and table."""
        names = {f.name for f in fields(self)} & {f.name for f in fields(RobotOptions)}
        return RobotOptions(**{name: getattr(self, name) for name in names})

    def robot_json(self) -> dict[str, Json]:
        """Serialize the robot into `config` of results.json: what defines it, and the assumptions about it."""
        robot = self.robot_options().load()
        return {"robot_id": robot.id, "robot_remarks": [name_options(remark) for remark in robot.remarks]}

    def select(self, samples: Sequence[_Sample]) -> list[_Sample]:
        """Return the samples of this run: those of its shard, up to the limit."""
        selected = list(samples[: self.limit])
        return self.shard.take(selected) if self.shard else selected

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json; paths by their last name only."""
        return {"kind": self.kind.value, **options_json(self), **self.robot_json()}


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceConfig(RunConfig):
    """Options of runs over files."""

    source: Annotated[Path, Option("Files to read.")]
    task: Annotated[str | None, Option("Task of the samples, where the input does not name it.", metavar="NAME")] = None
    model_from: Annotated[
        ModelSource | None, Option("Name models by the subfolders of PATH, where the input does not name them.")
    ] = None
    robot: Annotated[
        str,
        Option("Robot to judge by.", metavar="|".join(ROBOTS)),
    ] = PANDA
    limits: Annotated[
        Path | None, Option("JSON file of joint limits that replace the robot's (docs/kinematics.md).", metavar="FILE")
    ] = None
    payload_kg: Annotated[float, Option("Mass that the gripper carries, a point at the TCP.", metavar="KG")] = 0.0
    obstacles: Annotated[
        Path | None,
        Option(
            "JSON file of boxes, spheres, cylinders and meshes that the arm must not touch (docs/kinematics.md).",
            metavar="FILE",
        ),
    ] = None

    fail_on: Annotated[
        str | None,
        Option(
            "Exit 1 if a sample has a fault of KIND: a reason of the drop list, or the kind of a violation; several by "
            "commas.",
            metavar="KIND",
            key=None,
        ),
    ] = None
    fail_under: Annotated[
        Mapping[str, str],
        Option(
            "Exit 1 if the mean of a metric, or a share, is below VALUE; repeatable.", metavar="NAME=VALUE", key=None
        ),
    ] = field(default_factory=dict)
    sarif: Annotated[
        Path | None, Option("Write the drop list as SARIF, for GitHub's code scanning.", metavar="FILE", key=None)
    ] = None
    write_kept: Annotated[
        Path | None,
        Option(
            "Write the episodes of a LeRobot dataset that are not on the drop list to a new one; idle ends stay.",
            metavar="DIR",
            key=None,
        ),
    ] = None

    def __post_init__(self) -> None:
        """Convert and check the options."""
        RunConfig.__post_init__(self)
        kinds = [*(reason.key for reason in DropReason), *(kind.value for kind in ViolationKind)]
        _check_names("fail_on", self.faults, kinds)
        _check_names("fail_under", self.fail_under, (*VERDICT_SHARES, *BY_NAME))
        for name, value in self.fail_under.items():
            try:
                parse_number(value)
            except ValueError as error:
                raise UsageError(f"$fail_under {name}: {error}, expected such as feasible=0.95") from None
        target = self.write_kept
        if target is not None and (target.exists() or not (self.source / "meta" / "info.json").is_file()):
            fault = f"{target} exists already" if target.exists() else f"{self.source} is no LeRobot dataset"
            raise UsageError(f"$write_kept: {fault}, expected a new folder for the episodes of a LeRobot dataset")

    @property
    def faults(self) -> tuple[str, ...]:
        """Kinds of faults that no sample may have."""
        return tuple(self.fail_on.split(",")) if self.fail_on else ()

    def name_models(self, samples: Sequence[_Named]) -> tuple[_Named, ...]:
        """Return the samples with the name of their model, from `model_from`, where they have none.

        Raises:
            UsageError: no sample is in a subfolder, or the model is named twice.
        """
        if self.model_from is None:
            return tuple(samples)
        if self.model is not None:
            raise UsageError(f"$model {self.model} and $model_from {self.model_from.value} exclude each other")
        folders = [Path(sample.video).parts[:-1] for sample in samples]
        if not any(folders):
            raise UsageError(f"$model_from {self.model_from.value}: {self.source} has no subfolder with samples")
        return tuple(
            replace(sample, model=sample.model or (parts[0] if parts else None))
            for sample, parts in zip(samples, folders, strict=True)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreConfig(SourceConfig):
    """Options of a run over videos."""

    kind: RunKind = RunKind.SCORE
    frame_period_s: Annotated[
        float | None,
        Option("Task time between two frames; benchmark videos: 0.2.  [default: 1 / fps]", metavar="SECONDS"),
    ] = None
    task_duration_s: Annotated[
        float | None,
        Option(
            "Task time that each video shows, whatever its number of frames: they lie evenly over it, and are sampled "
            "every frame period.  [default: they are one frame period apart]",
            metavar="SECONDS",
        ),
    ] = None
    camera_key: Annotated[
        str | None,
        Option(
            "Camera to use of a LeRobot dataset, HDF5 or npz file that has several, by its name or part of it.",
            metavar="NAME",
        ),
    ] = None
    camera: Annotated[
        str,
        Option(
            "Camera of videos that name none: auto takes one that `kinebench-drake cameras` lists where the arm "
            "confirms it, and estimates it from the arm elsewhere; a name insists on that one. A camera.json is "
            "that of all.",
            metavar="auto|NAME|FILE",
        ),
    ] = AUTO
    mirrored: Annotated[bool, Option("The pictures show the scene mirrored: turn them left-right first (LIBERO).")] = (
        False
    )
    view: Annotated[
        str,
        Option(
            "Panel of frames that are tiles of several views, where the manifest names none: auto takes the one that "
            "shows most of a robot from outside, N counts in reading order, a NAME is its place, such as left or "
            "top-middle. Of a real view beside a generated one only the name says which is which.",
            metavar="auto|N|NAME",
        ),
    ] = AUTO_VIEW
    gripper: Annotated[
        GripperKind,
        Option(
            "Gripper on the arm. auto looks for the Franka hand; where it is not seen, for the Robotiq 2F-85; without "
            "either, or with none, the links alone give the flange."
        ),
    ] = GripperKind.AUTO
    stride: Annotated[
        int,
        Option(
            "Measure every K-th frame in full and the hand alone between them; faster, see docs/reward.md.",
            least=1,
            metavar="K",
        ),
    ] = 1
    overlay: Annotated[bool, Option("Write videos with the tracked gripper drawn in.", also="--no-overlay")] = False
    pixels_only: Annotated[
        bool,
        Option("Ignore the initial state in the manifest (pose of the first frame, or task and seed of an episode)."),
    ] = False
    masks: Annotated[Path | None, Option("Gripper masks that replace the network's.", metavar="DIR")] = None
    depth: Annotated[
        str | None,
        Option(
            "Metric depth that replaces the network's: files, or a class of yours.",
            metavar="DIR|module:Class",
        ),
    ] = None
    poses: Annotated[
        Path | None, Option("Poses of panda_hand in the camera frame that replace the tracker's.", metavar="DIR")
    ] = None
    format: Annotated[
        ActionFileFormat | None,
        Option(
            "Also write the actions of all videos: a LeRobot dataset, or the files that RoboWM-Bench executes.",
            key=None,
        ),
    ] = None
    depth_exact: Annotated[
        bool, Option("Treat the depth of $depth as accurate to a few millimetres (sensor, simulator).")
    ] = False

    def __post_init__(self) -> None:
        """Convert and check the options.

        Raises:
            UsageError: one of them is invalid.
        """
        SourceConfig.__post_init__(self)
        if self.robot not in ROBOTS:
            raise UsageError(f"$robot is {self.robot!r}, expected {' or '.join(ROBOTS)}: videos show one of these arms")
        if self.format is not None and self.kind.judges:
            raise UsageError(
                f"$format {self.format.value} goes with `ground`: `score` writes the joint angles it judged"
            )
        _check_view("view", self.view)
        check_period(self.frame_period_s)
        self.overrides()
        duration_s = self.task_duration_s
        if duration_s is not None and not MIN_PERIOD_S <= duration_s <= MAX_PERIOD_S:
            raise UsageError(
                f"$task_duration_s is {duration_s}, expected seconds from {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g}, such "
                "as 9.6"
            )

    def overrides(self) -> Overrides:
        """Return the stages of the grounding that are replaced."""
        return Overrides(masks=self.masks, depth=self.depth, poses=self.poses, depth_exact=self.depth_exact)

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json; paths by their last name only."""
        return {
            **RunConfig.to_json(self),
            "camera": Path(self.camera).name,
            "depth": self.overrides().names.get("depth"),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowConfig(ScoreConfig):
    """Options of a run that compares clips with their actions or real clips."""

    kind: RunKind = RunKind.FOLLOW
    actions: Annotated[
        Path | None,
        Option(
            "Actions that the clips should show: a folder with ID.npz, csv, json, h5 or parquet for each video, or a "
            "data set with an episode of each name.  [default: the files under the key actions of the manifest]",
            metavar="DIR|FILE",
        ),
    ] = None
    reference: Annotated[
        Path | None, Option("Real clips that the videos should show, with the same ids.", metavar="PATH")
    ] = None
    reference_view: Annotated[
        str | None,
        Option(
            "Panel of the real clips, where their frames are tiles: with PATH itself as $reference the row of a tile "
            "that is real, such as top-left.  [default: that of $view]",
            metavar="N|NAME",
        ),
    ] = None
    reading: Annotated[
        Path | None,
        Option("How to read the actions (docs/formats.md).  [default: by their names]", metavar="FILE"),
    ] = None

    def __post_init__(self) -> None:
        """Convert and check the options.

        Raises:
            UsageError: the real clips are the clips themselves.
        """
        ScoreConfig.__post_init__(self)
        _check_view("reference_view", self.reference_view or AUTO_VIEW)
        if self.reference is not None and self.reference_view in (None, self.view) and self.reference == self.source:
            raise UsageError(
                f"$reference {self.reference} holds the clips themselves: name the real row of their frames by "
                "$reference_view, such as top-left, and the generated one by $view"
            )

    def trajectory_options(self) -> TrajectoryOptions:
        """Return the options of reading actions."""
        return TrajectoryOptions(reading=None if self.reading is None else Reading.parse(self.reading))


def _check_view(option: str, view: str) -> None:
    try:
        check_view(view)
    except ValueError as error:
        raise UsageError(f"${option} is {view!r}, {error}") from None


def _check_names(option: str, names: Iterable[str], valid: Sequence[str]) -> None:
    for name in names:
        if name not in valid:
            raise UsageError(f"${option} {name}{suggestion(name, valid)}: expected one of {', '.join(valid)}")


def check_period(period_s: float | None) -> None:
    """Check a task time between two frames [s].

    Raises:
        UsageError: it is out of range.
    """
    if period_s is not None and not MIN_PERIOD_S <= period_s <= MAX_PERIOD_S:
        raise UsageError(
            f"$frame_period_s is {period_s}, expected seconds from {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g}, such as 0.2"
        )


def period_warnings(periods_s: Iterable[float | None]) -> list[str]:
    """Return a warning about task times between two frames [s] that are longer than any recording's."""
    long = sorted({period_s for period_s in periods_s if period_s is not None and period_s > SLOW_STEP_S})
    if not long:
        return []
    return [
        f"a frame period of {long[-1]:g} s means {long[-1]:g} s between two frames: is it in milliseconds (then write "
        f"{long[-1] / 1000:g}) or in frames per second (then write {1 / long[-1]:.4g})?"
    ]
