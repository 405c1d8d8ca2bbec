"""Generated videos beside the pose numbers from which the example's world model painted them.

The latent vector of that model is known: where the points of the robot are in each frame, as the camera sees them. So
the place of the gripper in a generated clip is known, and its jumps, by the bounds of their detector.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np

from benchmarks.generated import BEST, clip_ends, reported_kinds
from benchmarks.markdown import section
from benchmarks.perception.store import MeasurementStore, Stored, fingerprint
from examples.worldmodel.generator import Generator
from examples.worldmodel.robot import FIELD, NEAR_M, POINTS
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.grounding.anomaly.jumps import find_teleports
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import HAND_TO_TCP_M
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.suites.seeding import generator

TCP = 13
"""Number of the TCP among the model's points."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clip:
    """Clip of an episode."""

    id: str
    video: Path
    prompt: str
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperPath:
    """Path of the gripper by the pose numbers of a clip."""

    p_C: Annotated[Array, Stored(".4f")]
    """TCP in the camera frame (T - 1, 3) [m], from the second frame on: the first is the picture that was given."""

    @property
    def jumps(self) -> bool:
        """True if the gripper jumps."""
        every = np.ones(len(self.p_C), dtype=np.bool_)
        t_s = np.arange(len(self.p_C), dtype=np.float64)
        return bool(find_teleports(self.p_C, every, every, t_s).anomalies)


class _Reader:
    """Generates pose numbers again; loads the model once."""

    def __init__(self, weights: Path) -> None:
        self._weights = weights

    @cached_property
    def _generator(self) -> Generator:
        return Generator(self._weights)

    def __call__(self, clip: Clip) -> GripperPath:
        first = read_video(clip.video).frames[0]
        points = self._generator.imagine(first, clip.prompt, clip.seed).numpy()[1:, :-1].reshape(-1, POINTS, 3)[:, TCP]
        z_m = NEAR_M / (1 + points[:, 2:])
        return GripperPath(p_C=np.concatenate([points[:, :2] * FIELD * z_m, z_m], axis=1))

    def close(self) -> None:
        """Nothing is held."""


def truth_sections(study: Path, weights: Path, jobs: int, observer: RunObserver) -> Iterator[str]:
    """Yield the section of docs/worldmodel.md on the clips of the best training, which has these weights."""
    folder = study / BEST
    rows = [row for _, row in sorted(read_rows(folder).items())]
    clips = [clip for row in rows for clip in _clips(folder, row)]
    code = fingerprint(files=sorted(weights.glob("*.safetensors")))
    done = MeasurementStore(study / "truth.jsonl", GripperPath).complete(
        clips,
        lambda clip: f"{code}-{fingerprint(files=[clip.video])}-{clip.id}",
        LocalExecutor(jobs=jobs),
        partial(_Reader, weights),
        observer,
        lambda clip: clip.id,
    )
    truths = {clip.id: truth for clip, truth in zip(clips, done, strict=True)}
    jumps = []
    errors_m = []
    for row in rows:
        track = read_track(artifact_path(folder, "tracks", row.id)).track
        p_C = transform_points(track.X_CH, [[0, 0, HAND_TO_TCP_M]])[:, 0]
        for k, (start, end) in enumerate(pairwise([0, *clip_ends(row)])):
            truth = truths[f"{row.id}_r{k}"]
            jumps.append((truth.jumps, AnomalyKind.TELEPORT.value in reported_kinds(row, k)))
            own = p_C[start + 1 : end]  # a last clip ends with the task
            errors_m.append(np.linalg.norm(own - truth.p_C[: len(own)], axis=1))
    true, reported = np.array(jumps).T
    error_mm = 1000 * np.concatenate(errors_m)
    yield section(
        "Beside the generator's own numbers",
        f"Of {len(clips)} clips {true.sum()} have a jump by the numbers from which they were painted. `teleport` is "
        f"reported in {reported.sum()}, in {(true & reported).sum()} of them rightly. Tracked TCPs are "
        f"{np.nanmedian(error_mm):.1f} mm from these numbers (median; 95 %: {np.nanpercentile(error_mm, 95):.1f} mm).",
    )


def _clips(folder: Path, row: SampleRow) -> Iterator[Clip]:
    for k in range(len(clip_ends(row))):
        id = f"{row.id}_r{k}"
        seed = int(generator("world model", row.id, k, 0).integers(2**31))
        yield Clip(id=id, video=folder / "videos" / f"{id}.mp4", prompt=str(row.extra["prompt"]), seed=seed)
