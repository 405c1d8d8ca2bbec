"""What a GPU changes: networks, training, images of the simulator and whole runs, with it and without it in turn."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks import markdown
from benchmarks.process import run_program, spread
from benchmarks.record import BenchmarkRecord, machine_text
from benchmarks.throughput import NO_GPU, Job, Setting, run_cost
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.environment.native import RENDER_VARIABLE, has_nvidia_vulkan
from kinebench_drake.errors import KinebenchError, UsageError
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.view import CLOSE_MARGIN, CLOSE_SIZE, WIDE_SIZE, Crop
from kinebench_drake.io.container import read_container
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.video import WHOLE
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.models.perception.network import STRIDE, load_network
from training.loop import Batch, Schedule, optimise
from training.train import forward, losses

PROCESSES = (1, 8)
"""Numbers of worker processes of `score`."""
TASKS = ("StackCube-v1", "PickFruits-v1", "OpenDrawer-v1", "OpenFaucet-v1")
"""Tasks of the episodes; the first one's scene and images are timed by themselves."""
STEPS = 12
BATCH_SIZE = 24
"""Steps of a training that are timed, and crops of a step."""
_WARM_UP = 2


class Device(Enum):
    """Where networks and images are computed."""

    CPU = "CPU"
    GPU = "GPU"

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables of a process that computes there."""
        return {} if self is Device.GPU else {**NO_GPU, RENDER_VARIABLE: "cpu"}

    @property
    def torch_name(self) -> str:
        """Name of the device in torch."""
        return "cuda" if self is Device.GPU else "cpu"


Costs = Mapping[str, Mapping[Device, Sequence[float]]]
"""Costs by name with unit, and device, one a turn."""


def measure(video: Path, work: Path, *, videos: int, turns: int, log: Callable[[str], None]) -> Costs:
    """Measure everything with and without the GPU, in `turns` turns.

    Runs are of `videos` copies of `video`, whose frames the networks see, in the empty folder `work`.

    Raises:
        UsageError: there is no GPU, or there are not more videos than processes.
        KinebenchError: a run failed.
    """
    if not torch.cuda.is_available() or not has_nvidia_vulkan():
        raise UsageError("torch and Vulkan find no NVIDIA GPU together; `kinebench-drake doctor` lists what they find")
    if videos <= max(PROCESSES):
        raise UsageError(f"{videos} videos are too few, expected more than {max(PROCESSES)}")
    frames = read_container(video, WHOLE).frames
    link_copies(video, [work / "videos" / f"copy-{k:04d}.mp4" for k in range(videos)])
    costs: dict[str, dict[Device, list[float]]] = {}
    for turn in range(turns):
        for device in Device:
            log(f"turn {turn + 1} of {turns}: {device.value}")
            for name, cost in _turn(device, frames, work):
                log(f"  {name}: {cost:.3g}")
                costs.setdefault(name, {}).setdefault(device, []).append(cost)
    return costs


def link_copies(video: Path, paths: Sequence[Path]) -> None:
    """Copy one file to the first path and hard-link the others to it."""
    first, *others = paths
    first.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(video, first)
    for path in others:
        os.link(first, path)


def _turn(device: Device, frames: Frames, work: Path) -> Iterator[tuple[str, float]]:
    yield from _estimates(device, frames)
    yield f"a step of the training, {BATCH_SIZE} crops of {CLOSE_SIZE} px, ms", 1e3 * _training_step_s(device)
    yield from _simulation(device, work)
    for processes in PROCESSES:
        setting = Setting(job=Job.SCORE, processes=processes)
        cost = run_cost(setting, work / "videos", work / "out", device.environment)
        yield f"{setting}, s a video", cost.sample_s
    yield "suite run, 1 process, s an episode", _episode_s(device, work)


def _estimates(device: Device, frames: Frames) -> Iterator[tuple[str, float]]:
    """Yield the times of a crop through the network, transfers included; what a process does first is left out."""
    camera = benchmark_camera()
    estimator = NetworkEstimator(load_network(), device.torch_name)
    ahead = make_pose(np.eye(3), [0.0, 0.0, 1.0])
    crops = {WIDE_SIZE: Crop.of_frame(camera), CLOSE_SIZE: Crop.of_gripper(ahead, CLOSE_MARGIN, CLOSE_SIZE)}
    for size, crop in crops.items():
        seconds = []
        for _ in range(2 * _WARM_UP + 1):
            start = time.perf_counter()
            count = len(list(estimator.estimate(frames, camera, dict.fromkeys(range(len(frames)), crop))))
            seconds.append((time.perf_counter() - start) / count)
        yield f"a crop of {size} px through the network, ms", 1e3 * float(np.median(seconds[_WARM_UP:]))


def _training_step_s(device: Device) -> float:
    """Return the median time of a step on crops that are ready in memory [s]."""
    chance = torch.Generator().manual_seed(0)
    cells = (BATCH_SIZE, CLOSE_SIZE // STRIDE, CLOSE_SIZE // STRIDE)
    batch: Batch = {
        "image": torch.randint(256, (BATCH_SIZE, 3, CLOSE_SIZE, CLOSE_SIZE), dtype=torch.uint8, generator=chance),
        "part": torch.randint(len(RobotPart), cells, generator=chance),
        "coordinates": torch.randn(cells[0], 3, *cells[1:], generator=chance),
        "log_depth": torch.randn(cells, generator=chance),
    }
    starts = []

    def batches(first: int) -> Iterator[Batch]:
        while True:
            starts.append(time.perf_counter())
            yield batch

    network = load_network().to(device.torch_name).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    schedule = Schedule(steps=_WARM_UP + STEPS, learning_rate=1e-5, batch_size=BATCH_SIZE)
    with TemporaryDirectory() as folder:
        optimise(
            network,
            batches=batches,
            forward=forward,
            losses=losses,
            schedule=schedule,
            identity={},
            folder=Path(folder),
            report=lambda line: None,
        )
    return float(np.median(np.diff(starts)[_WARM_UP:]))


def _simulation(device: Device, work: Path) -> Iterator[tuple[str, float]]:
    """Yield the figures of the benchmark of the simulation, in a process of its own: it chooses the driver once."""
    results = work / f"simulation {device.value}"
    command = [sys.executable, "-m", "benchmarks", "simulation", "--tasks", TASKS[0], "--results", str(results)]
    environment = {**os.environ, **device.environment}
    run = subprocess.run(command, env=environment, capture_output=True, text=True)
    record = BenchmarkRecord.read("simulation", results)
    if run.returncode or record is None:
        raise KinebenchError(f"`{' '.join(command[1:])}` ended with status {run.returncode}: {run.stderr.strip()}")
    yield "an image of the simulator, 384x384, ms", record.figures["image, ms"]
    yield "a demonstration of 49 frames, s", record.figures["demonstration, s"]


def _episode_s(device: Device, work: Path) -> float:
    arguments = ["suite", "run", "--suite", "0", "--tasks", ",".join(TASKS), "--episodes", "1", "--pixels-only"]
    options = ["--world-model", "oracle", "--out", str(work / "episodes"), "--overwrite"]
    finished_s = run_program([*arguments, *options], environment=device.environment).finished_s
    return (finished_s[-1] - finished_s[0]) / (len(finished_s) - 1)


def figures(costs: Costs) -> dict[str, float]:
    """Return the median of each cost on each device."""
    return {
        f"{device.value}: {name}": float(np.median(values))
        for name, by_device in costs.items()
        for device, values in by_device.items()
    }


def _three_digits(values: Array) -> str:
    return spread(values, int(np.clip(2.0 - np.floor(np.log10(np.median(values))), 0.0, 3.0)))


def section(costs: Costs) -> str:
    """Return the section of the document."""
    pairs = {name: [np.array(by_device[device]) for device in Device] for name, by_device in costs.items()}
    rows = [(name, _three_digits(cpu), _three_digits(gpu), spread(cpu / gpu, 1)) for name, (cpu, gpu) in pairs.items()]
    turns = {len(cpu) for cpu, _ in pairs.values()}.pop()
    return markdown.section(
        "GPU",
        f"`python -m benchmarks gpu` on {machine_text()} with {torch.cuda.get_device_name()}: wall times, median "
        f"(minimum to maximum) of {turns} turns. `score` and `suite run` (oracle, pixels only): time from one finished "
        "sample to the next. `score` runs on copies of one video: its times compare the devices and are not "
        "those of usual videos. Fits, kinematics and physics run on the CPU in both.",
        markdown.table(("what", "CPU", "GPU", "times as fast"), rows),
    )
