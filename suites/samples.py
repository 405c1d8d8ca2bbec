"""Rendered example videos with ground truth: `python -m kinebench_drake.suites.samples --help`.

Folder written, the same bytes for the same arguments:

    ID.mp4              17 fps; ID = task _ s seed [_ fault]
    camera.json         the camera of all of them
    manifest.jsonl      one object a video
    truth/ID.npz        t_s, base_from_tcp, camera_from_hand, q, finger_width_m [, depth_mm, mask]: as drawn, so NaN
                        where the gripper was made to vanish, the frozen pose in frozen frames
    truth/faults.json   for each faulty video kind, frame_start, frame_end, size
    truth/outcome.json  the task's verdict on each episode
"""

import json
import multiprocessing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import click

from kinebench_drake.errors import InputError, KinebenchError, UsageError
from kinebench_drake.mp4 import write_video
from kinebench_drake.products import AnomalyKind
from kinebench_drake.suites.episode import compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.faults import PlantedFault, plant_freeze, plant_teleport, plant_vanish
from kinebench_drake.suites.rollout import FRAME_PERIOD_S, ROBOTS, Clip, Performance, Stage, film, perform
from kinebench_drake.suites.tasks.registry import TASKS, find_task

FPS = 17
"""What the mp4 plays at; the task time between frames is `FRAME_PERIOD_S`."""
KINDS = tuple(kind.value for kind in AnomalyKind)
"""Kinds of faults."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """Which videos to make of one episode."""

    task: str
    """Plain task id."""
    seed: int
    """Seed of the scene."""
    robot: str
    """One of `rollout.ROBOTS`."""
    clean: bool
    """Whether to write the video without a fault."""
    faults: tuple[AnomalyKind, ...]
    """Faulty versions to write as well."""
    with_depth: bool
    """Whether the truth holds depth and masks."""
    crf: int
    """x264's quality."""
    dry_run: bool
    """Perform only: no video, no file."""
    out: Path
    """Folder to write to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One video written."""

    id: str
    """Name of its files."""
    task: str
    """Plain task id."""
    seed: int
    """Seed of the scene."""
    prompt: str
    """The task in words."""
    success: bool
    """The task's verdict on the episode it was made from."""
    fault: PlantedFault | None = None
    """The planted fault, if any."""

    def manifest_line(self) -> str:
        """Its line of `manifest.jsonl`."""
        record = {
            "video": f"{self.id}.mp4",
            "id": self.id,
            "task": self.task,
            "seed": self.seed,
            "prompt": self.prompt,
            "fps": FPS,
            "frame_period_s": FRAME_PERIOD_S,
        }
        return json.dumps(record) + "\n"


def _versions(
    stage: Stage, performance: Performance, clip: Clip, order: Order
) -> Iterator[tuple[Clip, PlantedFault | None]]:
    if order.clean:
        yield clip, None
    for kind in order.faults:
        if kind is AnomalyKind.VANISH:
            yield plant_vanish(stage, performance, clip)
        elif kind is AnomalyKind.TELEPORT:
            yield plant_teleport(stage, performance, clip)
        else:
            yield plant_freeze(clip)


def make(order: Order) -> list[Sample]:
    """Perform, film and write one episode. A scene of its own each time: nothing depends on what was made before.

    Raises:
        InputError: the expert or a fault does not work in this scene.
    """
    with Stage(order.task, robot=order.robot) as stage:
        performance = perform(stage, find_expert(order.task), compose(order.task, order.seed))
        if order.dry_run:
            return [_sample(performance, None)]
        clip = film(stage, performance.snapshots)
        samples = []
        for version, fault in _versions(stage, performance, clip, order):
            sample = _sample(performance, fault)
            write_video(order.out / f"{sample.id}.mp4", version.rgb, FPS, crf=order.crf)
            version.save_truth(order.out / "truth" / f"{sample.id}.npz", with_images=order.with_depth)
            samples.append(sample)
        stage.camera.save(order.out / "camera.json")
    return samples


def _sample(performance: Performance, fault: PlantedFault | None) -> Sample:
    episode = performance.episode
    return Sample(
        id=episode.id + (f"_{fault.kind.value}" if fault else ""),
        task=episode.task,
        seed=episode.seed,
        prompt=episode.prompt,
        success=performance.outcome.success,
        fault=fault,
    )


def _make(order: Order) -> tuple[list[Sample], str]:
    """What `make` gives, or nothing and the reason: one episode that cannot be done does not end the run."""
    try:
        return make(order), ""
    except InputError as error:
        return [], f"{order.task} seed {order.seed}: {error}"


def _run(orders: Sequence[Order], jobs: int) -> Iterator[tuple[list[Sample], str]]:
    if jobs == 1:
        yield from map(_make, orders)
        return
    with multiprocessing.get_context("spawn").Pool(min(jobs, len(orders))) as pool:
        yield from pool.imap(_make, orders)


def write_index(out: Path, samples: list[Sample]) -> None:
    """Write `manifest.jsonl`, `truth/faults.json` and `truth/outcome.json`, sorted by id."""
    samples = sorted(samples, key=lambda sample: sample.id)
    (out / "manifest.jsonl").write_text("".join(sample.manifest_line() for sample in samples))
    faults = {
        s.id: {
            "kind": s.fault.kind.value,
            "frame_start": s.fault.frame_start,
            "frame_end": s.fault.frame_end,
            "size": s.fault.size,
        }
        for s in samples
        if s.fault
    }
    (out / "truth" / "faults.json").write_text(json.dumps(faults, indent=1) + "\n")
    outcome = {s.id: {"episode_success": s.success} for s in samples}
    (out / "truth" / "outcome.json").write_text(json.dumps(outcome, indent=1) + "\n")


def parse_seeds(text: str) -> list[int]:
    """Seeds of `7`, `0:5` (end excluded) or a comma-separated list of such.

    Raises:
        UsageError: it is none of these.
    """
    seeds: list[int] = []
    for part in text.split(","):
        first, colon, end = part.partition(":")
        try:
            seeds += range(int(first), int(end)) if colon else [int(first)]
        except ValueError:
            raise UsageError(f"seeds {text!r}: expected whole numbers such as 7, 0:5 or 0:5,9") from None
    if not seeds or min(seeds) < 0:
        raise UsageError(f"seeds {text!r}: expected at least one, none negative, such as 0:5")
    return seeds


@click.command()
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="Folder to write to.")
@click.option("--tasks", default=",".join(TASKS), show_default=True, help="Tasks, comma-separated.")
@click.option("--seeds", default="0:1", show_default=True, help="Seeds: 7, 0:5 (end excluded), 0:5,9.")
@click.option("--robot", type=click.Choice(ROBOTS), default="panda", show_default=True, help="Robot.")
@click.option("--with-depth", is_flag=True, help="Keep depth and gripper masks in truth/ (some MB a video).")
@click.option("--faults", is_flag=True, help="Also write each video with each kind of planted fault.")
@click.option("--kinds", default=",".join(KINDS), show_default=True, help="Kinds of faults for --faults.")
@click.option("--one-each", is_flag=True, help="With --faults: each kind once, on the first episodes in turn.")
@click.option("--only-faults", is_flag=True, help="Write no video without a fault.")
@click.option("--crf", type=click.IntRange(0, 51), default=18, show_default=True, help="H.264 quality, 0 is lossless.")
@click.option("--dry-run", is_flag=True, help="Write nothing: only perform, and count each task's successes.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")
def main(
    out: Path,
    tasks: str,
    seeds: str,
    robot: str,
    with_depth: bool,
    faults: bool,
    kinds: str,
    one_each: bool,
    only_faults: bool,
    crf: int,
    dry_run: bool,
    jobs: int,
) -> None:
    r"""Render videos of the Panda doing tasks, with ground truth and, if asked for, planted faults.

    \b
    Example:
      python -m kinebench_drake.suites.samples --out demo-output/samples --tasks StackCube-v1 --seeds 0:2 --faults
    """
    try:
        planted = tuple(AnomalyKind(kind) for kind in kinds.split(",")) if faults or only_faults else ()
    except ValueError:
        raise click.BadParameter(f"{kinds!r}; there are {', '.join(KINDS)}", param_hint="--kinds") from None
    try:
        episodes = list(product([find_task(task).card.id for task in tasks.split(",")], parse_seeds(seeds)))
    except UsageError as error:
        raise click.UsageError(str(error)) from None
    orders = [
        Order(
            task=task,
            seed=seed,
            robot=robot,
            clean=not only_faults,
            faults=planted[i : i + 1] if one_each else planted,
            with_depth=with_depth,
            crf=crf,
            dry_run=dry_run,
            out=out,
        )
        for i, (task, seed) in enumerate(episodes)
    ]
    if not dry_run:
        (out / "truth").mkdir(parents=True, exist_ok=True)
    samples: list[Sample] = []
    try:
        for made, reason in _run(orders, jobs):
            samples += made
            if reason:
                click.echo(reason, err=True)
            for sample in made:
                click.echo(f"{sample.id}  {'success' if sample.success else 'FAILED'}")
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    if not samples:
        raise click.ClickException("no episode was done; the reasons stand above")
    if dry_run:
        for task in dict.fromkeys(order.task for order in orders):
            done = sum(sample.success for sample in samples if sample.task == task)
            click.echo(f"{task}: {done} of {sum(order.task == task for order in orders)} succeeded")
        return
    write_index(out, samples)


if __name__ == "__main__":
    main()
