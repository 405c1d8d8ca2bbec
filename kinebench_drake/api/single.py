"""Single samples without an output folder: `ground_video` and `audit_trajectory`."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from difflib import get_close_matches
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.api.runs import PathName, own_arguments
from kinebench_drake.camera import Camera, CameraSetting, CameraSource
from kinebench_drake.errors import InputError, UnmeasurableError, UsageError, name_arguments
from kinebench_drake.executors.local import one_thread
from kinebench_drake.formats.camerafile import read_camera
from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import RawTrajectory
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import Video
from kinebench_drake.results.inputs import BENCHMARK_PERIOD_S, PeriodSource
from kinebench_drake.runs.audit import AuditConfig, judge_trajectory
from kinebench_drake.runs.config import RunConfig, ScoreConfig, period_warnings
from kinebench_drake.runs.evaluator import SampleInfo
from kinebench_drake.runs.preparation import ground_sample, with_initial_states
from kinebench_drake.runs.resources import Resources, ResourcesFactory, RobotOptions, load_resources
from kinebench_drake.track import GripperTrack, InitialState

if TYPE_CHECKING:  # torch, Open3D and Drake take seconds to load
    from kinebench_drake.grounding.video_result import GroundingResult
    from kinebench_drake.metrics.kinematic_result import KinematicResult

make_resources: ResourcesFactory = Resources
AnySample = TypeVar("AnySample", bound=SampleInfo)


def _tools_for(options: RobotOptions) -> Resources:
    """Return the tools for a robot, cached between calls unless a file of the user defines it."""
    own = not options.is_named or options.limits is not None
    return load_resources(make_resources, options) if own else cached_resources(options)


@lru_cache(maxsize=4)
def cached_resources(options: RobotOptions) -> Resources:
    """Return the resources of a robot, loaded once."""
    return load_resources(make_resources, options)


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


def camera_setting(camera: Camera | CameraSetting | PathName | None) -> CameraSetting | None:
    """Return the camera of an argument: as it is, by its name, or of a camera.json.

    Raises:
        UsageError: there is no such camera.
    """
    if isinstance(camera, str | PathLike):
        camera = read_camera(str(camera))
    return CameraSetting(camera=camera) if isinstance(camera, Camera) else camera


def _refuse_with(what: str, **arguments: object) -> None:
    """Check that arguments which do not apply to a kind of input are absent."""
    present = [name for name, value in arguments.items() if value is not None]
    if present:
        raise UsageError(f"{', '.join(present)}: has no effect with {what}, leave it out")


def _warn(*messages: str) -> None:
    """Warn the caller of the interface function that calls this."""
    for message in messages:
        warnings.warn(name_arguments(message), stacklevel=4)


_Config = TypeVar("_Config", bound=RunConfig)


def _config(kind: type[_Config], **options: Any) -> _Config:
    """Build the configuration of one sample, of the options that are not None; those of runs have no effect."""
    _refuse_with("one sample", **{f.name: options.get(f.name) for f in fields(RunConfig) if f.name != "table_height_m"})
    nowhere: dict[str, Any] = {"source": Path("unread"), "out": Path("unwritten")}
    return kind(**nowhere, **{name: value for name, value in options.items() if value is not None})


@own_arguments()
def ground_video(
    video: PathName | NDArray[np.uint8],
    *,
    id: str | None = None,
    camera: Camera | CameraSetting | PathName | None = None,
    first: InitialState | None = None,
    **options: Any,
) -> "GroundingResult":
    """Track the gripper through one video, as `kinebench-drake ground` does; nothing is written.

    The networks are loaded with the first call and kept.

    Args:
        video: a path as `score_videos` takes it, or frames (T, H, W, 3) uint8 RGB.
        id: id of the sample, where the path holds several; of frames: name of their files in `masks`, `depth`, `poses`.
        camera: the camera, what its camera.json states (`load_camera`), or its name or the path of that file; None:
            that of the input, else as `score_videos` chooses it.
        first: state of the robot in the first frame, in place of the input's (`X_BG`: TCP in the robot base frame [m]).
        **options: fields of `ScoreConfig` that concern one video, which are options of the command: `frame_period_s`
            [s], `camera_key`, `view`, `gripper`, `mirrored`, `pixels_only`, `masks`, `depth`, `depth_exact`, `poses`.

    Returns:
        `track`: (T,) times [s], poses (T, 4, 4) of panda_hand in the camera frame and of panda_hand_tcp in the base
        frame [m], NaN where not tracked, confidence, gap between the pads [m]; `anomalies`; `camera_motion_px`;
        `robot` (T, H, W), the pixels that show the robot; `choice`, the camera and the evidence for it; `measured`, the
        measurements behind them (`PipelineResult`).

    Raises:
        UsageError: an argument cannot be used, or the path holds no video or several.
        InputError: the video is broken.
        UnmeasurableError: it is too small or too short, no camera fits its shape, or too few frames show a gripper.
        SetupError: weights or libraries are missing.

    Example:
        track = ground_video("videos/episode.mp4", frame_period_s=0.2).track
        print(track.X_BG[track.tracked, :3, 3])
    """
    config = _config(ScoreConfig, **options)
    overrides = config.overrides()
    _warn(*period_warnings([config.frame_period_s]))
    if isinstance(video, str | PathLike):
        inputs = find_samples(Path(video), others=tuple(overrides.folders.values()), camera_key=config.camera_key)
        sample = _one(inputs.samples, Path(video), id)
        if sample.problem is not None:
            raise InputError(sample.problem)
        sample = replace(sample, initial_state=None) if config.pixels_only else with_initial_states([sample])[0]
        decoded = read_video(sample.path, sample.part)
        _warn(*inputs.warnings)
    else:
        _refuse_with("frames", camera_key=config.camera_key)
        name = id or "video"
        sample = VideoSample(id=name, path=Path(name), video=name)
        decoded = Video(frames=np.asarray(video), fps=None, stamps_s=None)
    sample = sample.filmed_by(camera_setting(camera), CameraSource.ARGUMENT)
    if first is not None:
        sample = replace(sample, initial_state=first)
    sample = replace(sample, mirrored=sample.mirrored or config.mirrored)
    with one_thread():
        grounder = _tools_for(RobotOptions()).grounder
        timed, result = ground_sample(
            decoded, sample, overrides, grounder, config.frame_period_s, config.gripper,
            duration_s=config.task_duration_s, view=config.view,
        )  # fmt: skip
    if result.unmeasurable is not None:
        raise UnmeasurableError(result.unmeasurable)
    choice = result.choice
    if choice.reason is not None:
        _warn(choice.reason)
    elif choice.contradiction is not None:
        _warn(choice.contradiction.describe())
    if timed.source is PeriodSource.BENCHMARK:
        _warn(f"the video has no frame rate: {BENCHMARK_PERIOD_S} s between frames was taken; give frame_period_s")
    return result


@own_arguments()
def audit_trajectory(
    trajectory: PathName | NDArray[np.generic] | GripperTrack,
    *,
    t_s: ArrayLike | None = None,
    tracked: ArrayLike | None = None,
    finger_width_m: ArrayLike | None = None,
    id: str | None = None,
    reading: PathName | Mapping[str, object] | None = None,
    **options: Any,
) -> "KinematicResult":
    """Judge one trajectory, as `kinebench-drake audit` does: whether and how well the robot executes it, else why not.

    Joint angles are judged as recorded; poses are infeasible only if no joint path follows them. A track of
    `ground_video` is judged as in `score_videos`: with the error that an estimated pose may have.

    Args:
        trajectory: joint angles (T, 7) [rad], poses (T, 4, 4) of the TCP in the robot base frame [m], a track, or a
            path as `audit` takes it (docs/formats.md).
        t_s: (T,) times [s], increasing; of arrays only.
        tracked: (T,) frames with a pose or joint angles; None: all. Of arrays only.
        finger_width_m: (T,) gap between the pads, 0 to 0.08 [m]; NaN or None: unknown. Of arrays only.
        id: id of the sample, where the path holds several.
        reading: how to read a file: path of a reading file, or its keys (docs/formats.md); None: by the names in it.
        **options: fields of `AuditConfig` that concern one trajectory, which are options of the command: `rate_hz`,
            over the times [Hz]; `table_height_m` [m], `robot`, `tool`, `limits`, `payload_kg` [kg], `obstacles`,
            `package_path`.

    Returns:
        `feasible` (None if undecided), `violations`, `metrics` (None where not measurable, with `reasons`), `joints`
        (the joint path (T, 7) [rad] with the outcome of each frame), `details`, `curves`.

    Raises:
        UsageError: an argument cannot be used, or the path holds no trajectory or several.
        InputError: the trajectory is not sound: shapes, times, units, rotations.
        UnmeasurableError: it has fewer than two tracked frames.
        SetupError: a library or the Panda's files are missing.

    Example:
        result = audit_trajectory(q, t_s=t_s)
        print(result.feasible, result.violations, result.metrics["manipulability_min"])
    """
    config = _config(AuditConfig, **options)
    robot = config.robot_options()
    rate_hz = config.rate_hz
    loaded = robot.load()
    _warn(*loaded.remarks)
    if isinstance(reading, str | PathLike):
        reading = Path(reading)
    parsed = None if reading is None else Reading.parse(reading)
    choice = TrajectoryOptions(rate_hz=rate_hz, reading=parsed, joints=loaded.column_names)
    if isinstance(trajectory, GripperTrack):
        _refuse_with(
            "a track", t_s=t_s, rate_hz=rate_hz, tracked=tracked, finger_width_m=finger_width_m,
            id=id, reading=reading,
        )  # fmt: skip
        with one_thread():
            return _tools_for(robot).judge(trajectory)
    if isinstance(trajectory, str | PathLike):
        _refuse_with("a file", t_s=t_s, tracked=tracked, finger_width_m=finger_width_m)
        path = Path(trajectory)
        checked = read_trajectory(_one(find_trajectories(path, choice), path, id), choice)
    else:
        _refuse_with("an array", id=id, reading=reading)
        values = np.asarray(trajectory)
        if values.ndim not in (2, 3):
            raise InputError(
                f"the trajectory has shape {values.shape}, expected joint angles (T, {len(loaded.joints)}) in radians "
                "or poses (T, 4, 4)"
            )
        recording = RawTrajectory(
            t_s=None if t_s is None else np.asarray(t_s),
            X_BG=values if values.ndim == 3 else None,
            q=values if values.ndim == 2 else None,
            tracked=None if tracked is None else np.asarray(tracked),
            finger_width_m=None if finger_width_m is None else np.asarray(finger_width_m),
            columns="q" if values.ndim == 2 else "base_from_tcp",
            joints=len(loaded.joints),
        )
        checked = check(recording, rate_hz)
    _warn(*checked.warnings)
    with one_thread():
        return judge_trajectory(_tools_for(robot), checked)
