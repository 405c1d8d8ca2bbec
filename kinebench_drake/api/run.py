"""Runs over many samples into an output folder: `score_videos` and `run_suite`."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias, TypedDict, Unpack

from kinebench_drake.errors import KinebenchError, member_of, name_arguments
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.results.metadata import Shard
from kinebench_drake.runs import score
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary
from kinebench_drake.runs.score_config import ScoreConfig

PathName: TypeAlias = str | PathLike[str]


class RunOptions(TypedDict, total=False):
    """Options common to all runs; the defaults are those of the commands."""

    replays: int
    """3D replays to write, of the worst samples; default 3."""
    model: str
    """World model behind the samples, where the input does not name it; of `run_suite` its name in the results."""
    tags: Mapping[str, str]
    """Labels kept in the results."""
    limit: int
    """Evaluate only the first so many samples."""
    jobs: int
    """Worker processes; 1 works in this process."""
    shard: str
    """ "I/N": evaluate only part I of N."""
    engine: ExecutorKind | str
    """ "local" or "ray"."""
    address: str
    """Address of the Ray cluster."""
    overwrite: bool
    """Start anew instead of keeping finished rows."""
    seed: int
    """Seed of the bootstrap; of `run_suite` also the number of the first of the split's seeds."""


class ScoreOptions(RunOptions, total=False):
    """Options of `score_videos`."""

    frame_period_s: float | None
    """Task time between two frames [s], where no manifest states it; None: 1 / fps."""
    clip_timing: str
    """ "uniform" or "native"; default native, uniform with `task_duration_s`."""
    task_duration_s: float | None
    """Task time that each video shows, whatever its number of frames [s]."""
    camera_key: str | None
    """Camera to use of datasets that have several."""
    camera: PathName
    """Camera of videos that name none: "auto" or "benchmark"; or the camera.json of all videos. Default "auto"."""
    mirrored: bool
    """Turn all frames left-right before they are measured."""
    gripper: str
    """ "franka", "robotiq-2f85", "none" or "auto", the default: with others than Franka's the arm gives the flange."""
    pixels_only: bool
    """Ignore the initial state that the manifest states."""
    overlay: bool
    """Write overlays/ID.mp4."""
    masks: PathName | None
    """Folder of masks that replace the network's."""
    depth: PathName | None
    """Folder of depth maps [m], `moge:CHECKPOINT` or `module:Class` that replaces the network's depth."""
    depth_exact: bool
    """Treat that depth as accurate to a few millimetres."""
    poses: PathName | None
    """Folder of poses of panda_hand in the camera frame that replace the tracker's."""
    table_height_m: float
    """Height of the table top in the robot base frame [m]."""
    task: str | None
    """Task of the samples, where the input does not name it."""


class SuiteOptions(RunOptions, total=False):
    """Options of `run_suite`."""

    split: str
    """Split of the suite; default "test"."""
    tasks: str | Sequence[str] | None
    """Plain task ids, in a list or comma-separated; None: all of the split."""
    episodes: int
    """Episodes of each task; default 10."""
    samples: int
    """Samples of each episode, with another seed of the world model each; default 1."""
    variant: str
    """ "plain" or "obstacles"."""
    rounds: int
    """Greatest number of clips an episode; default 3."""
    control: str
    """Controller of the robot: "pd_joint_pos" or "pd_ee_pose"."""
    action_repeat: int | None
    """Control steps (at 20 Hz) a frame; None: as long as the frames last."""
    frame_period_s: float
    """Task time between two frames, 0.01 to 2 [s]; default 0.2."""
    clip_timing: str
    """ "uniform" or "native"; default: uniform for models that choose the number of frames."""
    condition: str
    """ "none" or "actions": state the expert's track in requests, and measure how far videos follow it."""
    pixels_only: bool
    """Ignore the known pose of the robot in first frames."""
    prompt_preset: str
    """ "visual-lock": prefix and negative prompt for a fixed camera, an unchanged robot and unchanged objects."""
    prompt_prefix: str
    """Text before each prompt."""
    prompt_suffix: str
    """Text after each prompt."""
    prompts: PathName | Mapping[str, str]
    """Text by task in place of the instruction, which "{prompt}" in it stands for; or a JSON file with them."""
    negative_prompt: str
    """Content to avoid, in every request."""
    rollouts: bool
    """Write videos of generated and executed frames."""


@contextmanager
def own_arguments() -> Iterator[None]:
    """Word the messages of errors for callers of the interface."""
    try:
        yield
    except KinebenchError as error:
        error.args = (name_arguments(str(error)),)
        raise


@own_arguments()
def score_videos(
    source: PathName, *, out: PathName, observer: RunObserver | None = None, **options: Unpack[ScoreOptions]
) -> RunSummary:
    """Score videos as `kinebench-drake score` does: tracks, kinematic metrics, verdicts, a report.

    A video that cannot be measured raises nothing: it becomes a row with the reason. Finished rows that `out` already
    holds are kept. With `jobs` above 1 a script needs the guard `if __name__ == "__main__":`, as processes are spawned.

    Args:
        source: video, folder of videos or frame folders, dataset, npy, npz or HDF5 file, or manifest (docs/formats.md).
        out: output folder, created if absent.
        observer: receives warnings and progress; None: warnings are Python warnings.
        **options: see `ScoreOptions` and `RunOptions`; they are the options of the command.

    Returns:
        All rows of the output folder by id, counts of their statuses, the share that is feasible, the report's path.

    Raises:
        UsageError: an argument, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.

    Example:
        summary = score_videos("videos", out="results", frame_period_s=0.2)
        for row in summary.rows:
            print(row.id, row.status.value, row.feasible, row.metrics["sparc"])
    """
    config = ScoreConfig(source=Path(source), out=Path(out), **_parsed(options))
    return score.score_videos(config, observer or Warner())


@own_arguments()
def run_suite(
    suite: int, *, world_model: str, out: PathName, observer: RunObserver | None = None, **options: Unpack[SuiteOptions]
) -> RunSummary:
    """Run a world model on a suite in closed loop, as `kinebench-drake suite run` does.

    An episode that fails raises nothing: it becomes a row with the reason. `out` and `jobs` work as in `score_videos`.

    Args:
        suite: number of the suite, 0 to 3.
        world_model: spec of the world model: "oracle", "still", "http://...", "folder:DIR", "module:Class", ...
            (docs/worldmodels.md).
        out: output folder, created if absent.
        observer: receives warnings and progress; None: warnings are Python warnings.
        **options: see `SuiteOptions` and `RunOptions`; they are the options of the command.

    Returns:
        All rows of the output folder by id, counts of their statuses, the shares that are feasible and successful, the
        report's path. `row.extra` has `success`, `progress`, `rounds`, `verdict` and `cause`.

    Raises:
        UsageError: an argument or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.

    Example:
        summary = run_suite(0, world_model="oracle", tasks=["StackCube-v1"], episodes=2, out="ceiling")
        print(summary.success.mean, [row.extra["verdict"] for row in summary.rows])
    """
    from kinebench_drake.runs import suite as suites

    config = suites.suite_config(suite, world_model=world_model, out=Path(out), **_parsed(options))
    return suites.run_suite(config, observer or Warner())


class Warner(NullRunObserver):
    """An observer that turns warnings into Python warnings."""

    def warn(self, message: str) -> None:
        """Warn the caller of the interface function."""
        warnings.warn(name_arguments(message), stacklevel=5)


def _parsed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Convert options from what callers pass to what the configurations take.

    Raises:
        UsageError: a value is invalid.
    """
    parsers: dict[str, Callable[[Any], Any]] = {
        "masks": Path,
        "poses": Path,
        "depth": str,
        "camera": str,
        "prompts": lambda prompts: dict(prompts) if isinstance(prompts, Mapping) else Path(prompts),
        "shard": Shard.parse,
        "engine": lambda engine: member_of(ExecutorKind, engine, "engine"),
        "tags": dict,
    }
    stated = {name: value for name, value in options.items() if value is not None}
    return {"replays": 3, **stated, **{name: parsers[name](value) for name, value in stated.items() if name in parsers}}
