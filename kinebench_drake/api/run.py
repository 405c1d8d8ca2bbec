"""Runs over many samples, into an output folder: `score_videos` and `run_suite`."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from kinebench_drake.api.arguments import PathName, Warner, member_of, path_of
from kinebench_drake.evaluation import score
from kinebench_drake.evaluation.runner import RunObserver, RunSummary
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.results.metadata import Shard


def score_videos(
    source: PathName,
    *,
    out: PathName,
    frame_period_s: float | None = None,
    camera_key: str | None = None,
    pixels_only: bool = False,
    overlay: bool = False,
    masks: PathName | None = None,
    depth: PathName | None = None,
    depth_exact: bool = False,
    poses: PathName | None = None,
    table_height_m: float = 0.0,
    replays: int = 3,
    task: str | None = None,
    model: str | None = None,
    tags: Mapping[str, str] | None = None,
    limit: int | None = None,
    jobs: int = 1,
    shard: str | None = None,
    engine: ExecutorKind | str = ExecutorKind.LOCAL,
    address: str | None = None,
    overwrite: bool = False,
    seed: int = 0,
    observer: RunObserver | None = None,
) -> RunSummary:
    """Score videos as `kinebench-drake score` does: tracks, kinematic metrics, verdicts, a report.

    A video that cannot be measured raises nothing: it is a row that says why. Finished rows that `out` holds already
    are kept. With `jobs` above 1 a script needs the guard `if __name__ == "__main__":`, as processes are spawned.

    Args:
        source: video, folder of videos or frame folders, dataset, npy, npz or HDF5 file, or manifest (docs/formats.md).
        out: output folder, made if absent.
        frame_period_s: task time between two frames [s], where no manifest tells; None: 1 / fps.
        camera_key: camera to take of datasets that have several.
        pixels_only: leave aside what the manifest tells of the first frame.
        overlay: write overlays/ID.mp4.
        masks: folder of masks in place of the network's.
        depth: folder of depth [m], `moge:CHECKPOINT` or `module:Class` in place of the network's depth.
        depth_exact: whether that depth can be trusted to a few millimetres.
        poses: folder of poses of panda_hand in the camera frame in place of the tracker's.
        table_height_m: height of the table's top in the robot's base frame [m].
        replays: 3D replays to write, of the worst samples.
        task: task of the samples, where the input does not tell.
        model: world model behind the samples, where the input does not tell.
        tags: labels kept in the results.
        limit: work on the first so many samples only.
        jobs: worker processes; 1 works in this one.
        shard: "I/N": work on part I of N only.
        engine: "local" or "ray".
        address: of the Ray cluster.
        overwrite: start anew instead of keeping finished rows.
        seed: of the intervals' resampling.
        observer: receiver of warnings and progress; None: warnings are Python warnings.

    Returns:
        All rows of the output folder by id, counts of their statuses, the share that is feasible, the report's path.

    Raises:
        UsageError: an argument, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.

    Example:
        summary = score_videos("videos", out="results", frame_period_s=0.2)
        for row in summary.rows:
            print(row.id, row.status.value, row.feasible, row.metrics["sparc"])
    """
    config = score.ScoreConfig(
        source=Path(source),
        out=Path(out),
        frame_period_s=frame_period_s,
        camera_key=camera_key,
        pixels_only=pixels_only,
        overlay=overlay,
        masks=path_of(masks),
        depth=None if depth is None else str(depth),
        depth_exact=depth_exact,
        poses=path_of(poses),
        table_height_m=table_height_m,
        replays=replays,
        task=task,
        model=model,
        tags=dict(tags or {}),
        limit=limit,
        jobs=jobs,
        shard=None if shard is None else Shard.parse(shard),
        engine=member_of(ExecutorKind, engine, "--engine"),
        address=address,
        overwrite=overwrite,
        seed=seed,
    )
    return score.score_videos(config, observer or Warner())


def run_suite(
    suite: int,
    *,
    world_model: str,
    out: PathName,
    split: str = "test",
    tasks: str | Sequence[str] | None = None,
    episodes: int = 10,
    variant: str = "plain",
    rounds: int = 3,
    control: str = "pd_joint_pos",
    action_repeat: int | None = None,
    frame_period_s: float = 0.2,
    pixels_only: bool = False,
    rollouts: bool = True,
    negative_prompt: str = "",
    replays: int = 3,
    model: str | None = None,
    tags: Mapping[str, str] | None = None,
    limit: int | None = None,
    jobs: int = 1,
    shard: str | None = None,
    engine: ExecutorKind | str = ExecutorKind.LOCAL,
    address: str | None = None,
    overwrite: bool = False,
    seed: int = 0,
    observer: RunObserver | None = None,
) -> RunSummary:
    """Run a world model on a suite in closed loop, as `kinebench-drake suite run` does.

    An episode that fails raises nothing: it is a row that says why. What `score_videos` says of `out` and `jobs` holds
    here, too.

    Args:
        suite: number of the suite, 0 to 3.
        world_model: who imagines: "oracle", "still", "http://...", "folder:DIR", "module:Class", ...
            (docs/worldmodels.md).
        out: output folder, made if absent.
        split: part of the suite; "test" is the one that is judged on.
        tasks: plain task ids, in a list or comma-separated; None: all of the split.
        episodes: episodes of each task.
        variant: "plain" or "obstacles".
        rounds: most clips an episode.
        control: what the robot is told: "pd_joint_pos" or "pd_ee_pose".
        action_repeat: control steps (at 20 Hz) a frame; None: as long as the frames last.
        frame_period_s: task time between two frames, 0.01 to 2 [s].
        pixels_only: leave aside that the robot knows where it stands in first frames.
        rollouts: write films of what was imagined and executed.
        negative_prompt: what shall not be seen.
        replays: 3D replays to write, of the worst episodes.
        model: name of the world model in the results; None: what it calls itself.
        tags: see `score_videos`, as of `limit`, `jobs`, `shard`, `engine`, `address`, `overwrite` and `observer`.
        limit: see `score_videos`.
        jobs: see `score_videos`.
        shard: see `score_videos`.
        engine: see `score_videos`.
        address: see `score_videos`.
        overwrite: see `score_videos`.
        seed: number of the first of the split's seeds, and seed of the intervals' resampling.
        observer: see `score_videos`.

    Returns:
        All rows of the output folder by id, counts of their statuses, the shares that are feasible and that reach
        their goal, the report's path. `row.extra` has `success`, `progress`, `rounds`, `verdict` and `cause`.

    Raises:
        UsageError: an argument or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.

    Example:
        summary = run_suite(0, world_model="oracle", tasks=["StackCube-v1"], episodes=2, out="ceiling")
        print(summary.success.mean, [row.extra["verdict"] for row in summary.rows])
    """
    from kinebench_drake.closed_loop.loop import LoopOptions  # the simulator and torch: seconds to load
    from kinebench_drake.evaluation.suite import SuiteConfig
    from kinebench_drake.evaluation.suite import run_suite as run
    from kinebench_drake.suites.selection import chosen_tasks
    from kinebench_drake.suites.simulator import Control
    from kinebench_drake.suites.suite import load_suite
    from kinebench_drake.suites.tasks.card import TaskVariant

    chosen, version = load_suite(suite), member_of(TaskVariant, variant, "--variant")
    config = SuiteConfig(
        suite=chosen,
        split=chosen.split_name(split),
        tasks=chosen_tasks(chosen, split, tasks, version),
        episodes=episodes,
        variant=version,
        world_model=world_model,
        loop=LoopOptions(
            rounds=rounds,
            control=member_of(Control, control, "--control"),
            action_repeat=action_repeat,
            frame_period_s=frame_period_s,
            pixels_only=pixels_only,
            negative_prompt=negative_prompt,
        ),
        rollouts=rollouts,
        replays=replays,
        out=Path(out),
        model=model,
        tags=dict(tags or {}),
        limit=limit,
        jobs=jobs,
        shard=None if shard is None else Shard.parse(shard),
        engine=member_of(ExecutorKind, engine, "--engine"),
        address=address,
        overwrite=overwrite,
        seed=seed,
    )
    return run(config, observer or Warner())
