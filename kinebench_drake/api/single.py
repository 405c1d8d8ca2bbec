"""One sample by itself, nothing written: `ground_video` and `audit_trajectory`."""

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake import audit
from kinebench_drake.api.arguments import PathName, path_of, refuse_with, warn
from kinebench_drake.api.sample import single_trajectory, single_video, stages_for, trajectory_of, video_of
from kinebench_drake.camera import Camera
from kinebench_drake.engines.local import one_thread
from kinebench_drake.footage import BENCHMARK_PERIOD_S, PeriodSource, check_period, make_footage
from kinebench_drake.grounding.known import FirstFrame
from kinebench_drake.grounding.sources.sources import Sources
from kinebench_drake.inputs import CameraSource
from kinebench_drake.products import GripperTrack
from kinebench_drake.stages import Grounded, Judgement, StageOptions
from kinebench_drake.trajectories.trajectory import Choice
from kinebench_drake.trajectory_measure import judge_trajectory


def ground_video(
    video: PathName | NDArray[np.uint8],
    *,
    id: str | None = None,
    camera: Camera | PathName | None = None,
    camera_key: str | None = None,
    frame_period_s: float | None = None,
    first: FirstFrame | None = None,
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
    sources = Sources(
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
        given = camera if isinstance(camera, Camera) else Camera.load(Path(camera))
        sample = replace(sample, camera=given, camera_source=CameraSource.GIVEN)
    if first is not None:
        sample = replace(sample, first=first)
    with one_thread():
        footage = make_footage(decoded, sample, frame_period_s, sources)
        if footage.period_source is PeriodSource.BENCHMARK:
            warn(f"the video has no frame rate: {BENCHMARK_PERIOD_S} s between frames was taken; give frame_period_s")
        return footage.ground(stages_for(StageOptions()))


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
    options = StageOptions(table_height_m=table_height_m, urdf=path_of(urdf), tcp_frame=tcp_frame)
    if options.urdf is not None:
        warn(*audit.robot_remarks(options.urdf, tcp_frame))
    choice = Choice(rate_hz=rate_hz, joints=joints, poses=poses)
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
