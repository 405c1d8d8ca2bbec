"""What is done to one episode of a suite: run it in closed loop, judge what was imagined, tell how it went."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.closed_loop.attribution import cause_json, find_cause
from kinebench_drake.closed_loop.commands import CommandPlanner
from kinebench_drake.closed_loop.gap import measure_gap
from kinebench_drake.closed_loop.loop import ClosedLoop, EpisodeRun, LoopOptions
from kinebench_drake.evaluation.clips import clip_starts, combine, joined_track
from kinebench_drake.evaluation.evaluator import KINEMATIC_METRICS, Evaluation, Evaluator
from kinebench_drake.evaluation.score import VISUAL_METRICS, anomaly_json
from kinebench_drake.evaluation.stages import Stages, load_stages
from kinebench_drake.evaluation.thumbnail import side_by_side
from kinebench_drake.grounding.overlay import caption
from kinebench_drake.io.atomic import disk_errors, write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.results.provenance import weights_hash
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.suites.clip import RolloutVideo, film
from kinebench_drake.suites.export import FPS
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.suite import EpisodeSpec
from kinebench_drake.suites.worldmodels.lazy_model import LazyWorldModel
from kinebench_drake.suites.worldmodels.worldmodel import Offline
from kinebench_drake.types import GripperTrack, Json

SIZE_PX = 384
"""Width and height of the pictures that models are given."""
GAP_METRICS = ("gap_robot_iou", "gap_gripper_m", "gap_gripper_rad", "gap_psnr_db", "gap_ssim")
"""Names that every row of an episode bears beside those of a video; null where nothing was executed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSample:
    """One episode to run with one model."""

    draw: EpisodeSpec
    model: str
    """Name of the world model."""

    @property
    def id(self) -> str:
        """See `measure.Named`."""
        return self.draw.id

    @property
    def video(self) -> str:
        """The first clip that the model imagines, relative to the output folder."""
        return f"videos/{self.id}_r0.mp4"

    @property
    def task(self) -> str:
        """See `measure.Named`."""
        return self.draw.task


@dataclass(frozen=True, slots=True)
class EpisodeResources:
    """What a process needs to run episodes."""

    stages: Stages
    hand: SimulatorCache[Simulator]
    model: LazyWorldModel
    loop: ClosedLoop

    def close(self) -> None:
        """Free the stage and the world model."""
        self.hand.close()
        self.model.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeEvaluator(Evaluator[EpisodeSample, EpisodeResources]):
    """How the episodes of one run are measured."""

    world_model: LazyWorldModel
    """What to ask."""
    offline: bool
    """Whether it is `Offline`: asked for its files, too."""
    loop: LoopOptions
    rollouts: bool
    """Whether to write rollouts/ID.mp4."""

    @property
    def metric_names(self) -> tuple[str, ...]:
        """See `Measure`."""
        return (*VISUAL_METRICS, *GAP_METRICS, *KINEMATIC_METRICS)

    @property
    def parts(self) -> tuple[str, ...]:
        """See `Measure`."""
        return ("tracks", "thumbnails", *(["rollouts"] if self.rollouts else []))

    def facts(self, sample: EpisodeSample) -> Mapping[str, Json]:
        """See `Measure`."""
        draw = sample.draw
        options = {**asdict(self.loop), "control": self.loop.control.value}
        return {
            "weights": weights_hash(),
            "world_model": self.world_model.identity,
            "loop": options,
            "episode": [draw.task, draw.seed, draw.pool.value, draw.variant.value],
        }

    def files(self, sample: EpisodeSample) -> Sequence[Path]:
        """See `Measure`."""
        model = self.world_model.get() if self.offline else None
        return model.files(sample.id, sample.task) if isinstance(model, Offline) else ()

    def labels(self, sample: EpisodeSample) -> Mapping[str, Json]:
        """See `Measure`."""
        return {"seed": sample.draw.seed, "pool": sample.draw.pool.value, "variant": sample.draw.variant.value}

    def equip(self) -> EpisodeResources:
        """See `Measure`."""
        stages = load_stages(self.stages, self.stage_options)
        loop = ClosedLoop(stages, CommandPlanner(ArmPlant()), self.world_model.get(), self.loop)
        hand = SimulatorCache(partial(Simulator, control=self.loop.control), SIZE_PX)
        return EpisodeResources(stages, hand, self.world_model, loop)

    def measure(self, sample: EpisodeSample, theatre: EpisodeResources) -> Evaluation:
        """See `Measure`."""
        episode = sample.draw.episode()
        stage = theatre.hand.stage(episode.task, episode.variant)
        videos = self.out / "videos"
        videos.mkdir(exist_ok=True)
        run = theatre.loop.run(stage, episode, videos / sample.id)
        films = [None if r.execution is None else film(stage, r.execution.snapshots) for r in run.rounds]
        tracks = [r.grounded.track for r in run.rounds]
        judgements = [theatre.stages.judge(track) for track in tracks]
        track, judgement = joined_track(tracks), combine(tracks, judgements)
        write_track(artifact_path(self.out, "tracks", sample.id), track, judgement.joints, judgement.curves)
        write_atomically(artifact_path(self.out, "thumbnails", sample.id), _thumbnail(run, films))
        if self.rollouts:
            self._write_rollout(sample, run, films, theatre.stages)
        cause = find_cause(run, judgements)
        clips = [f"videos/{r.video.name}" for r in run.rounds]
        return Evaluation(
            judgement=judgement,
            video=clips[0],
            metrics={**_visual_metrics(run, track), **_gap_metrics(run, films)},
            extra={
                "success": run.outcome.success,
                "progress": run.outcome.progress,
                "rounds": len(run.rounds),
                "verdict": None if cause is None else cause.verdict.value,
                "cause": None if cause is None else cause_json(cause),
                "missed": [name for name, holds in run.outcome.conditions.items() if not holds],
                "refused": _refused(run),
                "prompt": episode.prompt,
                "videos": clips,
                "frames": len(track.t_s),
            },
        )

    def _write_rollout(
        self, sample: EpisodeSample, run: EpisodeRun, films: Sequence[RolloutVideo | None], stages: Stages
    ) -> None:
        """Write what was imagined, what was executed, and the imagined gripper drawn on the executed frames.

        Raises:
            SetupError: writing failed.
        """
        path = artifact_path(self.out, "rollouts", sample.id)
        with disk_errors(f"rollouts/{path.name}"):
            write_video(path, _side_by_side(run, films, stages), FPS, crf=20)


def _side_by_side(run: EpisodeRun, films: Sequence[RolloutVideo | None], stages: Stages) -> Iterator[NDArray[np.uint8]]:
    for number, (done, executed) in enumerate(zip(run.rounds, films, strict=True), 1):
        said = f"imagined, round {number}"
        if executed is None:
            nothing = _captioned(np.zeros((SIZE_PX, SIZE_PX, 3), dtype=np.uint8), "nothing executed")
            for frame in done.frames:
                yield np.concatenate([_captioned(frame, said), nothing, nothing], axis=1)
            continue
        track = done.grounded.track.at(np.arange(len(executed.rgb)))
        drawn = stages.overlay(executed.rgb, executed.camera, track)
        for frame, shown, overlay in zip(done.frames, executed.rgb, drawn, strict=False):
            yield np.concatenate([_captioned(frame, said), _captioned(shown, "executed"), overlay], axis=1)


def _thumbnail(run: EpisodeRun, films: Sequence[RolloutVideo | None]) -> bytes:
    """How the episode begins, how it ends as imagined, and how as executed, as far as it went."""
    last = next((film.rgb[-1] for film in reversed(films) if film is not None), run.rounds[0].frames[0])
    pictures = (run.rounds[0].frames[0], "start"), (run.rounds[-1].frames[-1], "imagined"), (last, "executed")
    return side_by_side([_captioned(frame, text) for frame, text in pictures])


def _captioned(frame: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    image = np.asarray(cv2.resize(frame, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    caption(image, text)
    return image


def _gap_metrics(run: EpisodeRun, films: Sequence[RolloutVideo | None]) -> dict[str, Json]:
    """How far what was executed is from what was imagined, over all executed frames but the first of each clip."""
    gaps = [
        measure_gap(r.frames, r.robot, r.grounded.track.X_BG, executed)
        for r, executed in zip(run.rounds, films, strict=True)
        if executed is not None
    ]

    def mean(name: str) -> float | None:
        values = np.concatenate([np.empty(0), *(getattr(gap, name)[1:] for gap in gaps)])
        values = values[np.isfinite(values)]
        return float(values.mean()) if len(values) else None

    return {
        "gap_robot_iou": mean("robot_iou"),
        "gap_gripper_m": mean("distance_m"),
        "gap_gripper_rad": mean("angle_rad"),
        "gap_psnr_db": mean("psnr_db"),
        "gap_ssim": mean("ssim"),
    }


def _visual_metrics(run: EpisodeRun, track: GripperTrack) -> dict[str, Json]:
    """What the clips show, frames counted through all of them."""
    grounded = [r.grounded for r in run.rounds]
    motions = [g.camera_motion_px for g in grounded if g.camera_motion_px is not None]
    distances = [g.arm_consistency_px for g in grounded if g.arm_consistency_px is not None]
    return {
        "tracked_fraction": float(track.tracked.mean()),
        "camera_motion_px": max(motions) if motions else None,
        "arm_consistency_px": float(np.median(distances)) if distances else None,
        "anomalies": [
            anomaly_json(a, start)
            for start, g in zip(clip_starts([g.track for g in grounded]), grounded, strict=True)
            for a in g.anomalies
        ],
    }


def _refused(run: EpisodeRun) -> list[Json]:
    """What was not commanded as imagined, round by round."""
    told = list[Json]()
    for number, done in enumerate(run.rounds):
        if done.refusal is not None:
            told.append({"round": number, "reason": "nothing_to_execute", "text": done.refusal})
        for refused in done.commands.refused if done.commands else ():
            frames: dict[str, Json] = {"frame_start": refused.frame_start, "frame_end": refused.frame_end}
            told.append({"round": number, "reason": refused.reason.value, **frames})
    return told
