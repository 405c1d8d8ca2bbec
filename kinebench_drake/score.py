"""The main job: videos to tracks to metrics to an output folder. `ground` is the same job without the kinematics."""

from dataclasses import dataclass, replace
from pathlib import Path

from kinebench_drake.episodes import with_first_frames
from kinebench_drake.footage import BENCHMARK_PERIOD_S, PeriodSource, check_period
from kinebench_drake.grounding.known import FirstFrameUse
from kinebench_drake.grounding.sources.sources import Sources
from kinebench_drake.inputs import find_samples
from kinebench_drake.measure import Kind
from kinebench_drake.row import Json
from kinebench_drake.run import Observer, RunConfig, RunSummary, Silence, run_samples
from kinebench_drake.video_measure import VideoMeasure


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreConfig(RunConfig):
    """Everything a run over videos is told."""

    source: Path
    """Video, folder of videos, dataset, npy, npz or HDF5 file, or manifest."""
    task: str | None = None
    """Task of samples that name none."""
    kind: Kind = Kind.SCORE
    frame_period_s: float | None = None
    """Task time between two frames [s]."""
    camera_key: str | None = None
    """Camera to take of datasets that have several."""
    overlay: bool = False
    """Write overlays/ID.mp4."""
    masks: Path | None = None
    """Folder of masks in place of the network's."""
    depth: str | None = None
    """Folder of depth, `moge:CHECKPOINT` or `module:Class` in place of the network's depth."""
    poses: Path | None = None
    """Folder of poses in place of the tracker's."""
    pixels_only: bool = False
    """Whether what the manifest tells of first frames is left aside."""
    depth_exact: bool = False
    """Whether the given depth can be trusted to a few millimetres."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: one of them makes no sense.
        """
        RunConfig.__post_init__(self)
        check_period(self.frame_period_s)
        self.sources()

    def sources(self) -> Sources:
        """Which stages of the grounding are done elsewhere.

        Raises:
            UsageError: something named is not there.
        """
        return Sources(masks=self.masks, depth=self.depth, poses=self.poses, depth_exact=self.depth_exact)

    def to_json(self) -> dict[str, Json]:
        """What results tell of the configuration; paths by their last name only."""
        return {
            **RunConfig.to_json(self),
            "source": self.source.resolve().name,
            "task": self.task,
            "frame_period_s": self.frame_period_s,
            "camera_key": self.camera_key,
            "overlay": self.overlay,
            "pixels_only": self.pixels_only,
            **dict.fromkeys(("masks", "depth", "poses")),
            **self.sources().names,
            "depth_exact": self.depth_exact,
        }


def score_videos(config: ScoreConfig, observer: Observer | None = None) -> RunSummary:
    """Measure every video of `config.source` and fill the output folder.

    Raises:
        UsageError: the configuration, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.
    """
    observer = observer or Silence()
    sources = config.sources()
    inputs = find_samples(
        config.source,
        out=config.out,
        model=config.model,
        task=config.task,
        others=sources.folders,
        camera_key=config.camera_key,
    )
    for warning in inputs.warnings:
        observer.warned(warning)
    samples = (
        [replace(s, first=None) for s in inputs.samples] if config.pixels_only else with_first_frames(inputs.samples)
    )
    measure = VideoMeasure(
        kind=config.kind,
        out=config.out,
        stages=config.stages,
        stage_options=config.stage_options(),
        frame_period_s=config.frame_period_s,
        overlay=config.overlay,
        sources=sources,
    )
    summary = run_samples(config, samples, measure, observer)
    contradicted = sum(row.extra.get("first_frame") == FirstFrameUse.CONTRADICTED.value for row in summary.rows)
    if contradicted:
        observer.warned(
            f"{contradicted} samples do not begin with the pose that their manifest tells, or that the episode of its "
            "task and seed has: it was not used"
        )
    clockless = sum(row.extra.get("frame_period_source") == PeriodSource.BENCHMARK.value for row in summary.rows)
    if clockless:
        observer.warned(
            f"{clockless} samples have no frame rate: {BENCHMARK_PERIOD_S} s between frames was taken, as in the "
            "benchmark; give --frame-period SECONDS if it is not so"
        )
    return summary
