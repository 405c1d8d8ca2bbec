"""Training of the gripper network on rendered shards."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader

from kinebench_drake.grounding.training.dataset import Crops, Shards, Steps
from kinebench_drake.grounding.training.loop import Batch, Schedule, Terms, optimise, pick_device, save_weights
from kinebench_drake.models.panda.robot import ARM, RobotPart
from kinebench_drake.models.perception.network import DenseOutput, GripperNetwork
from kinebench_drake.models.perception.weights import load_network

_PIXEL_WEIGHTS = (1.0, 1.0, 5.0, 5.0, *[1.0] * len(ARM))  # by Part
_ARM_WEIGHT = 0.4  # of the arm's coordinates and depth beside the gripper's
_FIXED_FROM = 0.3
"""Of all steps: from there on batch normalisation keeps its statistics, as those of close and wide crops differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingConfig:
    """What a training run depends on; recorded in the model card."""

    data: tuple[Path, ...]
    """Folders of rendered shards."""
    out: Path
    """Folder for checkpoints and the final weights."""
    start: Path | None = None
    """Weights to start from, whose statistics of batch normalisation stay; if None, only the encoder's, of ImageNet."""
    schedule: Schedule
    """Its examples are crops."""
    workers: int = 1
    """Processes that make batches."""


@dataclass(frozen=True, slots=True)
class Losses:
    """The three terms, each a mean (scalar tensors)."""

    part: Tensor
    coordinates: Tensor
    depth: Tensor

    @property
    def total(self) -> Tensor:
        """Their weighted sum: Laplace likelihoods are in nats, the cross-entropy is small and so weighs more."""
        return 3.0 * self.part + self.coordinates + self.depth


def losses(output: DenseOutput, batch: dict[str, Tensor]) -> Losses:
    """Cross-entropy of the parts; Laplace negative log-likelihood of coordinates and depth on the robot's pixels.

    The Laplace likelihood with a predicted scale follows Kendall and Gal (NeurIPS 2017), with L1 in place of L2. The
    fingers are a fiftieth of the pixels but tell opening and reading, so their pixels weigh more in every term.
    """
    part = batch["part"]
    weight = torch.tensor(_PIXEL_WEIGHTS, device=part.device)
    robot = weight[part] * (part != int(RobotPart.BACKGROUND))
    is_arm = part >= int(ARM[0])
    of_kind = torch.stack([robot * ~is_arm, robot * is_arm], dim=1)
    count = of_kind.sum(dim=(0, 2, 3)).clamp(min=1.0)
    error = (output.coordinates - batch["coordinates"][:, None]).abs().sum(dim=2)
    b = output.coordinate_log_scale
    of_gripper, of_arm = ((error * torch.exp(-b) + 3 * b) * of_kind).sum(dim=(0, 2, 3)) / count
    error = (output.log_depth - batch["log_depth"]).abs()
    b = output.depth_log_scale
    depth = ((error * torch.exp(-b) + b)[:, None] * of_kind).sum(dim=(0, 2, 3)) / count
    return Losses(
        functional.cross_entropy(output.part_logits, part, weight),
        of_gripper + _ARM_WEIGHT * of_arm,
        depth[0] + _ARM_WEIGHT * depth[1],
    )


def _forward(network: nn.Module, batch: Batch) -> DenseOutput:
    images = (batch["image"].float() / 255.0).contiguous(memory_format=torch.channels_last)
    output: DenseOutput = network(images)
    return output


def _terms(output: DenseOutput, batch: Batch) -> Terms:
    found = losses(output, batch)
    return Terms(total=found.total, shown={"part": found.part, "coordinates": found.coordinates, "depth": found.depth})


def train(config: TrainingConfig, report: Callable[[str], None]) -> Path:
    """Train, or go on from the last checkpoint in `config.out`; returns the path of the weights.

    `report` is called with lines of text on the way.

    Raises:
        UsageError: `config.data` holds no shards, or `config.out` another training.
    """
    schedule = replace(config.schedule, fixed_from=_FIXED_FROM if config.start is None else 0.0)
    torch.manual_seed(schedule.seed)
    if config.start is None:
        network = GripperNetwork()
        network.load_imagenet_encoder()
    else:
        network = load_network(config.start)
    network.to(pick_device()).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    crops = Crops(Shards(config.data), schedule.seed)

    def batches(start: int) -> Iterable[Batch]:
        steps = Steps(range(start, schedule.steps), schedule.batch_size)
        return DataLoader(crops, batch_sampler=steps, num_workers=config.workers)

    average = optimise(
        network,
        batches=batches,
        forward=_forward,
        losses=_terms,
        schedule=schedule,
        identity=schedule.identity(),
        folder=config.out,
        report=report,
    )
    weights = config.out / "gripper.safetensors"
    save_weights(average, weights)
    return weights
