"""Speed and deviation of the perception network under different runtimes on the CPU, one thread each."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.markdown import table
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.tracking.crop import CLOSE_SIZE, WIDE_SIZE
from kinebench_drake.io.container import read_container
from kinebench_drake.io.video import WHOLE
from kinebench_drake.models.panda.robot import ARM, RobotPart
from kinebench_drake.models.perception.inference import (
    fold_batch_normalisation,
    reduce_precision,
    supports_bfloat16,
    use_onednn,
)
from kinebench_drake.models.perception.network import (
    COORDINATE_SCALE_M,
    WEIGHTS,
    DenseOutput,
    GripperNetwork,
    load_network,
)

REFERENCE = "torch, float32"
"""Runtime that the others are compared with."""
_BATCH = 8
_WARM_UP = 2  # runs that are not timed: the first ones allocate and compile

Estimate: TypeAlias = Callable[[Tensor], DenseOutput]


@dataclass(frozen=True, slots=True, kw_only=True)
class RuntimeCost:
    """Measurements of one runtime at one size of crops."""

    runtime: str
    size: int
    """Side of the crops [px]."""
    ms: float
    """Median time of a crop [ms]."""
    ratio: float
    """Median over turns of its time relative to the reference's in the same turn."""
    labels: float
    """Share of cells with another part than the reference gives them."""
    depth_mm: float
    """95th percentile of the change of depth, at 1 m, in cells of the robot [mm]."""
    points_mm: float
    """95th percentile of the change of CAD points in cells of the robot [mm]."""


class _Outputs(nn.Module):
    """Network whose output is a tuple, as exporters need it."""

    def __init__(self, network: GripperNetwork) -> None:
        super().__init__()
        self._network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        output = self._network(images)
        return tuple(getattr(output, name) for name in DenseOutput.__slots__)


def runtimes(example: Tensor, log: Callable[[str], None]) -> Iterator[tuple[str, Estimate]]:
    """Yield name and function of each runtime that works here.

    Args:
        example: (B, 3, S, S) images for compilers that need them.
        log: receives a line for each runtime that does not work.
    """
    network = fold_batch_normalisation(load_network(WEIGHTS)).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    precisions = {"float32": network}
    if supports_bfloat16(torch.device("cpu")):
        precisions["bfloat16"] = reduce_precision(network)
    for precision, own in precisions.items():
        yield f"torch, {precision}", own
        yield f"torch with layers of oneDNN, {precision}", use_onednn(own)
    for precision, own in precisions.items():
        name = f"torch.compile, {precision}"
        compiled: Estimate = torch.compile(own)
        try:
            compiled(example)
        except RuntimeError as error:  # most often there is no C++ compiler
            log(f"{name}: {str(error).splitlines()[0]}")
        else:
            yield name, compiled
    try:
        name = f"OpenVINO {version('openvino')}"
    except PackageNotFoundError:
        log("OpenVINO is not installed: pip install 'kinebench-drake[bench]'")
        return
    yield from ((f"{name}, {precision}", _openvino(network, precision, example)) for precision in precisions)


def _openvino(network: GripperNetwork, precision: str, example: Tensor) -> Estimate:
    import openvino

    model = openvino.convert_model(_Outputs(network).eval(), example_input=example)
    options = {"INFERENCE_PRECISION_HINT": precision.replace("float", "f"), "INFERENCE_NUM_THREADS": 1}
    request = openvino.Core().compile_model(model, "CPU", options).create_infer_request()

    def estimate(images: Tensor) -> DenseOutput:
        outputs = request.infer([images.contiguous().numpy()])
        return DenseOutput(*(torch.from_numpy(outputs[k].copy()) for k in range(len(outputs))))

    return estimate


@torch.inference_mode()
def measure(video: Path, *, turns: int, log: Callable[[str], None]) -> list[RuntimeCost]:
    """Time all runtimes in turn, on frames of a video.

    Args:
        video: video of the robot.
        turns: timed runs of each runtime.
        log: receives a line for each size.

    Raises:
        InputError: the video cannot be read.
        SetupError: the weights are missing.
    """
    torch.set_num_threads(1)
    frames = torch.from_numpy(read_container(video, WHOLE).frames).permute(0, 3, 1, 2).float() / 255.0
    chosen = frames[:: max(1, len(frames) // _BATCH)][:_BATCH]
    costs = []
    for size in (CLOSE_SIZE, WIDE_SIZE):
        log(f"crops of {size} px")
        images = nn.functional.interpolate(chosen, size=(size, size), mode="area")
        images = images.contiguous(memory_format=torch.channels_last)
        torch.compiler.reset()
        costs += _compare(dict(runtimes(images, log)), images, turns)
    return costs


def _compare(estimates: Mapping[str, Estimate], images: Tensor, turns: int) -> list[RuntimeCost]:
    times: dict[str, list[float]] = {name: [] for name in estimates}
    for _ in range(_WARM_UP + turns):
        for name, estimate in estimates.items():
            start = time.perf_counter()
            estimate(images)
            times[name].append(1e3 * (time.perf_counter() - start) / len(images))
    timed = {name: np.array(values[_WARM_UP:]) for name, values in times.items()}
    reference = estimates[REFERENCE](images)
    return [
        RuntimeCost(
            runtime=name,
            size=images.shape[-1],
            ms=float(np.median(timed[name])),
            ratio=float(np.median(timed[name] / timed[REFERENCE])),
            **deviation(estimate(images), reference),
        )
        for name, estimate in estimates.items()
    ]


def deviation(output: DenseOutput, reference: DenseOutput) -> dict[str, float]:
    """Return `labels`, `depth_mm` and `points_mm` of a `RuntimeCost`; the reference says which cells show the robot."""
    label = reference.part_logits.argmax(dim=1)
    robot = label != int(RobotPart.BACKGROUND)
    moved = (output.coordinates - reference.coordinates).norm(dim=2)
    arm = label >= int(ARM[0])

    def largest(values: Tensor) -> float:
        own: Array = values[robot].numpy()
        return float(np.percentile(own, 95.0)) if own.size else float("nan")

    return {
        "labels": float((output.part_logits.argmax(dim=1) != label).float().mean()),
        "depth_mm": 1e3 * largest((output.log_depth - reference.log_depth).abs()),
        "points_mm": 1e3 * COORDINATE_SCALE_M * largest(torch.where(arm, moved[:, 1], moved[:, 0])),
    }


def figures(costs: Sequence[RuntimeCost]) -> dict[str, float]:
    """Return the time of a crop by runtime and size [ms]."""
    return {f"{cost.runtime}, {cost.size} px, ms a crop": cost.ms for cost in costs}


def section(costs: Sequence[RuntimeCost]) -> str:
    """Return the section of the page, in Markdown."""
    rows = [
        [
            f"{cost.size} px",
            cost.runtime,
            f"{cost.ms:.1f}",
            f"{cost.ratio:.2f}",
            f"{cost.labels:.2%}",
            f"{cost.depth_mm:.2f}",
            f"{cost.points_mm:.2f}",
        ]
        for cost in costs
    ]
    head = ("crop", "runtime", "ms a crop", "relative to torch, float32", "other labels", "depth, mm", "CAD points, mm")
    return "\n".join(
        [
            "## Runtimes of the network on the CPU",
            "",
            f"Written by `python -m benchmarks runtimes`, one thread, batches of {_BATCH} frames of a video, the "
            "runtimes in turn. Deviations from torch with float32: share of cells with another label; 95th percentiles "
            "in cells of the robot, of depth at a distance of 1 m and of points on the CAD model. The program uses "
            "torch with layers of oneDNN, in bfloat16 where the processor multiplies in it (AVX-512 BF16), else in "
            "float32.",
            "",
            *table(head, rows),
            "",
        ]
    )
