"""One sample by itself, nothing written: `ground_video` and `audit_trajectory`."""

from collections.abc import Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.api.arguments import PathName, path_of, refuse_with, warn
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.datasets.trajectories.check import check
from kinebench_drake.datasets.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.datasets.trajectories.trajectory import RawTrajectory, Trajectory, TrajectoryOptions
from kinebench_drake.datasets.videos.find import find_samples
from kinebench_drake.datasets.videos.sample import CameraSource, VideoSample
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.evaluation import audit
from kinebench_drake.evaluation.audit import judge_trajectory
from kinebench_drake.evaluation.evaluator import SampleInfo
from kinebench_drake.evaluation.score import (
    BENCHMARK_PERIOD_S,
    PeriodSource,
    check_period,
    prepare_video,
    with_first_frames,
)
from kinebench_drake.evaluation.stages import SHIPPED_STAGES, Grounded, Judgement, RobotOptions, Stages, load_stages
from kinebench_drake.executors.local import one_thread
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from kinebench_drake.types import GripperTrack, InitialState

AnySample = TypeVar("AnySample", bound=SampleInfo)


def single_video(
    source: Path, *, id: str | None, camera_key: str | None, pixels_only: bool, sources: Overrides
) -> tuple[Video, VideoSample, Sequence[str]]:
    """One video of a file, dataset or manifest, what its owner says about it, and what the user should know.

    Raises:
        UsageError: there is none, or it is not said which one is meant.
        InputError: it cannot be read.
    """
    inputs = find_samples(source, others=sources.folders, camera_key=camera_key)
    sample = _one(inputs.samples, source, id)
    if sample.problem is not None:
        raise InputError(sample.problem)
    sample = replace(sample, initial_state=None) if pixels_only else with_first_frames([sample])[0]
    return read_video(sample.path, sample.part), sample, inputs.warnings


def video_of(frames: NDArray[np.uint8], id: str | None) -> tuple[Video, VideoSample]:
    """A video given as frames (T, H, W, 3) RGB, by the benchmark's camera unless it is said otherwise.

    Raises:
        InputError: the array is no video.
    """
    name = id or "video"
    sample = VideoSample(
        id=name, path=Path(name), video=name, camera=benchmark_camera(), camera_source=CameraSource.BENCHMARK
    )
    return Video(frames=np.asarray(frames), fps=None, stamps_s=None), sample


def single_trajectory(source: Path, choice: TrajectoryOptions, *, id: str | None) -> Trajectory:
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
    recording = RawTrajectory(
        t_s=None if t_s is None else np.asarray(t_s),
        X_BG=None if joints else values,
        q=values if joints else None,
        tracked=None if tracked is None else np.asarray(tracked),
        finger_width_m=None if finger_width_m is None else np.asarray(finger_width_m),
        columns="q" if joints else "base_from_tcp",
    )
    return check(recording, rate_hz)


def stages_for(options: RobotOptions) -> Stages:
    """What grounds and judges: kept for the next call with the same options, unless the robot is the user's own.

    Raises:
        SetupError: a library, a driver or the weights are missing.
        UsageError: the robot cannot be used.
    """
    if options.urdf is None:
        return _kept_stages(SHIPPED_STAGES, options)
    return load_stages(SHIPPED_STAGES, options)  # its files may change between calls


@lru_cache(maxsize=4)
def _kept_stages(path: str, options: RobotOptions) -> Stages:
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


def ground_video(
    video: PathName | NDArray[np.uint8],
    *,
    id: str | None = None,
    camera: Camera | PathName | None = None,
    camera_key: str | None = None,
    frame_period_s: float | None = None,
    first: InitialState | None = None,
    pixels_only: bool = False,
    masks: PathName | None = None,
    depth: PathName | None = None,
    depth_exact: bool = False,
    poses: PathName | None = None,
) -> Grounded:
    """Take the gripper's track from one video, as `kinebench-drake ground` does; nothing is written.

    The networks are loaded with the first call and kept.

    Args:
        video: a path as `score_videos` takes it, or frames (T, H, W, 3) uint8 RGB.
        id: which one, where the path holds several; of frames: the name of their files in `masks`, `depth`, `poses`.
        camera: the camera, or the path of its camera.json; None: that of the input, else the benchmark's.
        camera_key: camera to take of datasets that have several.
        frame_period_s: task time between two frames [s], where no manifest tells; None: 1 / fps, 0.2 without a clock.
        first: the robot in the first frame, over what the input tells (`X_BG`: the TCP in the robot base frame [m]).
        pixels_only: leave aside what the input tells of the first frame.
        masks: see `score_videos`.
        depth: see `score_videos`.
        depth_exact: see `score_videos`.
        poses: see `score_videos`.

    Returns:
        `track`: (T,) times [s], poses (T, 4, 4) of panda_hand in the camera frame and of panda_hand_tcp in the base
        frame [m], NaN where not tracked, confidence, gap between the pads [m]; `anomalies`; `camera_motion_px`;
        `arm_consistency_px`; `robot` (T, H, W), the pixels that show the robot; `first_frame`.

    Raises:
        UsageError: an argument cannot be used, or the path holds no video or several.
        InputError: the video is broken.
        UnmeasurableError: it is too small or too short, no camera fits its shape, or too few frames show a gripper.
        SetupError: weights or libraries are missing.

    Example:
        track = ground_video("videos/episode.mp4", frame_period_s=0.2).track
        print(track.X_BG[track.tracked, :3, 3])
    """
    check_period(frame_period_s)
    sources = Overrides(
        masks=path_of(masks),
        depth=None if depth is None else str(depth),
        poses=path_of(poses),
        depth_exact=depth_exact,
    )
    if isinstance(video, str | PathLike):
        decoded, sample, told = single_video(
            Path(video), id=id, camera_key=camera_key, pixels_only=pixels_only, sources=sources
        )
        warn(*told)
    else:
        refuse_with("frames", camera_key=camera_key)
        decoded, sample = video_of(video, id)
    if camera is not None:
        given = camera if isinstance(camera, Camera) else load_camera(Path(camera))
        sample = replace(sample, camera=given, camera_source=CameraSource.GIVEN)
    if first is not None:
        sample = replace(sample, initial_state=first)
    with one_thread():
        footage = prepare_video(decoded, sample, frame_period_s, sources)
        if footage.period_source is PeriodSource.BENCHMARK:
            warn(f"the video has no frame rate: {BENCHMARK_PERIOD_S} s between frames was taken; give frame_period_s")
        return footage.ground(stages_for(RobotOptions()))


def audit_trajectory(
    trajectory: PathName | NDArray[np.generic] | GripperTrack,
    *,
    t_s: ArrayLike | None = None,
    rate_hz: float | None = None,
    tracked: ArrayLike | None = None,
    finger_width_m: ArrayLike | None = None,
    id: str | None = None,
    joints: str | None = None,
    poses: str | None = None,
    table_height_m: float = 0.0,
    urdf: PathName | None = None,
    tcp_frame: str | None = None,
) -> Judgement:
    """Judge one trajectory, as `kinebench-drake audit` does: can the robot do it, how well, and if not, why.

    Joint angles are judged as they are given; poses are infeasible only if no joint path does them. A track that
    `ground_video` found is judged as `score_videos` does it: allowing for what an estimated pose may be off.

    Args:
        trajectory: joint angles (T, 7) [rad], poses (T, 4, 4) of the TCP in the robot base frame [m], a track, or a
            path as `audit` takes it (docs/formats.md).
        t_s: (T,) times [s], increasing; of arrays only.
        rate_hz: frames per second [Hz], over the times.
        tracked: (T,) which frames are known; None: all. Of arrays only.
        finger_width_m: (T,) gap between the pads, 0 to 0.08 [m]; NaN or None: unknown. Of arrays only.
        id: which one, where the path holds several.
        joints: array, data set or column of a file that holds the joint angles.
        poses: array or column of a file that holds the poses.
        table_height_m: height of the table's top in the robot base frame [m].
        urdf: seven-joint arm to judge by, with `tcp_frame`; None: the Franka Panda.
        tcp_frame: frame of the URDF whose poses are given.

    Returns:
        `feasible` (None where it cannot be told), `violations`, `metrics` (None where not measurable, with `reasons`),
        `joints` (the joint path (T, 7) [rad] with its outcome frame by frame), `details`, `curves`.

    Raises:
        UsageError: an argument cannot be used, or the path holds no trajectory or several.
        InputError: the trajectory is not sound: shapes, times, units, rotations.
        UnmeasurableError: it has fewer than two known frames.
        SetupError: a library or the Panda's files are missing.

    Example:
        judgement = audit_trajectory(q, t_s=t_s)
        print(judgement.feasible, judgement.violations, judgement.metrics["manipulability_min"])
    """
    options = RobotOptions(table_height_m=table_height_m, urdf=path_of(urdf), tcp_frame=tcp_frame)
    if options.urdf is not None:
        warn(*audit.robot_remarks(options.urdf, tcp_frame))
    choice = TrajectoryOptions(rate_hz=rate_hz, joints=joints, poses=poses)
    if isinstance(trajectory, GripperTrack):
        refuse_with(
            "a track", t_s=t_s, rate_hz=rate_hz, tracked=tracked, finger_width_m=finger_width_m,
            id=id, joints=joints, poses=poses,
        )  # fmt: skip
        with one_thread():
            return stages_for(options).judge(trajectory)
    if isinstance(trajectory, str | PathLike):
        refuse_with("a file", t_s=t_s, tracked=tracked, finger_width_m=finger_width_m)
        found = single_trajectory(Path(trajectory), choice, id=id)
    else:
        refuse_with("an array", id=id, joints=joints, poses=poses)
        found = trajectory_of(
            np.asarray(trajectory), t_s=t_s, rate_hz=rate_hz, tracked=tracked, finger_width_m=finger_width_m
        )
    warn(*found.warnings)
    with one_thread():
        return judge_trajectory(stages_for(options), found)
