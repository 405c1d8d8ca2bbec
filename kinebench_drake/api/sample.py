"""One video or one trajectory by itself, in this process: found in files or taken from arrays, and what works on it."""

from collections.abc import Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.episodes import with_first_frames
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.grounding.decoded import Video
from kinebench_drake.grounding.sources.sources import Sources
from kinebench_drake.grounding.video import read_video
from kinebench_drake.inputs import CameraSource, Sample, find_samples
from kinebench_drake.measure import Named
from kinebench_drake.stages import SHIPPED_STAGES, StageOptions, Stages, load_stages
from kinebench_drake.trajectories.check import check
from kinebench_drake.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.trajectories.trajectory import Choice, Recording, Trajectory

AnySample = TypeVar("AnySample", bound=Named)


def single_video(
    source: Path, *, id: str | None, camera_key: str | None, pixels_only: bool, sources: Sources
) -> tuple[Video, Sample, Sequence[str]]:
    """One video of a file, dataset or manifest, what its owner says about it, and what the user should know.

    Raises:
        UsageError: there is none, or it is not said which one is meant.
        InputError: it cannot be read.
    """
    inputs = find_samples(source, others=sources.folders, camera_key=camera_key)
    sample = _one(inputs.samples, source, id)
    if sample.problem is not None:
        raise InputError(sample.problem)
    sample = replace(sample, first=None) if pixels_only else with_first_frames([sample])[0]
    return read_video(sample.path, sample.part), sample, inputs.warnings


def video_of(frames: NDArray[np.uint8], id: str | None) -> tuple[Video, Sample]:
    """A video given as frames (T, H, W, 3) RGB, by the benchmark's camera unless it is said otherwise.

    Raises:
        InputError: the array is no video.
    """
    name = id or "video"
    sample = Sample(
        id=name, path=Path(name), video=name, camera=benchmark_camera(), camera_source=CameraSource.BENCHMARK
    )
    return Video(frames=np.asarray(frames), fps=None, stamps_s=None), sample


def single_trajectory(source: Path, choice: Choice, *, id: str | None) -> Trajectory:
    """One trajectory of a file, dataset or folder.

    Raises:
        UsageError: there is none, or it is not said which one is meant.
        InputError: it cannot be read, or is not sound.
        UnmeasurableError: it is too short.
    """
    return read_trajectory(_one(find_trajectories(source, choice), source, id), choice)


def trajectory_of(
    values: NDArray[np.generic],
    *,
    t_s: ArrayLike | None,
    rate_hz: float | None,
    tracked: ArrayLike | None,
    finger_width_m: ArrayLike | None,
) -> Trajectory:
    """A trajectory given as joint angles (T, 7) [rad] or poses (T, 4, 4) [m], checked as files are.

    Raises:
        InputError: the arrays are not sound.
        UnmeasurableError: they are too short.
    """
    if values.ndim not in (2, 3):
        raise InputError(
            f"the trajectory has shape {values.shape}, expected joint angles (T, 7) in radians or poses (T, 4, 4)"
        )
    joints = values.ndim == 2
    recording = Recording(
        t_s=None if t_s is None else np.asarray(t_s),
        X_BG=None if joints else values,
        q=values if joints else None,
        tracked=None if tracked is None else np.asarray(tracked),
        finger_width_m=None if finger_width_m is None else np.asarray(finger_width_m),
        columns="q" if joints else "base_from_tcp",
    )
    return check(recording, rate_hz)


def stages_for(options: StageOptions) -> Stages:
    """What grounds and judges: kept for the next call with the same options, unless the robot is the user's own.

    Raises:
        SetupError: a library, a driver or the weights are missing.
        UsageError: the robot cannot be used.
    """
    if options.urdf is None:
        return _kept_stages(SHIPPED_STAGES, options)
    return load_stages(SHIPPED_STAGES, options)  # its files may change between calls


@lru_cache(maxsize=4)
def _kept_stages(path: str, options: StageOptions) -> Stages:
    return load_stages(path, options)


def _one(samples: Sequence[AnySample], source: Path, id: str | None) -> AnySample:
    ids = [sample.id for sample in samples]
    if id in ids:
        return samples[ids.index(id)]
    if id is None and len(ids) == 1:
        return samples[0]
    if id is None:
        raise UsageError(f"{source}: holds {len(ids)} samples, expected one; name one by id, such as id={ids[0]!r}")
    near = get_close_matches(id, ids, n=3, cutoff=0.5) or ids[:3]
    raise UsageError(f"{source}: holds no sample {id!r} ({len(ids)} samples, such as {', '.join(near)})")
