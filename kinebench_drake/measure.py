"""What is done to one sample: read, ground, judge, write its files, sum up in a row."""

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

import kinebench_drake
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, KinebenchError, SetupError, UnmeasurableError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.video import Video, frame_files, read_video
from kinebench_drake.inputs import Sample
from kinebench_drake.mp4 import write_video
from kinebench_drake.products import Anomaly, GripperTrack
from kinebench_drake.provenance import weights_hash
from kinebench_drake.results import part_path, storage, write_atomically
from kinebench_drake.row import Json, SampleRow, Status, dump
from kinebench_drake.stages import Judgement, Stages, load_stages
from kinebench_drake.thumbnail import side_by_side, track_at, worst_frame
from kinebench_drake.trackfile import write_track

SCHEMA_VERSION = 1

BENCHMARK_PERIOD_S = 0.2
"""Task time between two frames of a benchmark video (4 control steps at 20 Hz) [s]."""

VISUAL_METRICS = ("tracked_fraction", "camera_motion_px", "anomalies")
KINEMATIC_METRICS = (
    *("sparc", "sparc_rotation", "ldlj", "manipulability_mean", "manipulability_min", "manipulability_integral"),
    *("manipulability_cost_mean", "ik_success_rate", "ik_position_error_max_m", "joint_limit_margin_min"),
    *("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "time_scale"),
    *("slowdown_min", "trajopt_feasible", "trajopt_position_tube_m", "self_distance_min_m", "table_distance_min_m"),
)
"""Names every scored row bears; null where there is nothing to measure."""

MIN_TRACKED = 2
"""Frames in which the gripper must be found: a path needs two poses."""


class Kind(Enum):
    """How far videos are taken."""

    SCORE = "score"
    GROUND = "ground"


class PeriodSource(Enum):
    """Where the task time between two frames comes from, in order of precedence."""

    MANIFEST = "manifest"
    OPTION = "option"
    MANIFEST_FPS = "manifest_fps"
    TIME_STAMPS = "time_stamps"
    FPS = "fps"
    BENCHMARK = "benchmark"


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """How samples of one run are measured; picklable. `make` turns it into the function a worker calls."""

    kind: Kind
    out: Path
    frame_period_s: float | None
    """Task time between two frames from the command line [s]."""
    overlay: bool
    """Whether to write overlays/ID.mp4."""
    stages: str
    """Import path of the `Stages`."""

    def content_hash(self, sample: Sample) -> str:
        """SHA-256 of all that a sample's row follows from: video bytes, camera, labels, options, code, weights."""
        told: dict[str, Json] = {
            "schema": SCHEMA_VERSION,
            "kind": self.kind.value,
            "stages": self.stages,
            "version": kinebench_drake.__version__,
            "weights": weights_hash(),
            "camera": sample.camera.to_json(),
            "camera_source": sample.camera_source.value,
            "option_period_s": self.frame_period_s,
            "sample": [
                *(sample.id, sample.video, sample.task, sample.model, sample.seed, sample.prompt),
                *(sample.fps, sample.frame_period_s, sample.problem),
            ],
        }
        digest = hashlib.sha256(dump(told).encode())
        if sample.problem is None:
            files = frame_files(sample.path) if sample.path.is_dir() else [sample.path]
            for file in files:
                digest.update(file.name.encode(errors="surrogateescape") + b"\0")
                try:
                    with file.open("rb") as data:
                        digest.update(hashlib.file_digest(data, "sha256").digest())
                except OSError as error:
                    digest.update(f"unreadable: {error.strerror}".encode())
        return digest.hexdigest()

    def is_finished(self, sample: Sample, row: SampleRow | None) -> bool:
        """Whether a kept row still is the result of this sample. Errors are tried again: their cause may be gone."""
        if row is None or row.status is Status.ERROR:
            return False
        needed = [part for part in ("tracks", *(["overlays"] if self.overlay else [])) if row.status is Status.OK]
        return all(part_path(self.out, p, row.id).is_file() for p in needed) and row.content_hash == self.content_hash(
            sample
        )

    def make(self) -> Callable[[Sample], tuple[SampleRow, float]]:
        """Load the stages; the function returned gives a sample's row and the seconds it took.

        Raises:
            SetupError: a library, a driver or the weights are missing.
        """
        stages = load_stages(self.stages)

        def work(sample: Sample) -> tuple[SampleRow, float]:
            start = time.perf_counter()
            return self._row(sample, stages), time.perf_counter() - start

        return work

    def failed(self, sample: Sample, status: Status, reason: str) -> SampleRow:
        """Row of a sample that came to nothing: every metric is null."""
        names = VISUAL_METRICS if self.kind is Kind.GROUND else (*VISUAL_METRICS, *KINEMATIC_METRICS)
        return SampleRow(
            id=sample.id,
            video=sample.video,
            task=sample.task,
            model=sample.model,
            status=status,
            reason=" ".join(reason.split()),
            content_hash=self.content_hash(sample),
            metrics=dict.fromkeys(names),
            extra={"camera_source": sample.camera_source.value, "seed": sample.seed, "prompt": sample.prompt},
        )

    def _row(self, sample: Sample, stages: Stages) -> SampleRow:
        """The per-sample boundary: whatever goes wrong with a sample ends here, in its row."""
        try:
            return self._measure(sample, stages)
        except SetupError:
            raise
        except UnmeasurableError as error:
            return self.failed(sample, Status.UNMEASURABLE, str(error))
        except KinebenchError as error:
            return self.failed(sample, Status.ERROR, str(error))
        except Exception as error:
            return self.failed(sample, Status.ERROR, f"unexpected {type(error).__name__}: {error}")

    def _measure(self, sample: Sample, stages: Stages) -> SampleRow:
        if sample.problem is not None:
            raise InputError(sample.problem)
        video = read_video(sample.path)
        video.require_measurable()
        try:
            camera = sample.camera.resized(video.width, video.height)
        except UsageError as error:
            raise UnmeasurableError(f"{sample.camera_source.value} {error}") from None
        t_s, period_s, period_source = self._times(sample, video)
        grounding = stages.ground(video.frames, camera, t_s)
        track = grounding.track
        tracked = int(track.tracked.sum())
        if tracked < MIN_TRACKED:
            raise UnmeasurableError(
                f"the gripper was found in {tracked} of {len(t_s)} frames, a path needs {MIN_TRACKED}: is the robot in "
                "view, and is this the video's camera?"
            )
        judgement = stages.judge(track) if self.kind is Kind.SCORE else None
        self._write_files(sample, video, camera, track, judgement, stages, period_s)
        metrics: dict[str, Json] = {
            "tracked_fraction": tracked / len(t_s),
            "camera_motion_px": grounding.camera_motion_px,
            "anomalies": [_anomaly_json(a) for a in grounding.anomalies],
        }
        if judgement is not None:
            metrics |= {**dict.fromkeys(KINEMATIC_METRICS), **judgement.metrics}
        return SampleRow(
            id=sample.id,
            video=sample.video,
            task=sample.task,
            model=sample.model,
            status=Status.OK,
            reason=None,
            content_hash=self.content_hash(sample),
            feasible=judgement.feasible if judgement else None,
            violations=judgement.violations if judgement else (),
            metrics=metrics,
            extra={
                "frames": len(t_s),
                "width": video.width,
                "height": video.height,
                "fps": video.fps,
                "frame_period_s": period_s,
                "frame_period_source": period_source.value,
                "camera_source": sample.camera_source.value,
                "seed": sample.seed,
                "prompt": sample.prompt,
            },
        )

    def _times(self, sample: Sample, video: Video) -> tuple[Array, float, PeriodSource]:
        """Task time of each frame [s], the period between two [s], and where it comes from."""
        if sample.frame_period_s is not None:
            period_s, source = sample.frame_period_s, PeriodSource.MANIFEST
        elif self.frame_period_s is not None:
            period_s, source = self.frame_period_s, PeriodSource.OPTION
        elif sample.fps is not None:
            period_s, source = 1.0 / sample.fps, PeriodSource.MANIFEST_FPS
        elif video.stamps_s is not None:
            period_s = float(np.median(np.diff(video.stamps_s)))
            return video.stamps_s, period_s, PeriodSource.TIME_STAMPS
        elif video.fps is not None:
            period_s, source = 1.0 / video.fps, PeriodSource.FPS
        else:
            period_s, source = BENCHMARK_PERIOD_S, PeriodSource.BENCHMARK
        return np.arange(len(video.frames), dtype=np.float64) * period_s, period_s, source

    def _write_files(
        self,
        sample: Sample,
        video: Video,
        camera: Camera,
        track: GripperTrack,
        judgement: Judgement | None,
        stages: Stages,
        period_s: float,
    ) -> None:
        """Write the sample's files, each whole or not at all; the row that vouches for them comes later.

        Raises:
            SetupError: writing failed.
        """
        if self.overlay:
            path = part_path(self.out, "overlays", sample.id)
            fps = float(np.clip(video.fps or 1.0 / period_s, 1.0, 60.0))
            with storage(f"overlays/{path.name}"):
                write_video(path, stages.overlay(video.frames, camera, track), fps)
        chosen = np.unique([0, worst_frame(track, judgement)])
        images = list(stages.overlay(video.frames[chosen], camera, track_at(track, chosen)))
        write_atomically(part_path(self.out, "thumbnails", sample.id), side_by_side(images))
        joints, per_frame = (judgement.joints, judgement.per_frame) if judgement else (None, {})
        write_track(part_path(self.out, "tracks", sample.id), track, joints, per_frame)


def _anomaly_json(anomaly: Anomaly) -> dict[str, Json]:
    return {
        "kind": anomaly.kind.value,
        "frame_start": int(anomaly.frame_start),
        "frame_end": int(anomaly.frame_end),
        "severity": float(anomaly.severity),
    }
