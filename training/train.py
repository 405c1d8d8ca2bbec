"""Training of the gripper network on rendered frames."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader

from kinebench_drake.models.panda.description import ARM, RobotPart
from kinebench_drake.models.perception.network import DenseOutput, GripperNetwork, load_network
from training.crops import GRIPPER_TARGET, WRIST_TARGET, Crops, Shards, Steps
from training.layout import TrainedNetwork
from training.loop import Batch, LossTerms, Schedule, load_imagenet, optimise, pick_device, save_weights

_PIXEL_WEIGHTS = (1.0, 1.0, 5.0, 5.0, *[1.0] * len(ARM))
"""Weight of a pixel in the losses, by `RobotPart`."""
_ARM_WEIGHT = 0.6
"""Weight of the arm's coordinates and depth / weight of the gripper's."""
_FIXED_FROM = 0.3
"""Part of the steps after which batch normalisation is frozen, as the statistics of close and wide crops differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingConfig:
    """Inputs and settings of a training run."""

    data: tuple[Path, ...]
    """Folders of rendered shards."""
    out: Path
    """Folder for checkpoints and the final weights."""
    start: Path | None = None
    """Initial weights; if None, an ImageNet encoder."""
    schedule: Schedule
    """Schedule; its examples are crops."""
    network: TrainedNetwork = TrainedNetwork.GRIPPER
    """Network to train: its weights bear its name; crops of that of the arm alone show the last links."""
    workers: int = 1
    """Processes that prepare batches."""


def losses(output: DenseOutput, batch: Batch) -> LossTerms:
    """Return the cross-entropy of the parts and the Laplace likelihoods of coordinates and depth on robot pixels.

    The negative log-likelihood with a predicted scale follows Kendall and Gal (NeurIPS 2017), with L1 in place of L2.
    The fingers are a fiftieth of the pixels but determine the opening and resolve the half-turn ambiguity, so their
    pixels have a larger weight in every term. In the total the cross-entropy has a larger weight, as it is small
    compared to the likelihoods in nats.
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
    terms = {
        "part": functional.cross_entropy(output.part_logits, part, weight),
        "coordinates": of_gripper + _ARM_WEIGHT * of_arm,
        "depth": depth[0] + _ARM_WEIGHT * depth[1],
    }
    return LossTerms(total=3.0 * terms["part"] + terms["coordinates"] + terms["depth"], reported=terms)


@torch.no_grad()
def likelier_half_turn(output: DenseOutput, batch: Batch) -> Batch:
    """Return a batch with, in each crop, the labels of the gripper after half a turn if the output is nearer to them.

    A gripper that looks the same after half a turn about its axis has no better label, and one that is demanded
    nevertheless teaches the mean of both (Pitteri et al., "On object symmetries and 6D pose estimation from images",
    3DV 2019).
    """
    part = batch["part"]
    turned_part = part.clone()
    turned_part[part == int(RobotPart.LEFT_FINGER)] = int(RobotPart.RIGHT_FINGER)
    turned_part[part == int(RobotPart.RIGHT_FINGER)] = int(RobotPart.LEFT_FINGER)
    gripper = (part > int(RobotPart.BACKGROUND)) & (part < int(ARM[0]))
    half_turn = torch.tensor([-1.0, -1.0, 1.0], device=part.device)[None, :, None, None]
    coordinates = batch["coordinates"]
    turned = torch.where(gripper[:, None], coordinates * half_turn, coordinates)

    def misfit(part: Tensor, coordinates: Tensor) -> Tensor:
        """Return the loss (B,) of the gripper's pixels."""
        error = (output.coordinates[:, 0] - coordinates).abs().sum(dim=1) * torch.exp(
            -output.coordinate_log_scale[:, 0]
        )
        labels = functional.cross_entropy(output.part_logits, part, reduction="none")
        return ((error + labels) * gripper).sum(dim=(1, 2))

    is_turned = misfit(turned_part, turned) < misfit(part, coordinates)
    return batch | {
        "part": torch.where(is_turned[:, None, None], turned_part, part),
        "coordinates": torch.where(is_turned[:, None, None, None], turned, coordinates),
    }


def symmetric_losses(output: DenseOutput, batch: Batch) -> LossTerms:
    """Return the `losses` of a gripper that looks the same after half a turn."""
    return losses(output, likelier_half_turn(output, batch))


def forward(network: nn.Module, batch: Batch) -> DenseOutput:
    """Return the output of the network for the images of a batch."""
    images = (batch["image"].float() / 255.0).contiguous(memory_format=torch.channels_last)
    output: DenseOutput = network(images)
    return output


def train(config: TrainingConfig, report: Callable[[str], None]) -> Path:
    """Train, or resume from the last checkpoint in `config.out`; return the path of the weights.

    Raises:
        UsageError: `config.data` holds no frames, or `config.out` holds another training.
    """
    schedule = replace(config.schedule, fixed_from=_FIXED_FROM)
    torch.manual_seed(schedule.seed)
    if config.start is None:
        network = GripperNetwork()
        load_imagenet(network.encoder)
    else:
        network = load_network(config.start)
    network.to(pick_device()).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    crops = Crops(
        Shards(config.data), schedule.seed, WRIST_TARGET if config.network is TrainedNetwork.ARM else GRIPPER_TARGET
    )

    def batches(start: int) -> Iterable[Batch]:
        steps = Steps(range(start, schedule.steps), schedule.batch_size)
        return DataLoader(crops, batch_sampler=steps, num_workers=config.workers)

    average = optimise(
        network,
        batches=batches,
        forward=forward,
        losses=symmetric_losses if config.network is TrainedNetwork.ROBOTIQ else losses,
        schedule=schedule,
        identity=schedule.identity(),
        folder=config.out,
        report=report,
    )
    weights = config.out / f"{config.network.value}.safetensors"
    save_weights(average, weights)
    return weights
