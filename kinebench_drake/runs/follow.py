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
from kinebench_drake.grounding.priors import Clip
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.images import frame_files
from kinebench_drake.io.jsonl import Json
from kinebench_drake.io.video import Video
from kinebench_drake.metrics.following import Following, PoseSeries, find_onset, measure_following, worst_median
from kinebench_drake.models.panda.description import HAND_TO_TCP_M, GripperKind, hand_from_tcp
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.runs.commanded import Commands, choose_actions, find_actions, read_commands
from kinebench_drake.runs.config import FollowConfig
from kinebench_drake.runs.evaluator import judge_row
from kinebench_drake.runs.frame_period import TimedFrames, time_frames
from kinebench_drake.runs.gate import close_gate
from kinebench_drake.runs.pictures import encode_strip
from kinebench_drake.runs.preparation import (
    choose_view,
    filmed_pictures,
    ground_sample,
    read_sample,
    row_warnings,
    with_camera_option,
    with_initial_states,
)
from kinebench_drake.runs.resources import Resources
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary, run_samples
from kinebench_drake.runs.score import VideoEvaluator, find_videos
from kinebench_drake.segments import evenly, spread
from kinebench_drake.track import GripperTrack

if TYPE_CHECKING:  # loads torch and Open3D
    from kinebench_drake.grounding.camera.links import LinkAgreement
    from kinebench_drake.grounding.video_result import GroundingResult

_FIT_STEP = 2
"""Every how many frames a camera is fitted to; none of them is judged."""
_LINK_FRAMES = 48
"""Greatest number of frames in which the contours of the links are compared."""
_LAGS = (0.0, 1.0, 2.0)
"""Delays at which they are compared with a camera that is named, the best of each motion [frames]."""
_ALIKE_RAD = 0.05
"""Mean difference of joint angles below which the actions of another clip are the same motion [rad]."""
DRIFT_SHARE = 0.03
"""Deviation in pictures beyond which a clip has drifted, over their width: a third to half of a gripper's width in the
exterior views of 320x192 px that it was chosen for."""
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
    actions, references = _find_sources(config, samples)
    evaluator = FollowEvaluator(config=config, overrides=config.overrides(), actions=actions, references=references)
    summary = run_samples(samples, evaluator, observer)
    for warning in row_warnings(summary.rows):
        observer.warn(warning)
    return close_gate(config, summary)


def plan_following(config: FollowConfig) -> dict[str, list[str]]:
    """Return which actions and which real clip each video would be compared with, in words by the id of the video."""
    samples = find_videos(config).samples
    actions, references = _find_sources(config, samples)
    texts = [(id, f"actions: {path.name}") for id, path in actions.items()]
    texts += [(id, ", view ".join(filter(None, (f"real clip: {r.video}", r.view)))) for id, r in references.items()]
    nothing = ["nothing to compare with"]
    return {s.id: [text for id, text in texts if id == s.id] or nothing for s in samples}


def _find_sources(
    config: FollowConfig, samples: Sequence[VideoSample]
) -> tuple[dict[str, Path], dict[str, VideoSample]]:
    """Return the files of actions and the real clips of videos by their ids.

    Raises:
        UsageError: there are neither of any.
    """
    actions = {s.id: path for s in samples if (path := find_actions(config.actions, s)) is not None}
    references: dict[str, VideoSample] = {}
    if config.reference is not None:
        listed = find_samples(config.reference, out=config.out, camera_key=config.camera_key).samples
        viewed = [replace(s, view=config.reference_view or s.view) for s in listed]
        references = {s.id: s for s in with_camera_option(viewed, config.camera, mirrored=config.mirrored)}
        if len(listed) == len(samples) == 1:
            references = {samples[0].id: references[listed[0].id]}
    if not {s.id for s in samples} & (actions.keys() | references.keys()):
        raise UsageError(
            f"{config.source}: there are neither actions of its videos ($actions DIR with files such as "
            f"{samples[0].id}.npz, or the key actions of the manifest) nor real clips of the same ids ($reference PATH)"
        )
    return actions, references


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
        other = None
        with suppress(KinebenchError):  # of another clip: its own row has the error
            other = self._commands(self._next(sample.id), sample, video, tools)
        reference = self.references.get(sample.id)
        if commands is None and reference is None:
            raise UnmeasurableError("there are neither actions nor a real clip of it")
        is_named = sample.camera_source.is_named
        setting = CameraSetting(camera=sample.camera, table_height_m=sample.table_height_m) if is_named else None
        shown = sample if reference is None else reference.filmed_by(setting, sample.camera_source)
        fit = _CameraFit(sample=shown)
        if commands is not None and not shown.camera_source.is_named:
            fit = self._fit_camera(shown, commands, tools)
        real = None
        measurement = None
        comparison: Comparison = ({}, {})
        try:
            real = None if reference is None else self._ground(fit.sample, tools)
            if real is None:
                sample = fit.sample
            elif not is_named and real.choice.reason is None:
                setting = CameraSetting(camera=real.camera, table_height_m=real.choice.table_height_m)
                sample = sample.filmed_by(setting, CameraSource.FITTED)
            measurement = self.measure(sample, video, tools, row)
            reason = measurement.row.reason
        except UnmeasurableError as error:
            reason = str(error)
        is_tracked = measurement is not None and measurement.row.status is Status.OK
        has_franka = False
        if measurement is not None and is_tracked:
            comparison = self._compare(measurement.grounding, commands, other, real, fit.used, tools)
            has_franka = measurement.grounding.measured.gripper is GripperKind.FRANKA
        if reference is not None:
            comparison = self._add_pictures(comparison, reason, sample, fit.sample, tools)
        elif commands is not None and not has_franka:
            comparison = self._add_links(comparison, reason, fit, commands, other, tools)
        keys, curves = comparison
        if measurement is not None and (is_tracked or not keys):
            measurement = replace(measurement, row=measurement.row.extended(**keys), curves=curves)
            self.write(sample, video, tools, measurement)
            return measurement.row
        if not keys:
            raise UnmeasurableError(reason or "")
        return self._write_untracked(sample, tools, row.extended(**keys), curves)

    def _add_links(
        self,
        comparison: Comparison,
        reason: str | None,
        fit: "_CameraFit",
        commands: Commands,
        other: Commands | None,
        tools: Resources,
    ) -> Comparison:
        """Return a comparison with actions, without a verdict by poses with that of the links.

        Args:
            comparison: by poses; empty without any, with the `reason`.
        """
        keys, curves = comparison
        agreement = self._agree_links(fit, commands, other, tools) if keys.get("follows") is None else None
        if agreement is None:
            return comparison
        follows, by_links = agreement.decide()
        why = "; ".join(str(part) for part in (keys.get("follow_reason") or reason, by_links) if part)
        lag_frames = fit.lag_frames if keys.get("lag_frames") is None else keys["lag_frames"]
        own: dict[str, Json] = {"follows": follows, "follow_reason": why, "lag_frames": lag_frames}
        return {**keys, **own, "link_agreement": dict(agreement.means)}, curves

    def _add_pictures(
        self, comparison: Comparison, reason: str | None, sample: VideoSample, reference: VideoSample, tools: Resources
    ) -> Comparison:
        """Return a comparison with a real clip, without a deviation by poses with that of the pictures.

        Args:
            comparison: by poses; empty without any, with the `reason`.
        """
        keys, curves = comparison
        stored = keys.get("reference")
        beside = stored if isinstance(stored, Mapping) else keys
        if beside.get("deviation_px") is not None:
            return comparison
        pictured, picture_curves = self._compare_pictures(sample, reference, reason, tools)
        if beside is keys:
            return {**keys, **pictured}, {**curves, **picture_curves}
        return {**keys, "reference": {**beside, **pictured}}, curves

    def _agree_links(
        self, fit: "_CameraFit", commands: Commands, other: Commands | None, tools: Resources
    ) -> "LinkAgreement | None":
        """Return how well the links agree with frames to which no camera was fitted; None without joint angles."""
        from kinebench_drake.grounding.camera.links import LinkAgreement

        timed, frames = self._pictures(fit.sample, tools)
        last_s = commands.series.t_s[-1] + 0.5 * timed.period_s
        rows = np.setdiff1d(np.flatnonzero(timed.t_s <= last_s), fit.used)
        rows = rows[evenly(len(rows), _LINK_FRAMES)]
        lags = _LAGS if fit.lag_frames is None else (fit.lag_frames,)
        camera = fit.sample.camera.resized(frames.shape[2], frames.shape[1])
        best: dict[str, Array] = {}
        for lag in lags:
            postures = _choose_postures(commands, other, timed.t_s[rows] - lag * timed.period_s, self.config.seed)
            if not np.isfinite(list(postures.values())).all():
                return None
            shares = tools.calibrator.compare_links(frames[rows], camera, list(postures.values()))
            for name, values in zip(postures, shares, strict=True):
                best[name] = max((best.get(name, values), values), key=np.mean)
        return LinkAgreement(own=best.pop("own"), controls=best)

    def _compare_pictures(
        self, sample: VideoSample, reference: VideoSample, reason: str | None, tools: Resources
    ) -> Comparison:
        """Compare a clip with its real one by the displacement of what moves; empty if their frames differ in number.

        Args:
            reason: why there are no poses.
        """
        from kinebench_drake.grounding.displacement import measure_displacement

        clip = self._pictures(sample, tools)[1]
        real = self._pictures(reference, tools)[1]
        count = min(len(clip), len(real))
        if clip.shape[1:] != real.shape[1:]:
            return {}, {}
        result = measure_displacement(clip[:count], real[:count])
        lost = int(np.isnan(result.distance_px).sum())
        why = (
            f"{f'{reason}; ' if reason else ''}compared by the displacement of what moves in "
            f"{len(result.frames)} frames, {lost} of them without counterpart, which gives no verdict"
        )
        onset = find_onset(result.distance_px <= DRIFT_SHARE * real.shape[2])
        keys: dict[str, Json] = {
            "follows": None,
            "follow_reason": why,
            "deviation_px": worst_median(result.distance_px),
            "reference_error_px": result.error_px,
            "drift_from_frame": None if onset is None else int(result.frames[onset]),
        }
        return keys, {"deviation_px": spread(result.distance_px, result.frames, len(clip))}

    def _write_untracked(
        self, sample: VideoSample, tools: Resources, row: SampleRow, curves: Mapping[str, Array]
    ) -> SampleRow:
        """Write the files of a clip without poses, and return its row."""
        timed, frames = self._pictures(sample, tools)
        count = len(frames)
        track = GripperTrack.untracked(timed.t_s)
        write_atomically(artifact_path(self.config.out, "thumbnails", sample.id), encode_strip([frames[0], frames[-1]]))
        write_track(artifact_path(self.config.out, "tracks", sample.id), track, None, curves)
        if self.config.overlay:
            rate = float(np.clip(1.0 / timed.period_s, 1.0, 60.0))
            write_video(artifact_path(self.config.out, "overlays", sample.id), frames, rate)
        return judge_row(row, None).extended(
            frames=count,
            width=frames.shape[2],
            height=frames.shape[1],
            frame_period_s=timed.period_s,
            frame_period_source=timed.source.value,
        )

    def _next(self, id: str) -> str:
        """Return the next video, by id, with other actions; where all have those of one file, the next one."""
        ids = sorted(self.actions)
        turned = [*(other for other in ids if other > id), *ids]
        own = self.actions.get(id)
        return next((other for other in turned if self.actions[other] != own), turned[0] if turned else id)

    def _commands(self, id: str, sample: VideoSample, video: Video, tools: Resources) -> Commands | None:
        """Read the actions of the video `id` at the times of a video; None without any."""
        if id not in self.actions:
            return None
        timed = time_frames(sample, video, self.config.frame_period_s, self.config.task_duration_s)
        choice = self.config.trajectory_options()
        chosen = choose_actions(self.actions[id], id, choice)
        return read_commands(chosen, choice, timed, len(video.frames), tools.plant)

    def _pictures(self, sample: VideoSample, tools: Resources) -> tuple[TimedFrames, Frames]:
        """Return the times of a clip and its frames (T, H, W, 3), of tiles the panel that is measured."""
        video = read_sample(sample)
        timed = time_frames(sample, video, self.config.frame_period_s, self.config.task_duration_s)
        panels = choose_view(video, sample.view or self.config.view, tools.grounder)
        return timed, filmed_pictures(sample, video, panels)[0].frames[timed.rows]

    def _fit_camera(self, sample: VideoSample, commands: Commands, tools: Resources) -> "_CameraFit":
        """Fit the camera of a video to its arm in the commanded postures.

        Raises:
            UnmeasurableError: these do not determine it.
        """
        from kinebench_drake.grounding.camera.lens import USUAL_FOV_DEG, centred_camera, focal_px
        from kinebench_drake.grounding.camera.states import RobotStates

        timed, frames = self._pictures(sample, tools)
        at = commands.series.at(timed.t_s)
        is_commanded = timed.t_s <= commands.series.t_s[-1] + 0.5 * timed.period_s
        states = RobotStates(
            q=np.where(is_commanded[:, None], commands.q_at(timed.t_s), np.nan),
            X_BH=np.where(is_commanded[:, None, None], at.X @ invert(hand_from_tcp()), np.nan),
            finger_m=at.finger_width_m / 2.0,
            source=commands.source,
        )
        used = np.arange(0, len(frames), _FIT_STEP)
        height, width = frames.shape[1:3]
        guess = centred_camera(width, height, focal_px(max(width, height), USUAL_FOV_DEG))
        try:
            fit = tools.calibrator.calibrate(
                frames, states, guess, focal_free=True, centre_free=True, gripper=self.config.gripper, rows=used
            )
        except UnmeasurableError as error:
            raise UnmeasurableError(f"no camera is named, and none fits the actions: {error}") from None
        setting = CameraSetting(camera=fit.camera, table_height_m=sample.table_height_m)
        lag = None if fit.links is None else fit.links.lag
        lag_frames = 0.0 - lag.frames if lag is not None and lag.is_determined else None
        return _CameraFit(sample=sample.filmed_by(setting, CameraSource.FITTED), used=used, lag_frames=lag_frames)

    def _ground(self, sample: VideoSample, tools: Resources) -> "GroundingResult":
        """Ground a real clip.

        Raises:
            UnmeasurableError: it cannot be measured.
        """
        c = self.config
        video = read_sample(sample)
        try:
            real = ground_sample(
                video, sample, Overrides(), tools.grounder, c.frame_period_s, c.gripper,
                duration_s=c.task_duration_s, view=c.view,
            )[1]  # fmt: skip
            reason = real.unmeasurable
        except UnmeasurableError as error:
            reason = str(error)
        if reason is not None:
            raise UnmeasurableError(f"the real clip: {reason}")
        return real

    def _compare(
        self,
        clip: "GroundingResult",
        commands: Commands | None,
        other: Commands | None,
        real: "GroundingResult | None",
        fitted: NDArray[np.intp],
        tools: Resources,
    ) -> Comparison:
        """Return what a clip does of its actions, and how far it is from its real clip.

        A clip has no verdict against its actions where its real clip has none, or does not follow them, either.
        """
        seed = self.config.seed
        keys: dict[str, Json] = {}
        curves: dict[str, Array] = {}
        if real is not None:
            keys, curves = compare_clips(clip, real, _ground_again(real, tools), seed)
        if commands is not None:
            beside = keys
            keys, curves = compare_actions(clip, commands, other, fitted if real is None else fitted[:0], seed)
            if real is not None:
                follows = compare_actions(real, commands, other, fitted, seed)[0]["follows"]
                keys["reference"] = {**beside, "real_follows": follows}
                if not follows:
                    keys |= {"follows": None, "follow_reason": "the real clip does not follow these actions, either"}
        return keys, curves

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
            "real": None
            if real is None
            else [*dataclasses.astuple(real.part), real.camera.to_json(), real.mirrored, real.view],
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _CameraFit:
    """A video with the camera by which it is compared with actions."""

    sample: VideoSample
    used: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    """(N,) numbers of the frames that the camera may have been fitted to."""
    lag_frames: float | None = None
    """Delay of the links behind the actions; None unless the camera was fitted to the links alone and determines it."""


def _choose_postures(commands: Commands, other: Commands | None, t_s: Array, seed: int) -> dict[str, Array]:
    """Return joint angles (N, 7) [rad] at times (N,) [s], `own` ones and those of the controls."""
    own = commands.q_at(t_s)
    shuffled = own if other is None else other.q_at(t_s)
    if np.abs(shuffled - own).mean() < _ALIKE_RAD:
        shuffled = np.random.default_rng(seed).permutation(own)
    return {"own": own, "shuffled": shuffled, "reversed": own[::-1], "still": np.repeat(own[:1], len(own), axis=0)}


def _ground_again(real: "GroundingResult", tools: Resources) -> "GroundingResult | None":
    """Ground a real clip after a second coding, with the camera that it has; None if that fails."""
    from kinebench_drake.grounding.displacement import recode

    clip = Clip(frames=np.stack([recode(frame) for frame in real.frames]), t_s=real.track.t_s)
    with suppress(UnmeasurableError):
        return tools.grounder.ground(clip, real.camera, gripper=real.measured.gripper, trusts_camera=True)
    return None


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
    """Compare a clip with its actions in the base frame, in all frames to which the camera was not `fitted` (K,).

    The mount of a Robotiq 2F-85 varies: its poses confirm a motion, and contradict none.
    """
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
    if result.follows is False and clip.measured.gripper is GripperKind.ROBOTIQ_2F85:
        why = f"{result.reason}; how the Robotiq 2F-85 is mounted is not stated, so its poses contradict nothing"
        return {"follows": None, "follow_reason": why}, {}
    return _describe(result, frames, len(clip.frames))


def compare_clips(
    clip: "GroundingResult", real: "GroundingResult", again: "GroundingResult | None", seed: int
) -> Comparison:
    """Compare a clip with its real one: in the base frame, or in the image where one of them has none.

    `again` is the real clip after a second coding: the error of the tracker is no less than their difference.
    """
    rng = np.random.default_rng(seed)
    frames = np.arange(len(clip.frames))
    height, width = clip.frames.shape[1:3]
    if clip.choice.reason is None and real.choice.reason is None:
        own = PoseSeries.of_track(clip.track)
        series = PoseSeries.of_track(real.track)
        if again is not None:
            series = series.repeated(PoseSeries.of_track(again.measured.track))
        camera = clip.camera.resized(width, height)
        keys, curves = _describe(measure_following(own, series, rng, camera=camera), frames, len(frames))
        return {**keys, "reference_error_m": series.sigma_m}, curves
    depth_m = float(np.median((real.track.X_CH @ hand_from_tcp())[real.track.tracked, 2, 3]))
    hand_px = real.camera.fx / real.camera.width * width * HAND_TO_TCP_M / depth_m
    px_per_m = hand_px / HAND_TO_TCP_M
    series = _in_image(real, width, hand_px)
    if again is not None:
        series = series.repeated(_in_image(again, width, hand_px))
    result = measure_following(_in_image(clip, width, hand_px), series, rng)
    keys, curves = _describe(result, frames, len(frames))
    curves["deviation_px"] = curves.pop("deviation_m") * px_per_m
    apart_m = result.median("distance_m")
    if apart_m is not None:
        keys |= {"deviation_hands": apart_m / HAND_TO_TCP_M, "deviation_px": apart_m * px_per_m}
    return {**keys, "deviation_m": None, "drift_m": None, "reference_error_px": series.sigma_m * px_per_m}, curves


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
