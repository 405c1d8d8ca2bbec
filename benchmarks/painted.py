"""Clips painted from known numbers: faults of the gripper by these numbers, beside those that score reports.

The latent vector of the world model in examples/worldmodel is known: where the points of the robot are in each frame,
as the camera sees them. So the place, the length and the opening of the gripper in a generated clip are exact. The
decoder draws the hand about the wrist's point and the fingers about the tips, each of the right size; the points at the
ends of the hand only turn it. Frame 0 is the picture that was given; its numbers are the encoder's estimate.

A spliced clip changes from one sample of the dynamics to another, at once or by a cross-fade: the gripper jumps.

    ID.mp4              17 fps; ID = the episode's _ name of the dynamics
    painted.jsonl       one object a clip (`PaintedClip`)
    manifest.jsonl      what `kinebench-drake score` needs
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import TypeAdapter

from benchmarks.markdown import table
from benchmarks.perception.store import MeasurementStore, Stored, fingerprint
from examples.worldmodel.generator import Generator
from examples.worldmodel.robot import FIELD, NEAR_M, POINTS, ROBOT
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.executors.base import Observer
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.formats.manifest import NAME
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.grounding.anomaly.jumps import find_finger_faults, find_teleports
from kinebench_drake.io.container import write_video
from kinebench_drake.io.jsonl import read_lines, write_lines
from kinebench_drake.models.panda.description import HAND_TO_TCP_M
from kinebench_drake.named_cameras import BENCHMARK
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.segments import segments
from kinebench_drake.stats import wilson
from kinebench_drake.suites.catalog import EpisodeSpec, load_suite
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.export import FPS
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache

TRUTH = "painted.jsonl"
TASKS = ("OpenBoxEasy-v1", "PullCube-v1", "StackCube-v1", "StoreCube-v2")
"""Tasks that the world model has learned."""
FIRST_SEED = 900_000
"""Number of the first seed of suite 3's test split: runs of the suite use the first ones, demonstrations others."""
ODD_STEP_M = 0.03
"""Least deviation of an odd step from the mean of the steps before and after it [m].

248 demonstrations of the four tasks, of the kind that the model has learned, stay below 0.015 m; the score of their
exact paths' teleports below 0.5, 1 being its bound."""
SIZE_ERROR = 0.05
"""Least relative error of the gripper's length of a wrong size."""
SIZE_FRAMES = 5
"""Fewest consecutive frames of a wrong size."""
TOLERANCE = 2
"""Greatest distance of a reported fault from the true one [frames]."""
_FAULT_HEAD = ("fault by the numbers", "dynamics", "counted", "true", "reported", "precision", "recall", "open")
_ERROR_HEAD = (
    *("dynamics", "clips", "frames tracked", "TCP error, median", "95 %"),
    *("error of the length by the numbers, 95 %", "`hand_size_error`, 95 %"),
)
_WRIST = 10
"""First of the gripper's six points among those of the robot."""


SAMPLES = 6
"""Samples of the dynamics, of which a spliced clip takes two."""
SPLICE_M = (0.03, 0.08)
"""Range of the lengths of spliced jumps [m]."""
SPLICE_FRAMES = range(6, 43)
"""Frames from which the second sample may show."""
FADES = (0, 2, 0, 3)
"""Frames of the cross-fades of spliced clips, in turn; 0: a hard cut."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Splice:
    """Change from one sample of the dynamics to another."""

    frame: int
    """First frame in which the second sample prevails."""
    faded: int
    """Frames that show both samples, cross-faded; 0: a hard cut."""
    length_m: float
    """Step of the TCP from the first to the second sample, off the mean of the steps before and after [m]."""

    @property
    def faded_frames(self) -> slice:
        """Frames that show both samples."""
        start = self.frame - self.faded // 2
        return slice(start, start + self.faded)

    @property
    def frames(self) -> slice:
        """Frames of the jump: those that show both samples, and the first after them."""
        return slice(self.faded_frames.start, self.faded_frames.stop + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class PaintOrder:
    """Clip to paint."""

    spec: EpisodeSpec
    """Episode whose first frame the clip continues."""
    dynamics: str
    """Name of the dynamics' weights."""
    faded: int | None = None
    """Frames of the cross-fade of a spliced clip, 0 for a hard cut; None: the clip is not spliced."""

    @property
    def id(self) -> str:
        """Name of the clip."""
        return f"{self.spec.id}_{self.dynamics}" + ("" if self.faded is None else f"_spliced{self.faded}")


@dataclass(frozen=True, slots=True, kw_only=True)
class PaintedClip:
    """Numbers from which a clip was painted."""

    id: str
    task: str
    seed: int
    prompt: str
    dynamics: str
    sampling_seed: int
    p_C: Annotated[Array, Stored(".5f")]
    """(T, 3) TCP in the camera frame [m]."""
    size: Annotated[Array, Stored(".4f")]
    """(T,) distance from the wrist to the middle of the finger tips, over the right one."""
    finger_width_m: Annotated[Array, Stored(".5f")]
    """(T,) gap between the finger pads, negative where the fingers have changed sides [m]."""
    splice: Splice | None = None
    """Where the clip is spliced; a faded frame has the numbers of the sample that prevails."""

    def manifest_row(self) -> dict[str, object]:
        """Return its line of `manifest.jsonl`."""
        labels = {"id": self.id, "task": self.task, "seed": self.seed, "prompt": self.prompt, "model": self.dynamics}
        timing = {"fps": FPS, "frame_period_s": FRAME_PERIOD_S}
        return {"video": f"{self.id}.mp4", **labels, **timing, "camera": BENCHMARK}


def measure_gripper(poses: Array) -> tuple[Array, Array, Array]:
    """Return the TCP (T, 3) [m], the relative size (T,) and the gap (T,) [m] of pose numbers (T, POSE)."""
    points = np.asarray(poses, dtype=np.float64)[:, :-1].reshape(-1, POINTS, 3)[:, _WRIST:ROBOT]
    z_m = NEAR_M / (1.0 + points[..., 2:])
    p_C = np.concatenate([points[..., :2] * FIELD * z_m, z_m], axis=-1)
    wrist, left, right, tcp, left_tip, right_tip = p_C.swapaxes(0, 1)
    across = (left - right) / np.linalg.norm(left - right, axis=1, keepdims=True)
    length_m = np.linalg.norm(0.5 * (left_tip + right_tip) - wrist, axis=1)
    return tcp, length_m / HAND_TO_TCP_M, ((left_tip - right_tip) * across).sum(axis=1)


class Painter:
    """Renders first frames and paints their clips; keeps one simulator and one model."""

    def __init__(self, make_generator: Callable[[str], Generator], out: Path) -> None:
        """Take the maker of a generator by the name of its dynamics, and the folder of the clips."""
        self._make_generator = make_generator
        self._out = out
        self._simulators = SimulatorCache(Simulator)
        self._generators = dict[str, Generator]()

    def __call__(self, order: PaintOrder) -> PaintedClip:
        """Write a clip."""
        simulator = self._simulators.get(order.spec.task, order.spec.variant)
        episode = order.spec.episode()
        simulator.reset(episode)
        first = simulator.render().rgb
        if order.dynamics not in self._generators:
            self._generators[order.dynamics] = self._make_generator(order.dynamics)
        model = self._generators[order.dynamics]
        rng = generator("painted", order.id)
        sampling_seed = int(rng.integers(2**31))
        poses = model.imagine(first, episode.prompt, sampling_seed)
        splice = None
        if order.faded is None:
            video = model.paint(first, poses)
        else:
            others = [model.imagine(first, episode.prompt, sampling_seed + k) for k in range(1, SAMPLES)]
            splice, one, other = choose_splice(torch.stack([poses, *others]), order.faded, rng)
            video = paint_splice(model, first, one, other, splice)
            poses = torch.cat([one[: splice.frame], other[splice.frame :]])
        write_video(self._out / f"{order.id}.mp4", video, FPS)
        p_C, size, finger_width_m = measure_gripper(poses.numpy())
        return PaintedClip(
            id=order.id,
            task=episode.task,
            seed=episode.seed,
            prompt=episode.prompt,
            dynamics=order.dynamics,
            sampling_seed=sampling_seed,
            p_C=p_C,
            size=size,
            finger_width_m=finger_width_m,
            splice=splice,
        )

    def close(self) -> None:
        """Release the simulator."""
        self._simulators.close()


def choose_splice(
    samples: torch.Tensor, faded: int, rng: np.random.Generator
) -> tuple[Splice, torch.Tensor, torch.Tensor]:
    """Choose two of samples (S, T, POSE) and where to change from one to the other so that the TCP jumps.

    It moves farther than in the steps around, by `SPLICE_M[0]` at least, and off their mean by a length in that range.

    Raises:
        InputError: there is no such change.
    """
    p_C = np.stack([measure_gripper(each.numpy())[0] for each in samples])
    steps = np.diff(p_C, axis=1)
    frames = np.array(SPLICE_FRAMES)
    before = steps[:, None, frames - 2]
    after = steps[None, :, frames]
    move = p_C[None, :, frames] - p_C[:, None, frames - 1]
    length_m = np.linalg.norm(move - 0.5 * (before + after), axis=-1)
    usual_m = 0.5 * (np.linalg.norm(before, axis=-1) + np.linalg.norm(after, axis=-1))
    off_m = np.abs(length_m - rng.uniform(*SPLICE_M))
    off_m[(np.linalg.norm(move, axis=-1) - usual_m < SPLICE_M[0]) | (length_m > SPLICE_M[1])] = np.inf
    a, b, at = np.unravel_index(np.argmin(off_m), off_m.shape)
    if not np.isfinite(off_m[a, b, at]):
        raise InputError(f"no change between the {len(samples)} samples makes the gripper jump")
    splice = Splice(frame=int(frames[at]), faded=faded, length_m=float(length_m[a, b, at]))
    return splice, samples[a], samples[b]


def paint_splice(
    model: Generator, first: NDArray[np.uint8], one: torch.Tensor, other: torch.Tensor, splice: Splice
) -> NDArray[np.uint8]:
    """Return the video of pose numbers (T, POSE) of one sample, and from the splice on of the other."""
    faded = splice.faded_frames
    video: NDArray[np.uint8] = model.paint(first, torch.cat([one[: faded.stop], other[faded.stop :]]))
    second = model.paint(first, torch.cat([other[:1], other[faded]]))[1:]
    share = (np.arange(1, splice.faded + 1) / (splice.faded + 1))[:, None, None, None]
    video[faded] = np.round((1.0 - share) * video[faded] + share * second)
    return video


def paint_orders(count: int, dynamics: Sequence[str], *, is_spliced: bool = False) -> list[PaintOrder]:
    """Return the clips of `count` first frames, the tasks in turn, each continued by each of the dynamics.

    Half of the spliced ones are hard cuts, half are cross-faded.
    """
    specs = load_suite(3).specs("test", -(-count // len(TASKS)), tasks=TASKS, offset=FIRST_SEED)
    in_turn = sorted(specs, key=lambda spec: spec.seed)[:count]
    # shifted by one after each turn of the tasks
    fades = [FADES[(k + k // len(FADES)) % len(FADES)] if is_spliced else None for k in range(count)]
    pairs = list(zip(in_turn, fades, strict=True))
    return [PaintOrder(spec=spec, dynamics=name, faded=faded) for spec, faded in pairs for name in dynamics]


def paint_clips(weights: Path, orders: Sequence[PaintOrder], out: Path, jobs: int, observer: Observer) -> None:
    """Paint the clips that a folder does not hold yet, and write its manifest.

    Raises:
        SetupError: weights are missing, or a worker died.
    """
    out.mkdir(parents=True, exist_ok=True)
    names = {order.dynamics for order in orders}
    # missing files are reported by the generator
    files = {name: [weights / f"{own}.safetensors" for own in ("autoencoder", name)] for name in names}
    code = {name: fingerprint(files=[path for path in own if path.is_file()]) for name, own in files.items()}
    MeasurementStore(out / TRUTH, PaintedClip).complete(
        orders,
        lambda order: f"{code[order.dynamics]}-{order.id}",
        LocalExecutor(jobs=jobs),
        partial(Painter, partial(Generator, weights), out),
        observer,
        lambda order: order.id,
    )
    write_lines(out / NAME, [clip.manifest_row() for clip in read_painted(out)])


def read_painted(out: Path) -> list[PaintedClip]:
    """Read the numbers of the clips in a folder; of a clip that was painted again, the last ones."""
    clips = read_lines(out / TRUTH, TypeAdapter(PaintedClip).validate_python)
    return list({clip.id: clip for clip in clips}.values())


def find_jumps(clip: PaintedClip) -> list[slice]:
    """Return the jumps of the exact path by the rule of `find_teleports`."""
    every = np.ones(len(clip.p_C), dtype=np.bool_)
    t_s = FRAME_PERIOD_S * np.arange(len(clip.p_C), dtype=np.float64)
    exact = np.zeros((len(clip.p_C), 3, 3))
    return segments(find_teleports(clip.p_C, exact, every, ~every, t_s).score >= 1.0)


def find_odd_steps(clip: PaintedClip) -> list[slice]:
    """Return the steps of the exact path that lie off the steps before and after; each by the frames that end them.

    A jump bends the neighbours' deviations as well, by half, so that consecutive frames are one jump.
    """
    step = np.diff(clip.p_C, axis=0)
    off_m = np.zeros(len(clip.p_C))
    off_m[2:-1] = np.linalg.norm(step[1:-1] - 0.5 * (step[:-2] + step[2:]), axis=1)
    return segments(off_m > ODD_STEP_M)


def find_wrong_sizes(clip: PaintedClip) -> list[slice]:
    """Return the runs of frames with a gripper that is too long or too short."""
    runs = segments(np.abs(clip.size - 1.0) > SIZE_ERROR)
    return [run for run in runs if run.stop - run.start >= SIZE_FRAMES]


def find_wrong_gaps(clip: PaintedClip) -> list[slice]:
    """Return the frames whose exact gap is out of range, or flutters, by the rule of `find_finger_faults`."""
    return segments(find_finger_faults(clip.finger_width_m).score >= 1.0)


def find_splice(clip: PaintedClip, *, is_faded: bool) -> list[slice]:
    """Return the frames of a spliced jump that is cross-faded, or cut."""
    return [clip.splice.frames] if clip.splice is not None and bool(clip.splice.faded) is is_faded else []


FAULTS: Mapping[str, tuple[AnomalyKind, Callable[[PaintedClip], list[slice]]]] = {
    "jump by the detector's rule": (AnomalyKind.TELEPORT, find_jumps),
    f"step {1000 * ODD_STEP_M:.0f} mm off its neighbours": (AnomalyKind.TELEPORT, find_odd_steps),
    "splice, cut": (AnomalyKind.TELEPORT, partial(find_splice, is_faded=False)),
    "splice, cross-faded": (AnomalyKind.TELEPORT, partial(find_splice, is_faded=True)),
    f"gripper {100 * SIZE_ERROR:.0f} % too long or short": (AnomalyKind.DEFORMATION, find_wrong_sizes),
    "impossible gap": (AnomalyKind.FINGERS, find_wrong_gaps),
}
"""Faults by the exact numbers, and the kind of anomaly that should be reported of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultComparison:
    """Faults of one sort in one clip, by its numbers and as reported."""

    clip: PaintedClip
    true: tuple[slice, ...]
    """Frames of each fault by the numbers."""
    reported: tuple[slice, ...]
    """Frames of each reported one."""
    is_open: bool
    """True if score leaves it open whether there is one."""

    @property
    def missed(self) -> list[slice]:
        """Faults near which none is reported."""
        return [fault for fault in self.true if not _any_near(fault, self.reported)]

    @property
    def false(self) -> list[slice]:
        """Reported faults near which there is none."""
        return [fault for fault in self.reported if not _any_near(fault, self.true)]


def _any_near(fault: slice, others: Iterable[slice]) -> bool:
    return any(fault.start < o.stop + TOLERANCE and o.start < fault.stop + TOLERANCE for o in others)


def compare_faults(fault: str, pairs: Iterable[tuple[PaintedClip, SampleRow]]) -> list[FaultComparison]:
    """Compare the clips' faults of a sort (`FAULTS`) with their rows."""
    kind, find = FAULTS[fault]
    return [
        FaultComparison(
            clip=clip,
            true=tuple(find(clip)),
            reported=tuple(slice(a.frame_start, a.frame_end + 1) for a in row.anomalies if a.kind is kind),
            is_open=kind.value in (row.anomalies_open or ()),
        )
        for clip, row in pairs
    ]


def painted_report(rows: Mapping[str, SampleRow], clips: Sequence[PaintedClip], results: Path) -> Iterator[str]:
    """Yield the lines of the comparison of score's rows, in its output folder, with the numbers of the clips."""
    pairs = [(clip, rows[clip.id]) for clip in clips if clip.id in rows and rows[clip.id].metrics.anomalies is not None]
    yield f"{len(pairs)} of {len(clips)} clips have a row whose anomalies were looked for."
    groups = {
        name: [pair for pair in pairs if pair[0].dynamics == name] for name in sorted({c.dynamics for c in clips})
    }
    if len(groups) > 1:
        groups["all"] = pairs
    cells = [
        [fault, name, *counts]
        for fault in FAULTS
        for name, own in groups.items()
        for counts in _fault_cells(compare_faults(fault, own))
    ]
    yield ""
    yield from table(_FAULT_HEAD, cells)
    yield ""
    yield from table(_ERROR_HEAD, [[name, str(len(own)), *_error_cells(own, results)] for name, own in groups.items()])
    yield ""
    for fault in FAULTS:
        compared = compare_faults(fault, pairs)
        for word in ("missed", "false"):
            texts = [f"{c.clip.id}:{f.start}" for c in compared for f in getattr(c, word)]
            if texts:
                yield f"{fault}, {word}: {' '.join(texts)}"


def _fault_cells(compared: Sequence[FaultComparison]) -> Iterator[list[str]]:
    """Yield the cells of the table that count faults, and those that count clips."""
    true = sum(len(c.true) for c in compared)
    reported = sum(len(c.reported) for c in compared)
    false = sum(len(c.false) for c in compared)
    missed = sum(len(c.missed) for c in compared)
    shares = [_share(reported - false, reported), _share(true - missed, true)]
    yield ["faults", str(true), str(reported), *shares, ""]
    true = sum(bool(c.true) for c in compared)
    reported = sum(bool(c.reported) for c in compared)
    both = sum(bool(c.true and c.reported) for c in compared)
    open_ = sum(c.is_open for c in compared)
    yield ["clips", str(true), str(reported), _share(both, reported), _share(both, true), str(open_)]


def _share(hits: int, n: int) -> str:
    low, high = wilson(hits, n)
    return f"{hits}/{n} [{100 * low:.0f}, {100 * high:.0f}] %" if n else "-"


def _error_cells(pairs: Sequence[tuple[PaintedClip, SampleRow]], results: Path) -> list[str]:
    """Return the cells of the table of errors; the first frame, which is not painted, does not count."""
    errors_m = [np.empty(0)]
    for clip, row in pairs:
        path = artifact_path(results, "tracks", row.id)
        if path.is_file():
            track = read_track(path).track
            p_C = transform_points(track.X_CH, [[0.0, 0.0, HAND_TO_TCP_M]])[:, 0]
            errors_m.append(np.where(track.tracked, np.linalg.norm(p_C - clip.p_C, axis=1), np.nan)[1:])
    error_mm = 1000.0 * np.concatenate(errors_m)
    tracked = error_mm[np.isfinite(error_mm)]
    if not len(tracked):
        return ["-"] * 5
    lengths = np.concatenate([np.abs(clip.size[1:] - 1.0) for clip, _ in pairs])
    sizes = [abs(row.hand_size_error) for _, row in pairs if row.hand_size_error is not None]
    return [
        f"{100 * len(tracked) / len(error_mm):.1f} %",
        f"{np.median(tracked):.1f} mm",
        f"{np.percentile(tracked, 95):.1f} mm",
        f"{100 * np.percentile(lengths, 95):.1f} %",
        f"{100 * np.percentile(sizes, 95):.1f} % ({len(sizes)} clips)" if sizes else "-",
    ]
