"""The main job: videos to tracks to metrics to an output folder. `ground` is the same job without the kinematics."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.datasets.manifest import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.datasets.videos.find import find_samples
from kinebench_drake.datasets.videos.sample import VideoSample
from kinebench_drake.errors import InputError, UnmeasurableError, UsageError
from kinebench_drake.evaluation.evaluator import KINEMATIC_METRICS, MIN_TRACKED, Evaluation, Evaluator, RunKind
from kinebench_drake.evaluation.runner import NullRunObserver, RunConfig, RunObserver, RunSummary, run_samples
from kinebench_drake.evaluation.stages import Grounded, Judgement, Stages, load_stages
from kinebench_drake.evaluation.thumbnail import side_by_side, worst_frame
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.framing.framing import Framing
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.atomic import disk_errors, write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.io.images import frame_files, read_image
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from kinebench_drake.results.provenance import weights_hash
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.suites.start import START_WIDTH_M, start_q
from kinebench_drake.types import Anomaly, GripperTrack, InitialState, InitialStateUse, Json, Priors

BENCHMARK_PERIOD_S = 0.2
"""Task time between two frames of a benchmark video (4 control steps at 20 Hz) [s]."""


class PeriodSource(Enum):
    """Where the task time between two frames comes from, in order of precedence."""

    MANIFEST = "manifest"
    OPTION = "option"
    MANIFEST_FPS = "manifest_fps"
    DATASET = "dataset"
    TIME_STAMPS = "time_stamps"
    FPS = "fps"
    BENCHMARK = "benchmark"


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedVideo:
    """What the grounding is given."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB, without the bars that the video may have."""
    camera: Camera
    """The camera of these frames."""
    t_s: Array
    """(T,) task time of each frame [s]."""
    period_s: float
    """Task time between two frames [s]."""
    period_source: PeriodSource
    framing: Framing
    """What was done to the camera's picture."""
    known: Priors
    """What takes the place of estimates."""

    def ground(self, stages: Stages) -> Grounded:
        """Find the gripper.

        Raises:
            InputError: what is known is of another video.
            UnmeasurableError: too few frames show a gripper to make a path.
            SetupError: weights or libraries are missing.
        """
        grounded = stages.ground(self.frames, self.camera, self.t_s, self.known)
        tracked = int(grounded.track.tracked.sum())
        if tracked < MIN_TRACKED:
            raise UnmeasurableError(
                f"the gripper was found in {tracked} of {len(self.t_s)} frames, a path needs {MIN_TRACKED}: is the "
                "robot in view, and is this the video's camera?"
            )
        return grounded


def prepare_video(video: Video, sample: VideoSample, period_s: float | None, sources: Overrides) -> PreparedVideo:
    """Make a video ready.

    Args:
        video: as decoded.
        sample: what its owner says about it.
        period_s: task time between two frames [s] from the command line.
        sources: which stages of the grounding are done elsewhere.

    Raises:
        InputError: what takes the place of estimates is absent, broken or of another video.
        UnmeasurableError: the video is too small or too short, or of another shape than its camera's picture.
        SetupError: a plug-in cannot be made ready.
    """
    video.require_measurable()
    framing = _framing(sample, video)
    t_s, period_s, source = _times(sample, video, period_s)
    whole = sources.known(names_of(sample), video.frames, framing.whole_camera(sample.camera), sample.initial_state)
    return PreparedVideo(
        frames=framing.cut(video.frames),
        camera=framing.camera(sample.camera),
        t_s=t_s,
        period_s=period_s,
        period_source=source,
        framing=framing,
        known=whole.crop(*framing.window),
    )


def check_period(period_s: float | None) -> None:
    """Make sure that a task time between two frames, where one is told, is one.

    Raises:
        UsageError: it is not.
    """
    if period_s is not None and not MIN_PERIOD_S <= period_s <= MAX_PERIOD_S:
        raise UsageError(
            f"--frame-period is {period_s}, expected seconds from {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g}, such as 0.2"
        )


def names_of(sample: VideoSample) -> tuple[str, ...]:
    """What files that belong to the video may be called: after its id, or after the video itself."""
    if sample.is_part:
        return (sample.id,)
    stem = sample.path.name if sample.path.is_dir() else sample.path.stem
    return tuple(dict.fromkeys((sample.id, stem)))


def _times(sample: VideoSample, video: Video, option_s: float | None) -> tuple[Array, float, PeriodSource]:
    """Task time of each frame [s], the period between two [s], and where it comes from."""
    if sample.frame_period_s is not None:
        period_s, source = sample.frame_period_s, PeriodSource.MANIFEST
    elif option_s is not None:
        period_s, source = option_s, PeriodSource.OPTION
    elif sample.fps is not None:
        period_s, source = 1.0 / sample.fps, PeriodSource.MANIFEST_FPS
    elif sample.dataset_period_s is not None:
        period_s, source = sample.dataset_period_s, PeriodSource.DATASET
    elif video.stamps_s is not None:
        return video.stamps_s, float(np.median(np.diff(video.stamps_s))), PeriodSource.TIME_STAMPS
    elif video.fps is not None:
        period_s, source = 1.0 / video.fps, PeriodSource.FPS
    else:
        period_s, source = BENCHMARK_PERIOD_S, PeriodSource.BENCHMARK
    return np.arange(len(video.frames), dtype=np.float64) * period_s, period_s, source


def _framing(sample: VideoSample, video: Video) -> Framing:
    """Where the camera's picture is in the video.

    Raises:
        UnmeasurableError: its shape is another, and nothing tells why.
    """
    from kinebench_drake.grounding.framing.search import find_framing  # loads OpenCV

    try:
        picture = None if sample.first_frame is None else read_image(sample.first_frame)
    except InputError:
        picture = None  # a picture that happens to be called like the video need not be one
    try:
        return find_framing(video.frames, sample.camera, picture)
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{sample.camera_source.value} {error}") from None


VISUAL_METRICS = ("tracked_fraction", "camera_motion_px", "arm_consistency_px", "anomalies")
"""Names every row of a video bears; null where there is nothing to measure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoEvaluator(Evaluator[VideoSample, Stages]):
    """How the videos of one run are measured."""

    frame_period_s: float | None
    """Task time between two frames from the command line [s]."""
    overlay: bool
    """Whether to write overlays/ID.mp4."""
    sources: Overrides
    """Which stages of the grounding are done elsewhere."""

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `Measure`."""
        return (*VISUAL_METRICS, *(KINEMATIC_METRICS if self.kind.judges else ()))

    @property
    def parts(self) -> tuple[str, ...]:
        """See `Measure`."""
        return ("tracks", *(["overlays"] if self.overlay else []))

    def facts(self, sample: VideoSample) -> Mapping[str, Json]:
        """See `Measure`."""
        return {
            "weights": weights_hash(),
            "camera": sample.camera.to_json(),
            "camera_source": sample.camera_source.value,
            "option_period_s": self.frame_period_s,
            "given": self._given(sample),
            "first": _first_json(sample.initial_state),
            "depth_exact": self.sources.depth_exact,
            "labels": [sample.seed, sample.prompt, sample.fps, sample.frame_period_s, sample.problem],
            "part": [*dataclasses.astuple(sample.part), sample.camera_key, sample.dataset_period_s],
        }

    def files(self, sample: VideoSample) -> Sequence[Path]:
        """See `Measure`."""
        if sample.problem is not None:
            return ()
        own = frame_files(sample.path) if sample.path.is_dir() else [sample.path]
        given = [] if sample.first_frame is None else [sample.first_frame]
        return [*own, *given, *self.sources.files(names_of(sample))]

    def labels(self, sample: VideoSample) -> Mapping[str, Json]:
        """See `Measure`."""
        return {
            "camera_source": sample.camera_source.value,
            "given": self._given(sample),
            "seed": sample.seed,
            "prompt": sample.prompt,
            **({} if sample.camera_key is None else {"camera_key": sample.camera_key}),
        }

    def equip(self) -> Stages:
        """See `Measure`."""
        return load_stages(self.stages, self.stage_options)

    def measure(self, sample: VideoSample, stages: Stages) -> Evaluation:
        """See `Measure`."""
        if sample.problem is not None:
            raise InputError(sample.problem)
        video = read_video(sample.path, sample.part)
        size = video.width, video.height
        footage = prepare_video(video, sample, self.frame_period_s, self.sources)
        video = replace(video, frames=footage.frames)
        grounding = footage.ground(stages)
        track = grounding.track
        judgement = stages.judge(track) if self.kind.judges else None
        self._write_files(sample, video, footage, track, judgement, stages)
        return Evaluation(
            judgement=judgement,
            metrics={
                "tracked_fraction": int(track.tracked.sum()) / len(track.t_s),
                "camera_motion_px": grounding.camera_motion_px,
                "arm_consistency_px": grounding.arm_consistency_px,
                "anomalies": [anomaly_json(a) for a in grounding.anomalies],
            },
            extra={
                "first_frame": grounding.first_frame.value,
                "frames": len(track.t_s),
                "width": size[0],
                "height": size[1],
                "framing": footage.framing.to_json(),
                "fps": video.fps,
                "frame_period_s": footage.period_s,
                "frame_period_source": footage.period_source.value,
            },
        )

    def _given(self, sample: VideoSample) -> dict[str, Json]:
        """What takes the place of estimates: stage to where it comes from."""
        return {**({"first_frame": "manifest"} if sample.initial_state else {}), **self.sources.names}

    def _write_files(
        self,
        sample: VideoSample,
        video: Video,
        footage: PreparedVideo,
        track: GripperTrack,
        judgement: Judgement | None,
        stages: Stages,
    ) -> None:
        """Write the sample's files, each whole or not at all; the row that vouches for them comes later.

        Raises:
            SetupError: writing failed.
        """
        if self.overlay:
            path = artifact_path(self.out, "overlays", sample.id)
            fps = float(np.clip(video.fps or 1.0 / footage.period_s, 1.0, 60.0))
            with disk_errors(f"overlays/{path.name}"):
                write_video(path, stages.overlay(video.frames, footage.camera, track), fps)
        chosen = np.unique([0, worst_frame(track, judgement)])
        images = list(stages.overlay(video.frames[chosen], footage.camera, track.at(chosen)))
        write_atomically(artifact_path(self.out, "thumbnails", sample.id), side_by_side(images))
        joints, curves = (judgement.joints, judgement.curves) if judgement else (None, {})
        write_track(artifact_path(self.out, "tracks", sample.id), track, joints, curves)


def _first_json(first: InitialState | None) -> Json:
    return None if first is None else [*first.X_BG.ravel().tolist(), str(first.finger_width_m)]


def anomaly_json(anomaly: Anomaly, first_frame: int = 0) -> dict[str, Json]:
    """An anomaly as rows have it, its frames counted on from `first_frame`."""
    return {
        "kind": anomaly.kind.value,
        "frame_start": first_frame + int(anomaly.frame_start),
        "frame_end": first_frame + int(anomaly.frame_end),
        "severity": float(anomaly.severity),
    }


def with_first_frames(samples: Iterable[VideoSample]) -> list[VideoSample]:
    """The samples, those of a known task and seed with the pose in which the episode's scene begins.

    What a manifest says of the first frame itself goes before. A video that begins elsewhere, such as the second clip
    of an episode, is told by what its first frame shows.

    Raises:
        SetupError: the Panda's files are missing.
    """
    from kinebench_drake.kinematics.plant import ArmPlant

    plant: ArmPlant | None = None
    told = []
    for sample in samples:
        task, seed = sample.task, sample.seed
        if sample.initial_state is None and seed is not None and task is not None and task in START_WIDTH_M:
            plant = plant or ArmPlant()
            q = start_q(task, seed)
            first = InitialState(X_BG=plant.forward(q[:7]), finger_width_m=float(q[7:].sum()))
            sample = replace(sample, initial_state=first)
        told.append(sample)
    return told


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreConfig(RunConfig):
    """Everything a run over videos is told."""

    source: Path
    """Video, folder of videos, dataset, npy, npz or HDF5 file, or manifest."""
    task: str | None = None
    """Task of samples that name none."""
    kind: RunKind = RunKind.SCORE
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

    def sources(self) -> Overrides:
        """Which stages of the grounding are done elsewhere.

        Raises:
            UsageError: something named is not there.
        """
        return Overrides(masks=self.masks, depth=self.depth, poses=self.poses, depth_exact=self.depth_exact)

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


def score_videos(config: ScoreConfig, observer: RunObserver | None = None) -> RunSummary:
    """Measure every video of `config.source` and fill the output folder.

    Raises:
        UsageError: the configuration, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.
    """
    observer = observer or NullRunObserver()
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
        observer.warn(warning)
    samples = (
        [replace(s, initial_state=None) for s in inputs.samples]
        if config.pixels_only
        else with_first_frames(inputs.samples)
    )
    measure = VideoEvaluator(
        kind=config.kind,
        out=config.out,
        stages=config.stages,
        stage_options=config.stage_options(),
        frame_period_s=config.frame_period_s,
        overlay=config.overlay,
        sources=sources,
    )
    summary = run_samples(config, samples, measure, observer)
    contradicted = sum(row.extra.get("first_frame") == InitialStateUse.CONTRADICTED.value for row in summary.rows)
    if contradicted:
        observer.warn(
            f"{contradicted} samples do not begin with the pose that their manifest tells, or that the episode of its "
            "task and seed has: it was not used"
        )
    clockless = sum(row.extra.get("frame_period_source") == PeriodSource.BENCHMARK.value for row in summary.rows)
    if clockless:
        observer.warn(
            f"{clockless} samples have no frame rate: {BENCHMARK_PERIOD_S} s between frames was taken, as in the "
            "benchmark; give --frame-period SECONDS if it is not so"
        )
    return summary
