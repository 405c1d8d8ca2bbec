"""`score`: read a video, prepare it, ground it, judge its track, write its files; `ground` leaves out the judgement.

One module, so that the way of one video can be read from top to bottom.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.datasets.manifest import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.datasets.trajectories.trajectory import SLOW_STEP_S
from kinebench_drake.datasets.videos.find import find_samples
from kinebench_drake.datasets.videos.sample import CameraSource, VideoSample, VideoSamples
from kinebench_drake.errors import InputError, UnmeasurableError, UsageError, count_noun, member_of
from kinebench_drake.evaluation.analyzer import Analyzer, load_analyzer
from kinebench_drake.evaluation.camera import (
    AUTO,
    BENCHMARK,
    CONFIRMED,
    CameraChoice,
    camera_frame_metrics,
    camera_warnings,
    check_camera,
    choose_camera,
    explain_loss,
    is_assumed,
    track_agreement,
    with_camera_option,
)
from kinebench_drake.evaluation.config import RunConfig, RunKind
from kinebench_drake.evaluation.evaluator import KINEMATIC_METRICS, MIN_TRACKED, Evaluation, Evaluator
from kinebench_drake.evaluation.runner import NullRunObserver, RunObserver, RunSummary, run_samples
from kinebench_drake.evaluation.thumbnail import encode_strip, worst_frame
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.atomic import disk_errors, write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.io.images import frame_files, read_image
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import WHOLE, Video
from kinebench_drake.results.inputs import PeriodSource
from kinebench_drake.results.provenance import weights_hash
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.suites.clock import CLIP_S, ClipTiming, sample_uniformly
from kinebench_drake.suites.start import START_WIDTH_M, start_q
from kinebench_drake.types import Domain, GripperKind, InitialState, InitialStateUse, Json, Priors

if TYPE_CHECKING:  # OpenCV, torch, Open3D and Drake take seconds to load
    from kinebench_drake.grounding.framing.framing import Framing
    from kinebench_drake.grounding.pipeline import GroundingResult

HAND_SHARE, ARM_SHARE = 0.1, 0.5
"""Share of tracked frames below which a hand counts as not seen, and from which on an arm does."""
BENCHMARK_PERIOD_S = 0.2
"""Task time between two frames of a benchmark video (4 control steps at 20 Hz) [s]."""
VISUAL_METRICS = ("tracked_fraction", "camera_motion_px", "arm_consistency_px", "anomalies")
"""Metrics of every row of a video; null where not measurable."""


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
        timing = None if self.clip_timing is None else member_of(ClipTiming, self.clip_timing, "--clip-timing")
        if duration_s is not None and timing is ClipTiming.NATIVE:
            raise UsageError("--task-duration needs --clip-timing uniform, found native; leave one of them out")
        if timing is ClipTiming.UNIFORM and duration_s is None:
            return CLIP_S
        if duration_s is not None and not MIN_PERIOD_S <= duration_s <= MAX_PERIOD_S:
            raise UsageError(
                f"--task-duration is {duration_s}, expected seconds from {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g}, such as "
                f"{CLIP_S:g}"
            )
        return duration_s

    @property
    def gripper_kind(self) -> GripperKind:
        """Gripper of the videos.

        Raises:
            UsageError: there is no such gripper.
        """
        return member_of(GripperKind, self.gripper, "--gripper")

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
            "gripper": self.gripper,
            "overlay": self.overlay,
            "pixels_only": self.pixels_only,
            **dict.fromkeys(("masks", "depth", "poses")),
            **self.overrides().names,
            "depth_exact": self.depth_exact,
        }


def score_videos(config: ScoreConfig, observer: RunObserver | None = None) -> RunSummary:
    """Evaluate every video of `config.source` and fill the output folder.

    Raises:
        UsageError: the configuration, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.
    """
    observer = observer or NullRunObserver()
    inputs = _find(config)
    for warning in inputs.warnings:
        observer.warn(warning)
    if config.pixels_only:
        samples = [replace(sample, initial_state=None) for sample in inputs.samples]
    else:
        samples = with_initial_states(inputs.samples)
    summary = run_samples(samples, VideoEvaluator(config=config, overrides=config.overrides()), observer)
    contradicted = sum(row.extra.get("first_frame") == InitialStateUse.CONTRADICTED.value for row in summary.rows)
    if contradicted:
        observer.warn(
            "the first frame contradicts the pose of the manifest, or of the episode of task and seed, in "
            f"{count_noun(contradicted, 'sample')}: the pose was not used"
        )
    for warning in camera_warnings(summary.rows):
        observer.warn(warning)
    without_clock = sum(row.extra.get("frame_period_source") == PeriodSource.BENCHMARK.value for row in summary.rows)
    if without_clock:
        observer.warn(
            f"no frame rate in {count_noun(without_clock, 'sample')}: {BENCHMARK_PERIOD_S} s between frames was "
            "assumed, as in the benchmark; set --frame-period SECONDS if it differs"
        )
    unfamiliar = sum(row.extra.get("domain") == Domain.UNFAMILIAR.value for row in summary.rows)
    if unfamiliar:
        observer.warn(
            f"{count_noun(unfamiliar, 'sample')} of unfamiliar look or viewpoint, or with an estimated camera: poses "
            "are fitted to edges, with a confidence of their own, and anomalies of the gripper's shape and number are "
            "not looked for"
        )
    return summary


def plan_videos(config: ScoreConfig, observer: RunObserver | None = None) -> Iterator[SampleRow]:
    """Read the videos of a run and yield a row of each with size, frame period and camera; nothing is written.

    Raises:
        UsageError: the configuration or the input cannot be used.
    """
    observer, inputs = observer or NullRunObserver(), _find(config)
    for warning in inputs.warnings:
        observer.warn(warning)
    reader = _VideoReader(config=config, overrides=config.overrides())
    analyzer = reader.setup()
    yield from (reader.row(sample, analyzer) for sample in config.select(inputs.samples))


def _find(config: ScoreConfig) -> VideoSamples:
    """List the videos of a run, with warnings about the input."""
    inputs = find_samples(
        config.source,
        out=config.out,
        model=config.model,
        task=config.task,
        others=tuple(config.overrides().folders.values()),
        camera_key=config.camera_key,
    )
    periods = [config.frame_period_s, *(s.frame_period_s or s.dataset_period_s for s in inputs.samples)]
    samples = tuple(with_camera_option(inputs.samples, config.camera))
    return replace(inputs, samples=samples, warnings=(*inputs.warnings, *period_warnings(periods)))


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoEvaluator(Evaluator[VideoSample, Analyzer]):
    """Evaluation of the videos of one run."""

    config: ScoreConfig
    overrides: Overrides
    """Stages of the grounding that are replaced."""

    def setup(self) -> Analyzer:
        """Load the robot."""
        return load_analyzer(self.config.make_analyzer, self.config.robot_options())

    def evaluate(self, sample: VideoSample, analyzer: Analyzer) -> Evaluation:
        """Read, prepare, ground, judge, write."""
        if sample.problem is not None:
            raise InputError(sample.problem)
        video = read_video(sample.path, sample.part)
        config = self.config
        choice, prepared, grounding = ground_with_camera(
            video, sample, self.overrides, analyzer, config.camera, config.frame_period_s, config.gripper_kind,
            duration_s=config.duration_s,
        )  # fmt: skip
        draws_hand = grounding.domain is not Domain.ARM
        track, path = choice.without_base(grounding.track), grounding.camera_path
        kinematics = analyzer.judge(track) if self.config.kind.judges and choice.reason is None else None
        smoothness: Mapping[str, Json] = {}
        reasons: Mapping[str, str] = {}
        if self.config.kind.judges and choice.reason is not None:
            smoothness, reasons = camera_frame_metrics(track, choice.reason)
        zoom = np.ones(len(track.t_s)) if path is None else path.zoom
        if self.config.overlay:
            file = artifact_path(self.config.out, "overlays", sample.id)
            native = len(prepared.frames) == len(video.frames)
            rate = float(np.clip((native and video.fps) or 1.0 / prepared.period_s, 1.0, 60.0))
            with disk_errors(f"overlays/{file.name}"):
                write_video(
                    file, analyzer.overlay(prepared.frames, prepared.camera, track, zoom, hand=draws_hand), rate
                )
        shown = np.unique([0, worst_frame(track, kinematics)])
        chosen = prepared.frames[shown], prepared.camera, track.at(shown), zoom[shown]
        images = list(analyzer.overlay(*chosen, hand=draws_hand))
        write_atomically(artifact_path(self.config.out, "thumbnails", sample.id), encode_strip(images))
        joints, curves = (kinematics.joints, kinematics.curves) if kinematics else (None, {})
        write_track(artifact_path(self.config.out, "tracks", sample.id), track, joints, {**curves, **grounding.curves})
        return Evaluation(
            kinematics=kinematics,
            metrics={
                "tracked_fraction": int(track.tracked.sum()) / len(track.t_s),
                "camera_motion_px": grounding.camera_motion_px,
                "arm_consistency_px": grounding.arm_consistency_px,
                "anomalies": [anomaly.to_json() for anomaly in grounding.anomalies],
                **smoothness,
            },
            reasons=reasons,
            tracked=track.tracked if self.config.kind.judges else None,
            extra={
                "first_frame": grounding.first_frame.value,
                "domain": grounding.domain.value,
                **({} if draws_hand else {"gripper": grounding.gripper.value}),
                "frames": len(track.t_s),
                "width": video.width,
                "height": video.height,
                "framing": prepared.framing.to_json(),
                "fps": video.fps,
                "frame_period_s": prepared.period_s,
                "frame_period_source": prepared.period_source.value,
                "clip_timing": prepared.timing.value,
                "clip_frames": len(video.frames),
                **({} if path is None else {"camera_path": path.to_json()}),
                **choice.to_json(),
            },
        )

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Visual metrics, and kinematic ones where tracks are judged."""
        return (*VISUAL_METRICS, *(KINEMATIC_METRICS if self.config.kind.judges else ()))

    @property
    def artifacts(self) -> tuple[str, ...]:
        """Tracks and thumbnails, and overlays where they are written."""
        return ("tracks", "thumbnails", *(["overlays"] if self.config.overlay else []))

    def cache_key(self, sample: VideoSample) -> Mapping[str, Json]:
        """Return weights, camera, clock, overrides and labels."""
        initial = sample.initial_state
        return {
            "weights": weights_hash(),
            "camera": sample.camera.to_json(),
            "camera_source": sample.camera_source.value,
            "option_period_s": self.config.frame_period_s,
            "task_duration_s": self.config.duration_s,
            "given": self._replaced(sample),
            "first": None if initial is None else [*initial.X_BG.ravel().tolist(), str(initial.finger_width_m)],
            "depth_exact": self.overrides.depth_exact,
            **({} if self.config.gripper_kind is GripperKind.AUTO else {"gripper": self.config.gripper}),
            **({"camera_option": AUTO} if is_assumed(sample, self.config.camera) else {}),
            "labels": [sample.seed, sample.prompt, sample.fps, sample.frame_period_s, sample.problem],
            "part": [*dataclasses.astuple(sample.part), sample.camera_key, sample.dataset_period_s],
        }

    def input_files(self, sample: VideoSample) -> Sequence[Path]:
        """Return the video's files, its conditioning image and its overrides."""
        if sample.problem is not None:
            return ()
        video = frame_files(sample.path) if sample.path.is_dir() else [sample.path]
        conditioning = [] if sample.first_frame is None else [sample.first_frame]
        return [*video, *conditioning, *self.overrides.files(override_names(sample))]

    def labels(self, sample: VideoSample) -> Mapping[str, Json]:
        """Return the camera's source, replaced stages, seed and prompt."""
        return {
            "camera_source": sample.camera_source.value,
            "given": self._replaced(sample),
            "seed": sample.seed,
            "prompt": sample.prompt,
            **({} if sample.camera_key is None else {"camera_key": sample.camera_key}),
        }

    def _replaced(self, sample: VideoSample) -> dict[str, Json]:
        """Return the estimates that are replaced, with the source of each."""
        return {**({"first_frame": "manifest"} if sample.initial_state else {}), **self.overrides.names}


@dataclass(frozen=True, slots=True, kw_only=True)
class _VideoReader(VideoEvaluator):
    """Evaluation that ends before the grounding."""

    def evaluate(self, sample: VideoSample, analyzer: Analyzer) -> Evaluation:
        """Read the video, check size and shape, determine its times."""
        if sample.problem is not None:
            raise InputError(sample.problem)
        video = read_video(sample.path, sample.part)
        video.require_measurable()
        assumed = is_assumed(sample, self.config.camera)
        if not assumed:
            _framing(sample, video)
        _, t_s, period_s, source = _clock(sample, video, self.config.frame_period_s, self.config.duration_s)
        return Evaluation(
            kinematics=None,
            extra={
                "frames": len(t_s),
                "width": video.width,
                "height": video.height,
                "frame_period_s": period_s,
                "frame_period_source": source.value,
                **({"camera_source": AUTO} if assumed else {}),
            },
        )


def choose_video_camera(
    video: Video, sample: VideoSample, option: str, overrides: Overrides, analyzer: Analyzer
) -> CameraChoice:
    """Choose the camera of a video: that of the input, or as `--camera` says.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        option: value of `--camera`.
        overrides: stages of the grounding that are replaced; poses need no camera to be found.
        analyzer: checks and estimates cameras.

    Raises:
        UnmeasurableError: the video is too small or too short.
    """
    video.require_measurable()
    if not is_assumed(sample, option) or overrides.poses is not None:
        return CameraChoice(sample=sample)
    try:
        framing = _framing(sample, video)
    except UnmeasurableError:
        return choose_camera(sample, video.frames, None, analyzer)
    return choose_camera(sample, video.frames, (framing.crop(video.frames), framing.camera(sample.camera)), analyzer)


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedVideo:
    """Input of the grounding."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB, without letter-box bars."""
    camera: Camera
    """Camera of these frames."""
    t_s: Array
    """(T,) task time of each frame [s]."""
    period_s: float
    """Task time between two frames [s]."""
    period_source: PeriodSource
    timing: ClipTiming
    """How the frames of the video lie in task time."""
    framing: "Framing"
    """How the camera's image lies in the video."""
    priors: Priors
    """Quantities that replace estimates."""


def prepare_video(
    video: Video,
    sample: VideoSample,
    period_s: float | None,
    overrides: Overrides,
    *,
    duration_s: float | None = None,
) -> PreparedVideo:
    """Determine frames, camera, times and priors of a video.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        period_s: task time between two frames from the command line [s].
        overrides: stages of the grounding that are replaced.
        duration_s: task time over which its frames lie evenly [s]; None: they are one period apart.

    Raises:
        InputError: an override is missing, broken or does not fit the video.
        UnmeasurableError: the video is too small or too short, or its shape does not fit the camera's image.
        SetupError: a plug-in cannot be loaded.
    """
    video.require_measurable()
    framing = _framing(sample, video)
    chosen, t_s, period_s, source = _clock(sample, video, period_s, duration_s)
    camera = framing.whole_camera(sample.camera)
    priors = overrides.priors(override_names(sample), video.frames, camera, sample.initial_state)
    priors = replace(priors, camera_is_fitted=sample.camera_source is CameraSource.ESTIMATED)
    frames = video.frames
    if len(chosen) < len(frames):
        frames, priors = frames[chosen], priors.at(chosen)
    return PreparedVideo(
        frames=framing.crop(frames),
        camera=framing.camera(sample.camera),
        t_s=t_s,
        period_s=period_s,
        period_source=source,
        timing=ClipTiming.NATIVE if duration_s is None else ClipTiming.UNIFORM,
        framing=framing,
        priors=priors.crop(*framing.window),
    )


def ground_prepared(
    video: PreparedVideo,
    analyzer: Analyzer,
    gripper: GripperKind = GripperKind.AUTO,
    *,
    measured: "GroundingResult | None" = None,
) -> "GroundingResult":
    """Track the hand through a prepared video, or the flange.

    Automatically the flange is measured where the hand is found in next to no frame, and the flange in most: by the
    links alone, else with the contours of a Robotiq 2F-85.

    Args:
        video: the video.
        analyzer: grounds.
        gripper: gripper of the video.
        measured: track of the gripper, if it is measured already.

    Raises:
        InputError: the priors do not fit the video.
        UnmeasurableError: the gripper was found in too few frames.
        SetupError: weights or libraries are missing.
    """
    inputs = video.frames, video.camera, video.t_s, video.priors
    measures_hand = gripper in (GripperKind.FRANKA, GripperKind.AUTO)
    grounding = measured or (analyzer.ground(*inputs) if measures_hand else analyzer.ground_arm(*inputs, gripper))
    tracked = int(grounding.track.tracked.sum())
    if gripper is GripperKind.AUTO and tracked < max(MIN_TRACKED, HAND_SHARE * len(video.t_s)):
        for other in (GripperKind.NONE, GripperKind.ROBOTIQ_2F85):
            arm = analyzer.ground_arm(*inputs, other)
            if arm.track.tracked.mean() >= ARM_SHARE:
                return arm
            if _is_empty(arm):  # contours of a gripper are sought where there is an arm
                break
    if tracked < MIN_TRACKED:
        share = f"in {tracked} of {len(video.t_s)} frames, a path needs {MIN_TRACKED}"
        if not measures_hand:
            raise UnmeasurableError(
                f"the flange was tracked {share}: its confidence is {grounding.track.confidence.max():.2f} at most; "
                "are wrist and forearm in view, and is this the video's camera?"
            )
        raise UnmeasurableError(
            f"the gripper was found {share}: is the robot in view, and is this the video's camera?"
            + (" With another gripper than Franka's take --gripper none." if gripper is GripperKind.FRANKA else "")
        )
    return grounding


def ground_with_camera(
    video: Video,
    sample: VideoSample,
    overrides: Overrides,
    analyzer: Analyzer,
    option: str = AUTO,
    period_s: float | None = None,
    gripper: GripperKind = GripperKind.AUTO,
    *,
    duration_s: float | None = None,
) -> tuple[CameraChoice, PreparedVideo, "GroundingResult"]:
    """Choose the camera of a video, ground the video, and check a camera of the input against the arm.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        overrides: stages of the grounding that are replaced; poses leave a camera unchecked.
        analyzer: checks and estimates cameras, grounds.
        option: value of `--camera`.
        period_s: task time between two frames [s]; None: the video's own.
        gripper: value of `--gripper`.
        duration_s: task time over which the frames lie evenly [s]; None: they are one period apart.

    Raises:
        InputError: an override does not fit the video.
        UnmeasurableError: the video is too small or too short, or the gripper was found in too few frames.
        SetupError: weights or libraries are missing.
    """
    measured = None
    if is_assumed(sample, option) and overrides.poses is None and gripper in (GripperKind.AUTO, GripperKind.FRANKA):
        with suppress(UnmeasurableError):  # the shape of the video is not that of the benchmark camera's image
            prepared = prepare_video(video, sample, period_s, overrides, duration_s=duration_s)
            measured, agreement = _ground_as_assumed(prepared, analyzer)
            if agreement >= CONFIRMED:
                return CameraChoice(sample=sample, agreement=agreement), prepared, measured
    if measured is not None and _is_empty(measured):  # nothing that could agree with another camera
        choice = CameraChoice(sample=sample)
    else:
        choice = choose_video_camera(video, sample, option, overrides, analyzer)
    if choice.sample is not sample or (measured is not None and not _is_complete(measured)):
        measured = None
    prepared = prepare_video(video, choice.sample, period_s, overrides, duration_s=duration_s)
    try:
        grounding = ground_prepared(prepared, analyzer, gripper, measured=measured)
    except UnmeasurableError as error:
        if overrides.poses is not None:
            raise
        raise UnmeasurableError(f"{error}{explain_loss(choice, prepared.frames, prepared.camera, analyzer)}") from None
    if overrides.poses is None and grounding.camera_path is None and grounding.domain is not Domain.ARM:
        choice = check_camera(choice, prepared.frames, prepared.camera, grounding, analyzer)
    return choice, prepared, grounding


def _ground_as_assumed(video: PreparedVideo, analyzer: Analyzer) -> "tuple[GroundingResult, float]":
    """Track the gripper with the benchmark camera; return also how well the arm confirms that camera, 0 to 1.

    Where edges contradict the camera poses are not refined, since another one is likely.
    """
    priors = replace(video.priors, camera_is_assumed=True)
    grounding = analyzer.ground(video.frames, video.camera, video.t_s, priors)
    if grounding.domain is not Domain.FAMILIAR or grounding.camera_path is not None:
        return grounding, 0.0
    return grounding, track_agreement(video.frames, video.camera, grounding, analyzer) or 0.0


def _is_complete(grounding: "GroundingResult") -> bool:
    """Return whether a track with an assumed camera is the same as with a certain one: refined, or there is nothing."""
    return grounding.domain is Domain.FAMILIAR or _is_empty(grounding)


def _is_empty(grounding: "GroundingResult") -> bool:
    """Return whether no frame has a pose."""
    return not grounding.track.confidence.any()


def with_initial_states(samples: Iterable[VideoSample]) -> list[VideoSample]:
    """Return the samples with the initial state of their task and seed, where the manifest names none.

    A video that begins elsewhere, such as the second clip of an episode, is detected by its first frame.

    Raises:
        SetupError: the Panda's files are missing.
    """
    from kinebench_drake.kinematics.plant import ArmPlant

    plant: ArmPlant | None = None
    completed = []
    for sample in samples:
        task, seed = sample.task, sample.seed
        if sample.initial_state is None and seed is not None and task is not None and task in START_WIDTH_M:
            plant = plant or ArmPlant()
            q = start_q(task, seed)
            initial = InitialState(X_BG=plant.forward(q[:7]), finger_width_m=float(q[7:].sum()))
            sample = replace(sample, initial_state=initial)
        completed.append(sample)
    return completed


def check_period(period_s: float | None) -> None:
    """Check a task time between two frames [s].

    Raises:
        UsageError: it is out of range.
    """
    if period_s is not None and not MIN_PERIOD_S <= period_s <= MAX_PERIOD_S:
        raise UsageError(
            f"--frame-period is {period_s}, expected seconds from {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g}, such as 0.2"
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


def override_names(sample: VideoSample) -> tuple[str, ...]:
    """Return the names that the sample's overrides may have: its id, or the name of the video."""
    if sample.part != WHOLE:
        return (sample.id,)
    stem = sample.path.name if sample.path.is_dir() else sample.path.stem
    return tuple(dict.fromkeys((sample.id, stem)))


def _clock(
    sample: VideoSample, video: Video, option_s: float | None, duration_s: float | None
) -> tuple[NDArray[np.intp], Array, float, PeriodSource]:
    """Return the frames to use, their task times [s], the period between two [s], and its source."""
    count = len(video.frames)
    if duration_s is None:
        return np.arange(count), *_times(sample, video, option_s)
    chosen, t_s = sample_uniformly(count, duration_s, option_s or BENCHMARK_PERIOD_S)
    return chosen, t_s, duration_s / (len(t_s) - 1), PeriodSource.TASK_DURATION


def _times(sample: VideoSample, video: Video, option_s: float | None) -> tuple[Array, float, PeriodSource]:
    """Return the task time of each frame [s], the period between two [s], and its source."""
    periods = {
        PeriodSource.MANIFEST: sample.frame_period_s,
        PeriodSource.OPTION: option_s,
        PeriodSource.MANIFEST_FPS: None if sample.fps is None else 1.0 / sample.fps,
        PeriodSource.DATASET: sample.dataset_period_s,
        PeriodSource.TIME_STAMPS: None if video.stamps_s is None else float(np.median(np.diff(video.stamps_s))),
        PeriodSource.FPS: None if video.fps is None else 1.0 / video.fps,
        PeriodSource.BENCHMARK: BENCHMARK_PERIOD_S,
    }
    period_s, source = next((period, source) for source, period in periods.items() if period is not None)
    if video.stamps_s is not None and source is PeriodSource.TIME_STAMPS:
        return video.stamps_s, period_s, source
    return np.arange(len(video.frames), dtype=np.float64) * period_s, period_s, source


def _framing(sample: VideoSample, video: Video) -> "Framing":
    """Determine how the camera's image lies in the video.

    Raises:
        UnmeasurableError: the shapes differ, and nothing explains it.
    """
    from kinebench_drake.grounding.framing.search import find_framing  # loads OpenCV

    try:
        conditioning = None if sample.first_frame is None else read_image(sample.first_frame)
    except InputError:
        conditioning = None  # an image with the name of the video need not be its conditioning image
    try:
        return find_framing(video.frames, sample.camera, conditioning)
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{sample.camera_source.value} {error}") from None
