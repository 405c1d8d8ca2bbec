"""What is done to one video: read, ground, judge, write its files."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.footage import Footage, make_footage, names_of
from kinebench_drake.grounding.decoded import Video
from kinebench_drake.grounding.frame_folder import frame_files
from kinebench_drake.grounding.known import FirstFrame
from kinebench_drake.grounding.sources.sources import Sources
from kinebench_drake.grounding.video import read_video
from kinebench_drake.inputs import Sample
from kinebench_drake.measure import KINEMATIC_METRICS, Measure, Measured
from kinebench_drake.mp4 import write_video
from kinebench_drake.products import Anomaly, GripperTrack
from kinebench_drake.provenance import weights_hash
from kinebench_drake.results import part_path
from kinebench_drake.row import Json
from kinebench_drake.stages import Judgement, Stages, load_stages
from kinebench_drake.storage import storage, write_atomically
from kinebench_drake.thumbnail import side_by_side, worst_frame
from kinebench_drake.trackfile import write_track

VISUAL_METRICS = ("tracked_fraction", "camera_motion_px", "arm_consistency_px", "anomalies")
"""Names every row of a video bears; null where there is nothing to measure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoMeasure(Measure[Sample, Stages]):
    """How the videos of one run are measured."""

    frame_period_s: float | None
    """Task time between two frames from the command line [s]."""
    overlay: bool
    """Whether to write overlays/ID.mp4."""
    sources: Sources
    """Which stages of the grounding are done elsewhere."""

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `Measure`."""
        return (*VISUAL_METRICS, *(KINEMATIC_METRICS if self.kind.judges else ()))

    @property
    def parts(self) -> tuple[str, ...]:
        """See `Measure`."""
        return ("tracks", *(["overlays"] if self.overlay else []))

    def facts(self, sample: Sample) -> Mapping[str, Json]:
        """See `Measure`."""
        return {
            "weights": weights_hash(),
            "camera": sample.camera.to_json(),
            "camera_source": sample.camera_source.value,
            "option_period_s": self.frame_period_s,
            "given": self._given(sample),
            "first": _first_json(sample.first),
            "depth_exact": self.sources.depth_exact,
            "labels": [sample.seed, sample.prompt, sample.fps, sample.frame_period_s, sample.problem],
            "part": [*dataclasses.astuple(sample.part), sample.camera_key, sample.dataset_period_s],
        }

    def files(self, sample: Sample) -> Sequence[Path]:
        """See `Measure`."""
        if sample.problem is not None:
            return ()
        own = frame_files(sample.path) if sample.path.is_dir() else [sample.path]
        given = [] if sample.first_frame is None else [sample.first_frame]
        return [*own, *given, *self.sources.files(names_of(sample))]

    def labels(self, sample: Sample) -> Mapping[str, Json]:
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

    def measure(self, sample: Sample, stages: Stages) -> Measured:
        """See `Measure`."""
        if sample.problem is not None:
            raise InputError(sample.problem)
        video = read_video(sample.path, sample.part)
        size = video.width, video.height
        footage = make_footage(video, sample, self.frame_period_s, self.sources)
        video = replace(video, frames=footage.frames)
        grounding = footage.ground(stages)
        track = grounding.track
        judgement = stages.judge(track) if self.kind.judges else None
        self._write_files(sample, video, footage, track, judgement, stages)
        return Measured(
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

    def _given(self, sample: Sample) -> dict[str, Json]:
        """What takes the place of estimates: stage to where it comes from."""
        return {**({"first_frame": "manifest"} if sample.first else {}), **self.sources.names}

    def _write_files(
        self,
        sample: Sample,
        video: Video,
        footage: Footage,
        track: GripperTrack,
        judgement: Judgement | None,
        stages: Stages,
    ) -> None:
        """Write the sample's files, each whole or not at all; the row that vouches for them comes later.

        Raises:
            SetupError: writing failed.
        """
        if self.overlay:
            path = part_path(self.out, "overlays", sample.id)
            fps = float(np.clip(video.fps or 1.0 / footage.period_s, 1.0, 60.0))
            with storage(f"overlays/{path.name}"):
                write_video(path, stages.overlay(video.frames, footage.camera, track), fps)
        chosen = np.unique([0, worst_frame(track, judgement)])
        images = list(stages.overlay(video.frames[chosen], footage.camera, track.at(chosen)))
        write_atomically(part_path(self.out, "thumbnails", sample.id), side_by_side(images))
        joints, curves = (judgement.joints, judgement.curves) if judgement else (None, {})
        write_track(part_path(self.out, "tracks", sample.id), track, joints, curves)


def _first_json(first: FirstFrame | None) -> Json:
    return None if first is None else [*first.X_BG.ravel().tolist(), str(first.finger_width_m)]


def anomaly_json(anomaly: Anomaly, first_frame: int = 0) -> dict[str, Json]:
    """An anomaly as rows have it, its frames counted on from `first_frame`."""
    return {
        "kind": anomaly.kind.value,
        "frame_start": first_frame + int(anomaly.frame_start),
        "frame_end": first_frame + int(anomaly.frame_end),
        "severity": float(anomaly.severity),
    }
