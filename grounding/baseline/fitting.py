"""Fit of the baseline to demonstrations."""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Subset

from kinebench_drake.grounding.baseline.network import FINGER_SCALE_M, POSITION_SCALE_M, PoseNetwork, PoseOutput
from kinebench_drake.grounding.baseline.windows import Windows, decode, load_demonstrations
from kinebench_drake.grounding.training.loop import LossTerms, Schedule, optimise, pick_device, save_weights

WEIGHTS = "baseline.safetensors"
"""Name of the weights file in the output folder."""
SCHEDULE = Schedule(steps=2400, learning_rate=1e-3, batch_size=8, checkpoint_every=200)
"""Schedule of the comparison in the README, on 400 clips of ten tasks."""
_ROTATION_WEIGHT = 2.0  # 1 cm weighs as much as 3 degrees ...
_FINGER_WEIGHT = 0.5  # ... or 8 mm of the gap
_ROUND_M, _ROUND_RAD = 1e-3, 5e-3  # where the losses change from quadratic to linear


@dataclass(frozen=True, slots=True, kw_only=True)
class BaselineConfig:
    """Inputs and settings of a training."""

    data: Path
    """Folder of demonstrations."""
    out: Path
    """Folder for decoded frames, checkpoints and the weights."""
    schedule: Schedule = SCHEDULE
    """Schedule; its examples are windows of frames."""
    size: int = 224
    """Width and height of the frames [px]."""
    workers: int = 1
    """Processes that prepare batches."""


def _rounded(square: Tensor, radius: float) -> Tensor:
    """Return the root of `square`, smoothed near zero so that its gradient is finite (Charbonnier loss)."""
    return torch.sqrt(square + radius**2) - radius


def losses(output: PoseOutput, batch: dict[str, Tensor]) -> LossTerms:
    """Return distances of position, rotation and gap: linear, so that single bad frames do not dominate.

    The distance of rotations is the chordal distance / sqrt(2), for small angles the angle [rad] (Hartley et al., IJCV
    2013, section 4.2).
    """
    position = _rounded((output.position - batch["position"]).square().sum(dim=-1), _ROUND_M)
    chord = (output.rotation - batch["rotation"]).square().sum(dim=(-1, -2)) / 2.0
    rotation = _rounded(chord, _ROUND_RAD)
    finger = _rounded((output.finger_width - batch["finger_width"]).square(), _ROUND_M)
    total = position.mean() / POSITION_SCALE_M + _ROTATION_WEIGHT * rotation.mean()
    return LossTerms(
        total=total + _FINGER_WEIGHT * finger.mean() / FINGER_SCALE_M,
        reported={
            "position_mm": 1e3 * position.mean(),
            "rotation_deg": torch.rad2deg(rotation.mean()),
            "finger_mm": 1e3 * finger.mean(),
        },
    )


def train(config: BaselineConfig, report: Callable[[str], None]) -> Path:
    """Train, or resume from the last checkpoint in `config.out`; return the path of the weights.

    Args:
        config: inputs and settings.
        report: called with lines of text on the progress.

    Raises:
        UsageError: the data cannot be used, or `config.out` holds a training with other settings.
    """
    schedule, demonstrations = config.schedule, load_demonstrations(config.data)
    clips = demonstrations.clips
    report(f"{len(clips)} clips of {len(demonstrations.tasks)} tasks")
    frames = decode(clips, config.out / "frames", config.size, report)
    windows = Windows(clips, frames, schedule.seed, schedule.steps * schedule.batch_size)

    def batches(start: int) -> Iterable[dict[str, Tensor]]:
        rest = Subset(windows, range(start * schedule.batch_size, len(windows)))
        return DataLoader(rest, batch_size=schedule.batch_size, num_workers=config.workers, drop_last=True)

    torch.manual_seed(schedule.seed)
    network = PoseNetwork()
    network.encoder.load_imagenet()
    network.to(pick_device()).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = optimise(
        network,
        batches=batches,
        forward=lambda model, batch: model(batch["image"].float() / 255.0),
        losses=losses,
        schedule=schedule,
        identity={**schedule.identity(), "size": config.size, "clips": len(clips), "tasks": list(demonstrations.tasks)},
        folder=config.out,
        report=report,
    )
    about = {
        "tasks": json.dumps(demonstrations.tasks),
        "size": str(config.size),
        "camera": json.dumps(demonstrations.camera.to_json()),
    }
    save_weights(average, config.out / WEIGHTS, about)
    return config.out / WEIGHTS
