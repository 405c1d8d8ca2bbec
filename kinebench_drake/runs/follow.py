"""`follow`: ground a clip and compare its motion with its actions, or with the real clip that it should show."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import CameraSetting, CameraSource
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.trajectory import TrajectorySample
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array, invert, make_pose
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.images import frame_files
from kinebench_drake.io.jsonl import Json
from kinebench_drake.io.video import Video
from kinebench_drake.metrics.following import Following, PoseSeries, measure_following
from kinebench_drake.models.panda.description import HAND_TO_TCP_M, hand_from_tcp
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.runs.commanded import Commands, find_actions, other_actions, read_commands
from kinebench_drake.runs.config import RunKind, ScoreConfig
from kinebench_drake.runs.frame_period import TimedFrames, time_frames
from kinebench_drake.runs.gate import close_gate
from kinebench_drake.runs.option import Option
from kinebench_drake.runs.preparation import (
    filmed_pictures,
    ground_sample,
    read_sample,
    row_warnings,
    with_camera_option,
    with_initial_states,
)
from kinebench_drake.runs.resources import Resources
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary, run_samples
from kinebench_drake.runs.score import VideoEvaluator, VideoMeasurement, find_videos
from kinebench_drake.segments import spread

if TYPE_CHECKING:  # loads torch and Open3D
    from kinebench_drake.grounding.video_result import GroundingResult

_FIT_STEP = 2
"""Every how many frames of the first half the camera is fitted to; none of them is judged."""
_CURVES = {"distance_m": "deviation_m", "angle_rad": "deviation_rad", "finger_m": "deviation_finger_m"}
_CURVES |= {"distance_px": "deviation_px"}
"""Fields of `Deviation`, and the names of their medians in rows and of their curves in track files."""


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
    reading: Annotated[
        Path | None,
        Option("How to read the actions (docs/formats.md).  [default: by their names]", metavar="FILE"),
    ] = None

    def trajectory_options(self) -> TrajectoryOptions:
        """Return the options of reading actions."""
        return TrajectoryOptions(reading=None if self.reading is None else Reading.parse(self.reading))


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """What a clip is compared with."""

    actions: TrajectorySample | None = None
    """Its actions."""
    other: TrajectorySample | None = None
    """Those of another clip, a control; None where all are equal."""
    reference: VideoSample | None = None
    """Its real clip."""


def follow_videos(config: FollowConfig, observer: RunObserver | None = None) -> RunSummary:
    """Compare every video of `config.source` with its actions, its real clip or both, and fill the output folder."""
    observer = observer or NullRunObserver()
    inputs = find_videos(config)
    for warning in inputs.warnings:
        observer.warn(warning)
    samples = list(inputs.samples) if config.pixels_only else with_initial_states(inputs.samples)
    evaluator = FollowEvaluator(config=config, overrides=config.overrides(), subjects=find_subjects(config, samples))
    summary = run_samples(samples, evaluator, observer)
    for warning in row_warnings(summary.rows):
        observer.warn(warning)
    return close_gate(config, summary)


def find_subjects(config: FollowConfig, samples: Sequence[VideoSample]) -> dict[str, Subject]:
    """Find what each video is compared with, by its id.

    Raises:
        UsageError: there are neither actions nor real clips of the videos.
    """
    references: dict[str, VideoSample] = {}
    actions: dict[str, TrajectorySample] = {}
    if config.reference is not None:
        listed = find_samples(config.reference, out=config.out, camera_key=config.camera_key).samples
        references = {s.id: s for s in with_camera_option(listed, config.camera, mirrored=config.mirrored)}
        if len(listed) == len(samples) == 1:
            references = {samples[0].id: references[listed[0].id]}
        if not references.keys() & {sample.id for sample in samples}:
            raise UsageError(f"$reference {config.reference} has no video with the id of one of those to compare")
    if config.actions is not None or config.reference is None or any(sample.actions for sample in samples):
        actions = find_actions(config.actions, samples, config.trajectory_options())
    others = other_actions(actions)
    ids = [sample.id for sample in samples]
    return {id: Subject(actions=actions.get(id), other=others.get(id), reference=references.get(id)) for id in ids}


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowEvaluator(VideoEvaluator):
    """Comparison of the videos of one run with their actions or real clips."""

    config: FollowConfig
    subjects: Mapping[str, Subject] = field(default_factory=dict)
    """What each video is compared with, by its id."""

    def evaluate(self, sample: VideoSample, tools: Resources, row: SampleRow) -> SampleRow:
        """Read, choose the camera, ground clip and real clip, compare, write."""
        subject = self.subjects[sample.id]
        if subject.actions is None and subject.reference is None:
            raise UnmeasurableError("there are neither actions nor a real clip of it")
        video = read_sample(sample)
        commands = self._commands(subject.actions, sample, video, tools)
        other = self._commands(subject.other, sample, video, tools)
        real: GroundingResult | None = None
        fitted: NDArray[np.intp] = np.empty(0, np.intp)
        if commands is not None and subject.reference is None and not sample.camera_source.is_named:
            sample, fitted = self._fit_camera(sample, video, commands, tools)
        if subject.reference is not None:
            reference = self._filmed_alike(subject.reference, sample)
            if commands is not None and not reference.camera_source.is_named:
                footage = read_sample(reference)
                reference, fitted = self._fit_camera(reference, footage, commands, tools)
            real = self._ground(reference, tools)
            sample = _filmed_as(sample, real)
        measurement = self.measure(sample, video, tools, row)
        if measurement.row.status is Status.OK:
            measurement = self._compare(measurement, commands, other, real, fitted)
        self.write(sample, video, tools, measurement)
        return measurement.row

    def _commands(
        self, actions: TrajectorySample | None, sample: VideoSample, video: Video, tools: Resources
    ) -> Commands | None:
        if actions is None:
            return None
        video.require_measurable()
        timed = self._timed(sample, video)
        return read_commands(actions, self.config.trajectory_options(), timed, len(video.frames), tools.plant)

    def _timed(self, sample: VideoSample, video: Video) -> TimedFrames:
        return time_frames(sample, video, self.config.frame_period_s, self.config.task_duration_s)

    def _fit_camera(
        self, sample: VideoSample, video: Video, commands: Commands, tools: Resources
    ) -> tuple[VideoSample, NDArray[np.intp]]:
        """Return the sample with a camera that is fitted to its arm in the commanded postures, and the frames used.

        Raises:
            UnmeasurableError: these do not determine it.
        """
        from kinebench_drake.grounding.camera.lens import USUAL_FOV_DEG, centred_camera, focal_px
        from kinebench_drake.grounding.camera.states import RobotStates

        timed = self._timed(sample, video)
        used = np.arange(0, len(timed.t_s) // 2, _FIT_STEP)
        t_s = timed.t_s[used]
        at = commands.series.at(t_s)
        states = RobotStates(
            q=commands.q_at(t_s),
            X_BH=at.X @ invert(hand_from_tcp()),
            finger_m=at.finger_width_m / 2.0,
            source=commands.source,
        )
        frames = filmed_pictures(sample, video)[0].frames[timed.rows[used]]
        width = video.width
        guess = centred_camera(width, video.height, focal_px(max(width, video.height), USUAL_FOV_DEG))
        try:
            fit = tools.calibrator.calibrate(frames, states, guess, focal_free=True, centre_free=True)
        except UnmeasurableError as error:
            raise UnmeasurableError(f"no camera is named, and none fits the actions: {error}") from None
        setting = CameraSetting(camera=fit.camera, table_height_m=sample.table_height_m)
        return sample.filmed_by(setting, CameraSource.FITTED), used

    def _filmed_alike(self, reference: VideoSample, sample: VideoSample) -> VideoSample:
        """Return the real clip with the camera of the generated one, where that is named."""
        if not sample.camera_source.is_named:
            return reference
        setting = CameraSetting(camera=sample.camera, table_height_m=sample.table_height_m)
        return reference.filmed_by(setting, sample.camera_source)

    def _ground(self, sample: VideoSample, tools: Resources) -> "GroundingResult":
        """Ground a real clip.

        Raises:
            UnmeasurableError: it cannot be measured.
        """
        config = self.config
        try:
            grounding = ground_sample(
                read_sample(sample), sample, Overrides(), tools.grounder, config.frame_period_s, config.gripper,
                duration_s=config.task_duration_s,
            )[1]  # fmt: skip
        except UnmeasurableError as error:
            raise UnmeasurableError(f"the real clip: {error}") from None
        if grounding.unmeasurable is not None:
            raise UnmeasurableError(f"the real clip: {grounding.unmeasurable}")
        return grounding

    def _compare(
        self,
        measurement: VideoMeasurement,
        commands: Commands | None,
        other: Commands | None,
        real: "GroundingResult | None",
        fitted: NDArray[np.intp],
    ) -> VideoMeasurement:
        """Return the measurement with what a clip does of its actions, and how far it is from its real clip."""
        grounding = measurement.grounding
        own: Comparison | None = None
        beside: Comparison | None = None
        real_follows: bool | None = None
        if real is not None:
            beside = compare_clips(grounding, real, self.config.seed)
            own = beside
        if commands is not None:
            used = fitted if real is None else fitted[:0]
            own = compare_actions(grounding, commands, other, used, self.config.seed)
            if real is not None:
                real_follows = compare_actions(real, commands, other, fitted, self.config.seed).follows
                own = own if real_follows else own.open("it is open whether the real clip follows its own actions")
        assert own is not None
        row = measurement.row.extended(**own.to_json())
        if commands is not None and beside is not None:
            row = row.extended(reference={**beside.to_json(), "real_follows": real_follows})
        return replace(measurement, row=row, curves=own.curves)

    def cache_key(self, sample: VideoSample) -> Mapping[str, Json]:
        """Return what determines the row of a scored video, and reading and parts of what it is compared with."""
        subject = self.subjects[sample.id]
        reading = self.config.trajectory_options().reading
        parts = [[a.format.value, a.part, a.rows, a.problem] for a in (subject.actions, subject.other) if a is not None]
        real = subject.reference
        return {
            **VideoEvaluator.cache_key(self, sample),
            "seed": self.config.seed,
            "actions": [None if reading is None else reading.to_json(), subject.actions is None, parts],
            "real": None
            if real is None
            else [*dataclasses.astuple(real.part), str(real.camera.to_json()), real.mirrored],
        }

    def input_files(self, sample: VideoSample) -> Sequence[Path]:
        """Return the files of the video, of its actions and those of the control, and of its real clip."""
        subject = self.subjects[sample.id]
        real = subject.reference
        tables = [a for a in (subject.actions, subject.other) if a is not None and a.problem is None]
        footage: Sequence[Path] = []
        if real is not None:
            footage = frame_files(real.path) if real.path.is_dir() else [real.path]
        files = (path for table in tables for path in (table.path, *table.about))
        return [*VideoEvaluator.input_files(self, sample), *files, *footage]


def _filmed_as(sample: VideoSample, real: "GroundingResult") -> VideoSample:
    """Return a generated clip with the camera of its real one, where that has a base frame and none is named."""
    if sample.camera_source.is_named or real.choice.reason is not None:
        return sample
    setting = CameraSetting(camera=real.camera, table_height_m=real.choice.table_height_m)
    return sample.filmed_by(setting, CameraSource.FITTED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A clip beside its actions or its real clip, as keys of its row and curves of its track file."""

    follows: bool | None
    reason: str
    numbers: Mapping[str, Json] = field(default_factory=dict)
    """Measures by their names in the row; none where nothing could be compared."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """(T,) deviations by their names in the track file; NaN where a frame is lost or not judged."""

    def open(self, reason: str) -> "Comparison":
        """Return the comparison without a verdict."""
        return self if self.follows is None else replace(self, follows=None, reason=f"{reason}: {self.reason}")

    def to_json(self) -> dict[str, Json]:
        """Return the keys of a row."""
        return {"follows": self.follows, "follow_reason": self.reason, **self.numbers}


def describe_following(result: Following, frames: NDArray[np.intp], count: int) -> Comparison:
    """Return a comparison, of a clip of `count` frames of which `frames` (N,) were compared."""
    curves = {name: getattr(result.deviation, key) for key, name in _CURVES.items()}
    onset = result.drift_from_frame
    return Comparison(
        follows=result.follows,
        reason=result.reason,
        numbers={
            "follow_share": result.share,
            "lag_frames": result.lag_frames,
            "gain": result.gain,
            **{name: result.median(key) for key, name in _CURVES.items()},
            "drift_from_frame": None if onset is None else int(frames[onset]),
            "drift_m": result.drift_m,
            "controls": dict(result.controls),
        },
        curves={name: spread(values, frames[: len(values)], count) for name, values in curves.items()},
    )


def compare_actions(
    grounding: "GroundingResult", commands: Commands, other: Commands | None, fitted: NDArray[np.intp], seed: int
) -> Comparison:
    """Compare a clip with its actions in the base frame, in all frames to which the camera was not `fitted` (K,)."""
    if grounding.choice.reason is not None:
        return Comparison(follows=None, reason=grounding.choice.reason)
    track = grounding.track
    frames = np.setdiff1d(np.arange(len(track.t_s)), fitted)
    image = grounding.frames.shape
    result = measure_following(
        PoseSeries.of_track(track).taken(frames),
        commands.series,
        np.random.default_rng(seed),
        other=None if other is None else other.series,
        camera=grounding.camera.resized(image[2], image[1]),
    )
    return describe_following(result, frames, len(track.t_s))


def compare_clips(grounding: "GroundingResult", real: "GroundingResult", seed: int) -> Comparison:
    """Compare a clip with its real one: in the base frame, or in the image where one of them has none."""
    track = grounding.track
    frames = np.arange(len(track.t_s))
    rng = np.random.default_rng(seed)
    image = grounding.frames.shape
    if grounding.choice.reason is None and real.choice.reason is None:
        camera = grounding.camera.resized(image[2], image[1])
        result = measure_following(PoseSeries.of_track(track), PoseSeries.of_track(real.track), rng, camera=camera)
        return describe_following(result, frames, len(frames))
    depths = (real.track.X_CH @ hand_from_tcp())[real.track.tracked, 2, 3]
    hand_px = real.camera.fx / real.camera.width * image[2] * HAND_TO_TCP_M / float(np.median(depths))
    own, reference = (_in_image(clip, image[2], hand_px) for clip in (grounding, real))
    result = measure_following(own, reference, rng)
    comparison = describe_following(result, frames, len(frames))
    apart_m = result.median("distance_m")
    hands = None if apart_m is None else apart_m / HAND_TO_TCP_M
    curves = dict(comparison.curves)
    curves["deviation_px"] = curves.pop("deviation_m") / HAND_TO_TCP_M * hand_px
    numbers = {
        **comparison.numbers,
        **{"deviation_m": None, "drift_m": None, "deviation_hands": hands},
        "deviation_px": None if hands is None else hands * hand_px,
    }
    return replace(comparison, numbers=numbers, curves=curves)


def _in_image(clip: "GroundingResult", width_px: int, hand_px: float) -> PoseSeries:
    """Return poses whose positions are those of the TCP in the image, in metres at the hand.

    Args:
        clip: a grounded clip.
        width_px: width of the image in which they are measured [px].
        hand_px: length of the hand in that image [px].
    """
    X_CG = clip.track.X_CH @ hand_from_tcp()
    uv = clip.camera.project(X_CG[:, :3, 3]) / clip.camera.width * width_px
    p = np.column_stack([uv * HAND_TO_TCP_M / hand_px, np.zeros(len(uv))])
    return PoseSeries.of_track(clip.track, make_pose(X_CG[:, :3, :3], p))
