"""Rendered videos with planted faults and ground truth: `python -m benchmarks.planted_videos --help`.

The videos without a fault come from `kinebench-drake suite demos`, in a folder of the same layout.
Folder written, the same bytes for the same arguments:

    ID.mp4              17 fps; ID = the episode's _ kind of fault [_ form] _ size
    camera.json         the camera of all of them
    manifest.jsonl      one object a video
    truth/ID.npz        t_s, base_from_tcp, camera_from_hand, q, finger_width_m [, depth_mm, mask]: as drawn, so NaN
                        where the gripper was made to vanish, the frozen pose in frozen frames
    truth/faults.json   for each video kind, frame_start, frame_end, size, form
    truth/outcome.json  the task's verdict on each episode
"""

import json
import multiprocessing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from kinebench_drake.errors import InputError, KinebenchError, UsageError
from kinebench_drake.io.camerafile import save_camera
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.faults.fault import FaultGrade, PlantedFault, choose
from kinebench_drake.suites.faults.fault_simulator import FaultSimulator
from kinebench_drake.suites.faults.plant import plant
from kinebench_drake.suites.faults.recording import Recording
from kinebench_drake.suites.rollout import Rollout, render_video, run_expert
from kinebench_drake.suites.simulator import ROBOTS
from kinebench_drake.suites.split import Pool
from kinebench_drake.suites.suite import EpisodeSpec, load_suite
from kinebench_drake.suites.tasks.registry import TASKS, find_task
from kinebench_drake.suites.tasks.task import TaskVariant
from kinebench_drake.types import AnomalyKind

FPS = 17
"""What the mp4 plays at; the task time between frames is `FRAME_PERIOD_S`."""
KINDS = tuple(kind.value for kind in AnomalyKind)
"""Kinds of faults."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantingOrder:
    """Which videos to make of one episode."""

    draw: EpisodeSpec
    """The episode."""
    robot: str
    """One of `stage.ROBOTS`."""
    grades: tuple[FaultGrade, ...]
    """Faults to plant, each in a video of its own."""
    with_depth: bool
    """Whether the truth holds depth and masks."""
    crf: int
    """x264's quality."""
    out: Path
    """Folder to write to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedVideo:
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
    fault: PlantedFault
    """What was done to it."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Made:
    """What came of an order."""

    samples: tuple[PlantedVideo, ...]
    """The videos written."""
    problems: tuple[str, ...]
    """Why others were not."""


def make(order: PlantingOrder) -> Made:
    """Perform an episode, film its first clip and plant each fault.

    The scene is of its own each time: nothing depends on what was made before. A fault for which the clip has no place,
    or an episode that the expert cannot do, is a problem told; it ends nothing.
    """
    draw, samples, problems = order.draw, [], []
    with FaultSimulator(draw.task, robot=order.robot, variant=draw.variant) as stage:
        try:
            performance = run_expert(stage, find_expert(draw.task), draw.episode())
        except InputError as error:
            return Made(samples=(), problems=(f"{draw.task} seed {draw.seed}: {error}",))
        performance = replace(performance, snapshots=performance.snapshots[: CLIP_FRAMES + 1])
        recording = Recording(simulator=stage, rollout=performance, video=render_video(stage, performance.snapshots))
        for grade in order.grades:
            try:
                clip, fault = plant(recording, grade)
            except InputError as error:
                problems.append(f"{draw.task} seed {draw.seed} {grade.label}: {error}")
                continue
            sample = _sample(performance, grade, fault)
            write_video(order.out / f"{sample.id}.mp4", clip.rgb, FPS, crf=order.crf)
            clip.save_truth(order.out / "truth" / f"{sample.id}.npz", with_images=order.with_depth)
            samples.append(sample)
        save_camera(stage.camera, order.out / "camera.json")
    return Made(samples=tuple(samples), problems=tuple(problems))


def _sample(performance: Rollout, grade: FaultGrade, fault: PlantedFault) -> PlantedVideo:
    episode = performance.episode
    return PlantedVideo(
        id=f"{episode.id}_{grade.label}",
        task=episode.task,
        seed=episode.seed,
        prompt=episode.prompt,
        success=performance.outcome.success,
        fault=fault,
    )


def _run(orders: Sequence[PlantingOrder], jobs: int) -> Iterator[Made]:
    if jobs == 1:
        yield from map(make, orders)
        return
    with multiprocessing.get_context("spawn").Pool(min(jobs, len(orders))) as pool:
        yield from pool.imap(make, orders)


def write_index(out: Path, samples: list[PlantedVideo]) -> None:
    """Write `manifest.jsonl`, `truth/faults.json` and `truth/outcome.json`, sorted by id."""
    samples = sorted(samples, key=lambda sample: sample.id)
    (out / "manifest.jsonl").write_text("".join(sample.manifest_line() for sample in samples))
    faults = {
        s.id: {
            "kind": s.fault.kind.value,
            "frame_start": s.fault.frame_start,
            "frame_end": s.fault.frame_end,
            "size": s.fault.size,
            "form": None if s.fault.form is None else s.fault.form.value,
        }
        for s in samples
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


def parse_kinds(text: str) -> tuple[AnomalyKind, ...]:
    """Kinds of faults from their names with commas between.

    Raises:
        UsageError: there is no such kind.
    """
    try:
        return tuple(AnomalyKind(kind) for kind in text.split(","))
    except ValueError:
        raise UsageError(f"kinds {text!r}; there are {', '.join(KINDS)}") from None


def choose_draws(
    tasks: str | None, seeds: str, suite: int | None, split: str, episodes: int, first: int
) -> list[EpisodeSpec]:
    """Episodes of some tasks: of plain seeds with all assets and looks, or of a suite's split.

    Raises:
        UsageError: tasks, seeds, suite or split are none.
    """
    names = None if tasks is None else tasks.split(",")
    if suite is None:
        chosen = [find_task(task).card.id for task in names or TASKS]
        return [
            EpisodeSpec(task=task, seed=seed, pool=Pool.ALL, variant=TaskVariant.PLAIN)
            for task in chosen
            for seed in parse_seeds(seeds)
        ]
    found = load_suite(suite)
    return [draw for task in found.tasks_of(split, names) for draw in found.specs(split, task, episodes, offset=first)]


@click.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks.planted_videos --out faults --suite 2 --split unseen --episodes 1 --sizes gated\n"
    "  python -m benchmarks.planted_videos --out jumps --tasks StackCube-v1 --seeds 0:5 --kinds teleport "
    "--sizes 0.03,0.05"
)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="Folder to write to.")
@click.option("--tasks", metavar="A,B", help="Tasks, comma-separated.  [default: all there are]")
@click.option("--seeds", default="0:1", show_default=True, help="Seeds: 7, 0:5 (end excluded), 0:5,9.")
@click.option("--suite", type=click.IntRange(0, 3), metavar="N", help="Take a suite's episodes instead of --seeds.")
@click.option("--split", default="test", show_default=True, help="Part of the suite.")
@click.option("--episodes", type=click.IntRange(1), default=1, show_default=True, help="Episodes of each task.")
@click.option(
    "--seed", "first", type=click.IntRange(0), default=0, show_default=True, help="First of the split's seeds."
)
@click.option("--robot", type=click.Choice(ROBOTS), default="panda", show_default=True, help="Robot.")
@click.option("--with-depth", is_flag=True, help="Keep depth and gripper masks in truth/ (some MB a video).")
@click.option("--kinds", default=",".join(KINDS), show_default=True, help="Kinds of faults.")
@click.option(
    "--sizes", default="all", show_default=True, help="all, gated (those that must be found), or numbers for one kind."
)
@click.option(
    "--each",
    type=click.IntRange(1),
    metavar="N",
    help="Each fault N times, on the episodes in turn.  [default: on all]",
)
@click.option("--crf", type=click.IntRange(0, 51), default=16, show_default=True, help="H.264 quality, 0 is lossless.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")
def main(
    out: Path,
    tasks: str | None,
    seeds: str,
    suite: int | None,
    split: str,
    episodes: int,
    first: int,
    robot: str,
    with_depth: bool,
    kinds: str,
    sizes: str,
    each: int | None,
    crf: int,
    jobs: int,
) -> None:
    """Render videos of the Panda doing tasks, each with one planted fault, and their ground truth."""
    try:
        grades = choose(parse_kinds(kinds), sizes)
        draws = choose_draws(tasks, seeds, suite, split, episodes, first)
    except UsageError as error:
        raise click.UsageError(str(error)) from None
    orders = [
        PlantingOrder(
            draw=draw,
            robot=robot,
            grades=grades if each is None else tuple(dict.fromkeys((grades * each)[i :: len(draws)])),
            with_depth=with_depth,
            crf=crf,
            out=out,
        )
        for i, draw in enumerate(draws)
    ]
    (out / "truth").mkdir(parents=True, exist_ok=True)
    samples: list[PlantedVideo] = []
    try:
        for made in _run([order for order in orders if order.grades], jobs):
            samples += made.samples
            for problem in made.problems:
                click.echo(problem, err=True)
            for sample in made.samples:
                click.echo(sample.id)
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    if not samples:
        raise click.ClickException("no video was made; the reasons stand above")
    write_index(out, samples)


if __name__ == "__main__":
    main()
