"""`score`: read a video, ground it, judge its track, write its files; `ground` leaves out the judgement."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinebench_drake.camera import CameraSource
from kinebench_drake.environment.precision import network_precision
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.formats.videos.sample import VideoSample, VideoSamples
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.io.images import frame_files
from kinebench_drake.io.jsonl import Json
from kinebench_drake.io.video import Video
from kinebench_drake.metrics.recording_faults import fingerprint, idle_ends
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.results.provenance import weights_hash
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.runs.action_export import require_own_folder, write_actions
from kinebench_drake.runs.config import AUTO, ScoreConfig, period_warnings
from kinebench_drake.runs.evaluator import EXECUTABILITY, KINEMATIC_METRICS, Evaluator, fail_row, judge_row
from kinebench_drake.runs.frame_period import TimedFrames, time_frames
from kinebench_drake.runs.gate import close_gate
from kinebench_drake.runs.pictures import encode_strip, worst_frame
from kinebench_drake.runs.preparation import (
    camera_frame_metrics,
    choose_view,
    filmed_pictures,
    ground_sample,
    override_names,
    read_sample,
    row_warnings,
    with_camera_option,
    with_initial_states,
)
from kinebench_drake.runs.resources import Resources, load_resources
from kinebench_drake.runs.resume import hash_sample
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary, run_samples
from kinebench_drake.track import GripperTrack

if TYPE_CHECKING:  # loads torch and Open3D
    from kinebench_drake.grounding.camera.watch import CameraWatch
    from kinebench_drake.grounding.video_result import GroundingResult
    from kinebench_drake.metrics.kinematic_result import KinematicResult

VISUAL_METRICS = ("tracked_fraction", "confidence_mean", "camera_motion_px", "arm_consistency_px", "anomalies")
"""Metrics of every row of a video; null where not measurable."""


def score_videos(config: ScoreConfig, observer: RunObserver | None = None) -> RunSummary:
    """Evaluate every video of `config.source` and fill the output folder."""
    observer = observer or NullRunObserver()
    if config.format is not None:
        require_own_folder(config.format, config.out)
    inputs = find_videos(config)
    for warning in inputs.warnings:
        observer.warn(warning)
    if config.pixels_only:
        samples = [replace(sample, initial_state=None) for sample in inputs.samples]
    else:
        samples = with_initial_states(inputs.samples)
    summary = run_samples(samples, VideoEvaluator(config=config, overrides=config.overrides()), observer)
    for warning in row_warnings(summary.rows):
        observer.warn(warning)
    if config.format is not None:
        write_actions(config.format, config.out, samples, summary.rows, observer.warn)
    return close_gate(config, summary)


def mean_confidence(track: GripperTrack) -> float | None:
    """Return the mean confidence of the tracked frames; None if there are none."""
    return round(float(track.confidence[track.tracked].mean()), 4) if track.tracked.any() else None


def compare_extractors(track: GripperTrack, reference_X_BG: Array | None) -> dict[str, float | None]:
    """Return how far a track is from that of another extractor, over the frames that both have; empty without one."""
    if reference_X_BG is None:
        return {}
    names = ("reference_position_m", "reference_position_p95_m", "reference_rotation_rad")
    if len(reference_X_BG) != len(track.t_s):
        return {"reference_share": None, **dict.fromkeys(names)}
    both = track.tracked & np.isfinite(track.X_BG).all((1, 2)) & np.isfinite(reference_X_BG).all((1, 2))
    position_m, rotation_rad = pose_difference(track.X_BG[both], reference_X_BG[both])
    values = [np.median(position_m), np.percentile(position_m, 95), np.median(rotation_rad)] if both.any() else []
    return {
        "reference_share": float(both.mean()),
        **dict(zip(names, map(float, values) if values else [None] * 3, strict=True)),
    }


def compare_start(sample: VideoSample, video: Video, grounding: "GroundingResult") -> dict[str, Array]:
    """Return the curve with the fault ratio of a first frame against its conditioning image; empty without one."""
    from kinebench_drake.grounding.camera.framing import apply_framing  # loads OpenCV
    from kinebench_drake.metrics.executability import FAULT, start_ratio

    _, image = filmed_pictures(sample, video, grounding.panels)
    if image is None:
        return {}
    return {
        FAULT + "start": np.full(
            len(grounding.track.t_s), start_ratio(grounding.frames[0], apply_framing(grounding.framing, image))
        )
    }


def judge_possible(tracks: Sequence[GripperTrack], tools: Resources, table_height_m: float) -> "KinematicResult | None":
    """Return the verdict that holds with each of the possible tracks of a video; None if there is none.

    It is that of the first track. Of its violations it has those whose kind occurs in all tracks; without one it does
    not hold.
    """
    results = [tools.judge(track, table_height_m) for track in tracks]
    verdicts = {result.feasible for result in results}
    kinds = set.intersection(*({v.kind for v in result.violations} for result in results))
    if verdicts != {True} and (verdicts != {False} or not kinds):
        return None
    return replace(results[0], violations=tuple(v for v in results[0].violations if v.kind in kinds))


def plan_videos(config: ScoreConfig, observer: RunObserver | None = None) -> Iterator[tuple[VideoSample, SampleRow]]:
    """Read the videos of a run and yield each with a row of size, frame period and camera; nothing is written."""
    observer = observer or NullRunObserver()
    inputs = find_videos(config)
    for warning in inputs.warnings:
        observer.warn(warning)
    reader = _VideoReader(config=config, overrides=config.overrides())
    tools = reader.setup()
    for sample in config.select(inputs.samples):
        yield sample, reader.row(sample, tools, hash_sample(reader, sample))


def find_videos(config: ScoreConfig) -> VideoSamples:
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
    named = config.name_models(inputs.samples)
    samples = tuple(with_camera_option(named, config.camera, mirrored=config.mirrored))
    return replace(inputs, samples=samples, warnings=(*inputs.warnings, *period_warnings(periods)))


def _measured_row(
    row: SampleRow, sample: VideoSample, video: Video, timed: TimedFrames, grounding: "GroundingResult"
) -> SampleRow:
    """Return the row of a video with the measurements of its grounding, as yet without a verdict."""
    measured = grounding.measured
    choice = grounding.choice
    track = grounding.visible_track
    path = measured.camera_path
    row = row.measured(
        {
            "tracked_fraction": int(track.tracked.sum()) / len(track.t_s),
            "confidence_mean": mean_confidence(track),
            "camera_motion_px": measured.camera_motion_px,
            "arm_consistency_px": measured.arm_consistency_px,
            "anomalies": measured.anomalies,
            **compare_extractors(track, sample.reference_X_BG),
        }
    )
    return row.extended(
        first_frame=measured.first_frame.value,
        domain=measured.domain.value,
        anomalies_not_looked_for=[kind.value for kind in measured.anomalies_not_looked_for],
        **({} if measured.hand_size is None else measured.hand_size.to_json()),
        anomalies_open=[kind.value for kind in measured.anomalies_open],
        anomaly_scores={kind.value: round(score, 4) for kind, score in measured.detections.scores.items()},
        **({"gripper": measured.gripper.value} if measured.gripper is not GripperKind.FRANKA else {}),
        **({"lost_frames": measured.lost_frames} if measured.lost_frames else {}),
        frames=len(track.t_s),
        idle_ends=idle_ends(track),
        fingerprint=fingerprint(track.X_CH),
        width=grounding.framing.width,
        height=grounding.framing.height,
        **({} if grounding.panels is None else grounding.panels.to_json()),
        framing=grounding.framing.to_json(),
        fps=video.fps,
        frame_period_s=timed.period_s,
        frame_period_source=timed.source.value,
        clip_timing=timed.timing.value,
        clip_frames=len(video.frames),
        **({"surplus_frames": video.surplus} if video.surplus else {}),
        **({} if path is None else {"camera_path": path.to_json()}),
        **({} if choice.table_height_m is None else {"table_height_m": choice.table_height_m}),
        **({"mirrored": True} if sample.mirrored else {}),
        **choice.to_json(),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoMeasurement:
    """A video as it was measured."""

    grounding: "GroundingResult"
    kinematics: "KinematicResult | None"
    """Verdict in the base frame; None where it is unknown, or the run does not judge."""
    row: SampleRow
    curves: Mapping[str, Array] = field(default_factory=dict)
    """Further curves of its track file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoEvaluator(Evaluator[VideoSample, Resources]):
    """Evaluation of the videos of one run."""

    config: ScoreConfig
    overrides: Overrides
    """Stages of the grounding that are replaced."""

    def setup(self) -> Resources:
        """Load the robot."""
        return load_resources(self.config.make_resources, self.config.robot_options())

    def evaluate(self, sample: VideoSample, tools: Resources, row: SampleRow) -> SampleRow:
        """Read, ground, judge, write."""
        video = read_sample(sample)
        measurement = self.measure(sample, video, tools, row)
        self.write(sample, video, tools, measurement)
        return measurement.row

    def measure(
        self,
        sample: VideoSample,
        video: Video,
        tools: Resources,
        row: SampleRow,
        watch: "CameraWatch | None" = None,
    ) -> VideoMeasurement:
        """Ground and judge a decoded video and complete its `row`; nothing is written.

        A named camera is checked, or spot-checked by a `watch`.
        """
        config = self.config
        timed, grounding = ground_sample(
            video, sample, self.overrides, tools.grounder, config.frame_period_s, config.gripper,
            duration_s=config.task_duration_s, view=config.view, stride=config.stride, watch=watch,
        )  # fmt: skip
        track = grounding.visible_track
        row = _measured_row(row, sample, video, timed, grounding)
        if grounding.unmeasurable is not None:
            row = judge_row(row, None)
            row = fail_row(row, Status.UNMEASURABLE, grounding.unmeasurable)
            return VideoMeasurement(grounding=grounding, kinematics=None, row=row)
        if not config.kind.judges:
            return VideoMeasurement(grounding=grounding, kinematics=None, row=judge_row(row, None))
        reason = grounding.choice.reason
        kinematics = tools.judge(track, grounding.table_height_m) if reason is None else None
        agreed = judge_possible(grounding.possible, tools, grounding.table_height_m) if grounding.possible else None
        reasons: Mapping[str, str] = {}
        if reason is not None:
            smoothness, reasons = camera_frame_metrics(track, reason)
            row = row.measured(smoothness)
        if agreed is not None:
            row = row.extended(possible_cameras=len(grounding.possible))
        start = compare_start(sample, video, grounding)
        curves = {**grounding.measured.curves, **start}
        row = judge_row(row, kinematics, agreed=agreed, reasons=reasons, tracked=track.tracked, curves=curves)
        return VideoMeasurement(grounding=grounding, kinematics=kinematics, row=row, curves=start)

    def write(self, sample: VideoSample, video: Video, tools: Resources, measurement: VideoMeasurement) -> None:
        """Write the artifacts of a video."""
        out = self.config.out
        grounding = measurement.grounding
        track = grounding.visible_track
        kinematics = measurement.kinematics
        measured = grounding.measured
        path = measured.camera_path
        zoom = np.ones(len(track.t_s)) if path is None else path.zoom
        if self.config.overlay:
            native = len(grounding.frames) == len(video.frames)
            rate = float(np.clip((native and video.fps) or 1.0 / np.median(np.diff(track.t_s)), 1.0, 60.0))
            images = tools.overlay(grounding.frames, grounding.camera, track, zoom, gripper=measured.gripper_model)
            write_video(artifact_path(out, "overlays", sample.id), images, rate)
        shown = np.unique([0, worst_frame(track, kinematics)])
        chosen = grounding.frames[shown], grounding.camera, track.at(shown), zoom[shown]
        strip = encode_strip(list(tools.overlay(*chosen, gripper=measured.gripper_model)))
        write_atomically(artifact_path(out, "thumbnails", sample.id), strip)
        joints, curves = (kinematics.joints, kinematics.curves) if kinematics else (None, {})
        if self.config.format is not None and grounding.unmeasurable is None and grounding.choice.reason is None:
            joints = tools.joints(track, grounding.table_height_m)
        write_track(
            artifact_path(out, "tracks", sample.id), track, joints, {**curves, **measured.curves, **measurement.curves}
        )

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Visual metrics, and kinematic ones where tracks are judged."""
        return (*VISUAL_METRICS, *((EXECUTABILITY, *KINEMATIC_METRICS) if self.config.kind.judges else ()))

    @property
    def artifacts(self) -> tuple[str, ...]:
        """Tracks and thumbnails, and overlays where they are written."""
        return ("tracks", "thumbnails", *(["overlays"] if self.config.overlay else []))

    def cache_key(self, sample: VideoSample) -> Mapping[str, Json]:
        """Return weights, camera, clock, overrides and labels."""
        initial = sample.initial_state
        return {
            "weights": weights_hash(),
            "precision": network_precision().value,
            "camera": sample.camera.to_json(),
            "camera_source": sample.camera_source.value,
            "option_period_s": self.config.frame_period_s,
            "task_duration_s": self.config.task_duration_s,
            "replaced": self._replaced(sample),
            "first": None if initial is None else [*initial.X_BG.ravel().tolist(), str(initial.finger_width_m)],
            "depth_exact": self.overrides.depth_exact,
            **({} if self.config.gripper is GripperKind.AUTO else {"gripper": self.config.gripper.value}),
            **({} if self.config.stride == 1 else {"stride": self.config.stride}),
            "joints": self.config.format is not None,
            "scene": [sample.mirrored, sample.table_height_m],
            "reference": None if sample.reference_X_BG is None else sample.reference_X_BG.ravel().tolist(),
            "labels": [sample.success, sample.seed, sample.prompt, sample.fps, sample.frame_period_s, sample.problem],
            "view": sample.view or self.config.view,
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
            "camera_source": (sample.camera_source if sample.camera_source.is_named else CameraSource.NONE).value,
            "replaced": self._replaced(sample),
            "seed": sample.seed,
            "prompt": sample.prompt,
            **({} if sample.success is None else {"success": sample.success}),
            **({} if sample.camera_key is None else {"camera_key": sample.camera_key}),
        }

    def _replaced(self, sample: VideoSample) -> dict[str, Json]:
        """Return the estimates that are replaced, with the source of each."""
        return {**({"first_frame": "manifest"} if sample.initial_state else {}), **self.overrides.names}


@dataclass(frozen=True, slots=True, kw_only=True)
class _VideoReader(VideoEvaluator):
    """Evaluation that ends before the grounding."""

    def evaluate(self, sample: VideoSample, tools: Resources, row: SampleRow) -> SampleRow:
        """Read the video, check size and shape, determine its times."""
        video = read_sample(sample)
        video.require_measurable()
        panels = choose_view(video, sample.view or self.config.view, tools.grounder)
        pictures, image = filmed_pictures(sample, video, panels)
        if sample.camera_source.is_named:
            from kinebench_drake.grounding.camera.framing import find_framing  # loads OpenCV

            find_framing(pictures.frames, sample.camera, image, sample.camera_source)
        timed = time_frames(sample, video, self.config.frame_period_s, self.config.task_duration_s)
        return row.extended(
            frames=len(timed.t_s),
            width=pictures.width,
            height=pictures.height,
            **({} if panels is None else panels.to_json()),
            frame_period_s=timed.period_s,
            frame_period_source=timed.source.value,
            **({} if sample.camera_source.is_named else {"camera_source": AUTO}),
        )
