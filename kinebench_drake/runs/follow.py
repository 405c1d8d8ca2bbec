"""`follow`: ground a clip and compare its motion with its actions, or with the real clip that it should show."""

import dataclasses
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import CameraSetting, CameraSource
from kinebench_drake.errors import KinebenchError, UnmeasurableError, UsageError
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
from kinebench_drake.runs.commanded import Commands, choose_actions, find_actions, read_commands
from kinebench_drake.runs.config import FollowConfig
from kinebench_drake.runs.frame_period import time_frames
from kinebench_drake.runs.gate import close_gate
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
_NAMES = {"distance_m": "deviation_m", "angle_rad": "deviation_rad", "finger_m": "deviation_finger_m"}
_NAMES |= {"distance_px": "deviation_px"}
"""Fields of `Deviation`, and the names of their medians in rows and of their curves in track files."""
Comparison = tuple[dict[str, Json], dict[str, Array]]
"""Keys of a row, and curves (T,) of its track file: NaN where a frame is lost or not judged."""


def follow_videos(config: FollowConfig, observer: RunObserver | None = None) -> RunSummary:
    """Compare every video of `config.source` with its actions, its real clip or both, and fill the output folder.

    Raises:
        UsageError: there are neither actions nor real clips of any.
    """
    observer = observer or NullRunObserver()
    inputs = find_videos(config)
    for warning in inputs.warnings:
        observer.warn(warning)
    samples = list(inputs.samples) if config.pixels_only else with_initial_states(inputs.samples)
    actions = {s.id: path for s in samples if (path := find_actions(config.actions, s)) is not None}
    references: dict[str, VideoSample] = {}
    if config.reference is not None:
        listed = find_samples(config.reference, out=config.out, camera_key=config.camera_key).samples
        references = {s.id: s for s in with_camera_option(listed, config.camera, mirrored=config.mirrored)}
        if len(listed) == len(samples) == 1:
            references = {samples[0].id: references[listed[0].id]}
    if not {s.id for s in samples} & (actions.keys() | references.keys()):
        raise UsageError(
            f"{config.source}: there are neither actions of its videos ($actions DIR with files such as "
            f"{samples[0].id}.npz, or the key actions of the manifest) nor real clips of the same ids ($reference PATH)"
        )
    evaluator = FollowEvaluator(config=config, overrides=config.overrides(), actions=actions, references=references)
    summary = run_samples(samples, evaluator, observer)
    for warning in row_warnings(summary.rows):
        observer.warn(warning)
    return close_gate(config, summary)


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowEvaluator(VideoEvaluator):
    """Comparison of the videos of one run with their actions or real clips."""

    config: FollowConfig
    actions: Mapping[str, Path] = field(default_factory=dict)
    """File or data set of the actions, by the id of the video."""
    references: Mapping[str, VideoSample] = field(default_factory=dict)
    """Real clips, likewise."""

    def evaluate(self, sample: VideoSample, tools: Resources, row: SampleRow) -> SampleRow:
        """Read, choose the camera, ground clip and real clip, compare, write."""
        video = read_sample(sample)
        video.require_measurable()
        commands = self._commands(sample.id, sample, video, tools)
        reference = self.references.get(sample.id)
        if commands is None and reference is None:
            raise UnmeasurableError("there are neither actions nor a real clip of it")
        is_named = sample.camera_source.is_named
        setting = CameraSetting(camera=sample.camera, table_height_m=sample.table_height_m) if is_named else None
        shown = sample if reference is None else reference.filmed_by(setting, sample.camera_source)
        fitted: NDArray[np.intp] = np.empty(0, np.intp)
        if commands is not None and not shown.camera_source.is_named:
            shown, fitted = self._fit_camera(shown, commands, tools)
        real = None if reference is None else self._ground(shown, tools)
        if real is None:
            sample = shown
        elif not is_named and real.choice.reason is None:
            setting = CameraSetting(camera=real.camera, table_height_m=real.choice.table_height_m)
            sample = sample.filmed_by(setting, CameraSource.FITTED)
        measurement = self.measure(sample, video, tools, row)
        if measurement.row.status is Status.OK:
            other = None
            with suppress(KinebenchError):  # of another clip: its own row has the error
                other = self._commands(self._next(sample.id), sample, video, tools)
            measurement = self._compare(measurement, commands, other, real, fitted)
        self.write(sample, video, tools, measurement)
        return measurement.row

    def _next(self, id: str) -> str:
        """Return the next video, by id, with actions."""
        ids = sorted(self.actions)
        return next((other for other in ids if other > id), ids[0] if ids else id)

    def _commands(self, id: str, sample: VideoSample, video: Video, tools: Resources) -> Commands | None:
        """Read the actions of the video `id` at the times of a video; None without any."""
        if id not in self.actions:
            return None
        timed = time_frames(sample, video, self.config.frame_period_s, self.config.task_duration_s)
        choice = self.config.trajectory_options()
        chosen = choose_actions(self.actions[id], id, choice)
        return read_commands(chosen, choice, timed, len(video.frames), tools.plant)

    def _fit_camera(
        self, sample: VideoSample, commands: Commands, tools: Resources
    ) -> tuple[VideoSample, NDArray[np.intp]]:
        """Return a video with the camera that is fitted to its arm in the commanded postures, and the frames used.

        Raises:
            UnmeasurableError: these do not determine it.
        """
        from kinebench_drake.grounding.camera.lens import USUAL_FOV_DEG, centred_camera, focal_px
        from kinebench_drake.grounding.camera.states import RobotStates

        video = read_sample(sample)
        timed = time_frames(sample, video, self.config.frame_period_s, self.config.task_duration_s)
        used = np.arange(0, len(timed.t_s) // 2, _FIT_STEP)
        at = commands.series.at(timed.t_s[used])
        states = RobotStates(
            q=np.column_stack([np.interp(at.t_s, commands.series.t_s, column) for column in commands.q.T]),
            X_BH=at.X @ invert(hand_from_tcp()),
            finger_m=at.finger_width_m / 2.0,
            source=commands.source,
        )
        frames = filmed_pictures(sample, video)[0].frames[timed.rows[used]]
        guess = centred_camera(video.width, video.height, focal_px(max(video.width, video.height), USUAL_FOV_DEG))
        try:
            fit = tools.calibrator.calibrate(frames, states, guess, focal_free=True, centre_free=True)
        except UnmeasurableError as error:
            raise UnmeasurableError(f"no camera is named, and none fits the actions: {error}") from None
        setting = CameraSetting(camera=fit.camera, table_height_m=sample.table_height_m)
        return sample.filmed_by(setting, CameraSource.FITTED), used

    def _ground(self, sample: VideoSample, tools: Resources) -> "GroundingResult":
        """Ground a real clip.

        Raises:
            UnmeasurableError: it cannot be measured.
        """
        c = self.config
        video = read_sample(sample)
        try:
            real = ground_sample(
                video, sample, Overrides(), tools.grounder, c.frame_period_s, c.gripper, duration_s=c.task_duration_s
            )[1]
            reason = real.unmeasurable
        except UnmeasurableError as error:
            reason = str(error)
        if reason is not None:
            raise UnmeasurableError(f"the real clip: {reason}")
        return real

    def _compare(
        self,
        measurement: VideoMeasurement,
        commands: Commands | None,
        other: Commands | None,
        real: "GroundingResult | None",
        fitted: NDArray[np.intp],
    ) -> VideoMeasurement:
        """Return the measurement with what a clip does of its actions, and how far it is from its real clip.

        A clip has no verdict against its actions where its real clip has none, or does not follow them, either.
        """
        seed = self.config.seed
        clip = measurement.grounding
        keys: dict[str, Json] = {}
        curves: dict[str, Array] = {}
        if real is not None:
            keys, curves = compare_clips(clip, real, seed)
        if commands is not None:
            beside = keys
            keys, curves = compare_actions(clip, commands, other, fitted if real is None else fitted[:0], seed)
            if real is not None:
                follows = compare_actions(real, commands, other, fitted, seed)[0]["follows"]
                keys["reference"] = {**beside, "real_follows": follows}
                if not follows:
                    keys |= {"follows": None, "follow_reason": "the real clip does not follow these actions, either"}
        return replace(measurement, row=measurement.row.extended(**keys), curves=curves)

    def cache_key(self, sample: VideoSample) -> Mapping[str, Json]:
        """Return what determines the row of a scored video, and how actions and real clip are read."""
        real = self.references.get(sample.id)
        reading = self.config.trajectory_options().reading
        return {
            **VideoEvaluator.cache_key(self, sample),
            "seed": self.config.seed,
            "actions": [
                None if reading is None else reading.to_json(),
                sample.id in self.actions,
                self._next(sample.id),
            ],
            "real": None if real is None else [*dataclasses.astuple(real.part), real.camera.to_json(), real.mirrored],
        }

    def input_files(self, sample: VideoSample) -> Sequence[Path]:
        """Return the files of the video, of its actions and those of the control, and of its real clip."""
        files = list(VideoEvaluator.input_files(self, sample))
        for id in dict.fromkeys((sample.id, self._next(sample.id))):
            with suppress(KinebenchError, KeyError):  # of none, or none that can be read
                chosen = choose_actions(self.actions[id], id, self.config.trajectory_options())
                files += [chosen.path, *chosen.about]
        if (real := self.references.get(sample.id)) is not None:
            files += frame_files(real.path) if real.path.is_dir() else [real.path]
        return files


def _describe(result: Following, frames: NDArray[np.intp], count: int) -> Comparison:
    """Return keys and curves of a clip of `count` frames, of which `frames` (N,) were compared."""
    onset = result.drift_from_frame
    keys: dict[str, Json] = {
        "follows": result.follows,
        "follow_reason": result.reason,
        "follow_share": result.share,
        "lag_frames": result.lag_frames,
        "gain": result.gain,
        **{name: result.median(key) for key, name in _NAMES.items()},
        "drift_from_frame": None if onset is None else int(frames[onset]),
        "drift_m": result.drift_m,
        "controls": dict(result.controls),
    }
    curves = {name: getattr(result.deviation, key) for key, name in _NAMES.items()}
    return keys, {name: spread(values, frames[: len(values)], count) for name, values in curves.items()}


def compare_actions(
    clip: "GroundingResult", commands: Commands, other: Commands | None, fitted: NDArray[np.intp], seed: int
) -> Comparison:
    """Compare a clip with its actions in the base frame, in all frames to which the camera was not `fitted` (K,)."""
    if clip.choice.reason is not None:
        return {"follows": None, "follow_reason": clip.choice.reason}, {}
    frames = np.setdiff1d(np.arange(len(clip.frames)), fitted)
    result = measure_following(
        PoseSeries.of_track(clip.track).taken(frames),
        commands.series,
        np.random.default_rng(seed),
        other=None if other is None else other.series,
        camera=clip.camera.resized(clip.frames.shape[2], clip.frames.shape[1]),
    )
    return _describe(result, frames, len(clip.frames))


def compare_clips(clip: "GroundingResult", real: "GroundingResult", seed: int) -> Comparison:
    """Compare a clip with its real one: in the base frame, or in the image where one of them has none."""
    rng = np.random.default_rng(seed)
    frames = np.arange(len(clip.frames))
    height, width = clip.frames.shape[1:3]
    if clip.choice.reason is None and real.choice.reason is None:
        own = PoseSeries.of_track(clip.track)
        camera = clip.camera.resized(width, height)
        return _describe(
            measure_following(own, PoseSeries.of_track(real.track), rng, camera=camera), frames, len(frames)
        )
    depth_m = float(np.median((real.track.X_CH @ hand_from_tcp())[real.track.tracked, 2, 3]))
    hand_px = real.camera.fx / real.camera.width * width * HAND_TO_TCP_M / depth_m
    result = measure_following(_in_image(clip, width, hand_px), _in_image(real, width, hand_px), rng)
    keys, curves = _describe(result, frames, len(frames))
    curves["deviation_px"] = curves.pop("deviation_m") * hand_px / HAND_TO_TCP_M
    apart_m = result.median("distance_m")
    if apart_m is not None:
        keys |= {"deviation_hands": apart_m / HAND_TO_TCP_M, "deviation_px": apart_m * hand_px / HAND_TO_TCP_M}
    return {**keys, "deviation_m": None, "drift_m": None}, curves


def _in_image(clip: "GroundingResult", width_px: int, hand_px: float) -> PoseSeries:
    """Return poses whose positions are those of the TCP in the image, in metres at the hand.

    Args:
        clip: a grounded clip.
        width_px: width of the image in which they are measured [px].
        hand_px: length of the hand in that image [px].
    """
    X_CG = clip.track.X_CH @ hand_from_tcp()
    uv_px = clip.camera.project(X_CG[:, :3, 3]) / clip.camera.width * width_px
    p = np.column_stack([uv_px * HAND_TO_TCP_M / hand_px, np.zeros(len(uv_px))])
    return PoseSeries.of_track(clip.track, make_pose(X_CG[:, :3, :3], p))
