"""Options of a run over videos."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.errors import UsageError, member_of
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.trajectory import SLOW_STEP_S
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.panda.robot import GripperKind
from kinebench_drake.runs.camera import AUTO, BENCHMARK
from kinebench_drake.runs.config import RunConfig, RunKind
from kinebench_drake.suites.clock import CLIP_S, ClipTiming


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreConfig(RunConfig):
    """Options of a run over videos."""

    source: Path
    """Video, folder of videos, dataset, npy, npz or HDF5 file, or manifest."""
    task: str | None = None
    """Task of samples whose input names none."""
    kind: RunKind = RunKind.SCORE
    frame_period_s: float | None = None
    """Task time between two frames; where a duration is set, between those that are sampled [s]."""
    clip_timing: str | None = None
    """Name of a `ClipTiming`; None: uniform with a duration, else native."""
    task_duration_s: float | None = None
    """Task time that each video shows [s]; None: that of the benchmark's clips."""
    camera_key: str | None = None
    """Camera to use of datasets that have several."""
    overlay: bool = False
    """Write overlays/ID.mp4."""
    masks: Path | None = None
    """Folder of masks that replace the network's."""
    depth: str | None = None
    """Folder of depth maps, `moge:CHECKPOINT` or `module:Class` that replaces the network's depth."""
    poses: Path | None = None
    """Folder of poses that replace the tracker's."""
    camera: str = AUTO
    """`auto`, `benchmark`, or the path of a camera.json for all videos."""
    mirrored: bool = False
    """Turn all frames left-right before they are measured."""
    gripper: str = GripperKind.AUTO.value
    """Name of a `GripperKind`."""
    pixels_only: bool = False
    """Ignore the initial state of the manifest."""
    depth_exact: bool = False
    """Treat the depth as accurate to a few millimetres."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            UsageError: one of them is invalid.
        """
        RunConfig.__post_init__(self)
        check_period(self.frame_period_s)
        self.overrides()
        _ = self.duration_s, self.gripper_kind

    @property
    def duration_s(self) -> float | None:
        """Task time over which the frames of a video lie evenly [s]; None: they are one frame period apart.

        Raises:
            UsageError: an option is invalid, or the two contradict each other.
        """
        duration_s = self.task_duration_s
        timing = None if self.clip_timing is None else member_of(ClipTiming, self.clip_timing, "clip_timing")
        if duration_s is not None and timing is ClipTiming.NATIVE:
            raise UsageError("$task_duration_s needs $clip_timing uniform, found native; leave one of them out")
        if timing is ClipTiming.UNIFORM and duration_s is None:
            return CLIP_S
        if duration_s is not None and not MIN_PERIOD_S <= duration_s <= MAX_PERIOD_S:
            raise UsageError(
                f"$task_duration_s is {duration_s}, expected seconds from {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g}, such "
                f"as {CLIP_S:g}"
            )
        return duration_s

    @property
    def gripper_kind(self) -> GripperKind:
        """Gripper of the videos.

        Raises:
            UsageError: there is no such gripper.
        """
        return member_of(GripperKind, self.gripper, "gripper")

    def overrides(self) -> Overrides:
        """Return the stages of the grounding that are replaced.

        Raises:
            UsageError: a folder or class does not exist.
        """
        return Overrides(masks=self.masks, depth=self.depth, poses=self.poses, depth_exact=self.depth_exact)

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json; paths by their last name only."""
        return {
            **RunConfig.to_json(self),
            "source": self.source.resolve().name,
            "task": self.task,
            "frame_period_s": self.frame_period_s,
            "task_duration_s": self.duration_s,
            "camera_key": self.camera_key,
            "camera": self.camera if self.camera in (AUTO, BENCHMARK) else Path(self.camera).name,
            "mirrored": self.mirrored,
            "gripper": self.gripper,
            "overlay": self.overlay,
            "pixels_only": self.pixels_only,
            **dict.fromkeys(("masks", "depth", "poses")),
            **self.overrides().names,
            "depth_exact": self.depth_exact,
        }


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
