"""Training of the gripper network on rendered shards."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader

from kinebench_drake.errors import UsageError
from kinebench_drake.grounding.training.dataset import Crops, Shards, Steps
from kinebench_drake.models.panda.part import ARM, Part
from kinebench_drake.models.perception.network import DenseOutput, GripperNetwork
from kinebench_drake.models.perception.weights import load_network

_PIXEL_WEIGHTS = (1.0, 1.0, 5.0, 5.0, *[1.0] * len(ARM))  # by Part
_ARM_WEIGHT = 0.4  # of the arm's coordinates and depth beside the gripper's
_EMA_DECAY = 0.998
_WARM_UP_STEPS = 200
_FIXED_FROM = 0.3  # of all steps: from there on batch normalisation keeps its statistics
_GRADIENT_CLIP = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingConfig:
    """What a training run depends on; recorded in the model card."""

    data: tuple[Path, ...]
    """Folders of rendered shards."""
    out: Path
    """Folder for checkpoints and the final weights."""
    start: Path | None = None
    """Weights to start from; if None, only the encoder's, from ImageNet."""
    seed: int = 0
    steps: int = 4000
    batch_size: int = 32
    learning_rate: float = 1.2e-3
    workers: int = 1
    checkpoint_every: int = 250

    def identity(self) -> dict[str, float]:
        """What a checkpoint must have in common with the run that goes on from it."""
        names = ("seed", "steps", "batch_size", "learning_rate")
        return {name: getattr(self, name) for name in names}


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
    robot = weight[part] * (part != int(Part.BACKGROUND))
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


def pick_device() -> torch.device:
    """The GPU when there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def supports_bfloat16(device: torch.device) -> bool:
    """Whether bfloat16 is fast there: always on a GPU, on a CPU only with AVX-512 BF16 instructions."""
    return device.type == "cuda" or bool(torch.cpu._is_avx512_bf16_supported())


def _rate(step: int, steps: int) -> float:
    """Linear warm-up, then a cosine to zero, as a factor of the learning rate."""
    if step < _WARM_UP_STEPS:
        return (step + 1) / _WARM_UP_STEPS
    progress = torch.tensor((step - _WARM_UP_STEPS) / max(1, steps - _WARM_UP_STEPS))
    return float(0.5 * (1 + torch.cos(torch.pi * progress)))


def _fix_statistics(network: nn.Module) -> None:
    """Let batch normalisation use its running statistics, as it will when the network is used.

    Close and wide crops come in batches of their own, whose statistics differ; running ones are those of both. A
    network that has only met the former errs with the latter.
    """
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eval()


def _update_average(average: nn.Module, network: nn.Module, step: int) -> None:
    """Exponential moving average of weights and statistics, quicker at the start."""
    decay = min(_EMA_DECAY, (step + 1) / (step + 20))
    for kept, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
        if kept.dtype.is_floating_point:
            kept.lerp_(new.to(kept.dtype), 1 - decay)
        else:
            kept.copy_(new)


def save_weights(network: nn.Module, path: Path) -> None:
    """Write the network's weights in half precision as safetensors."""
    state = {k: (v.half() if v.dtype.is_floating_point else v).contiguous() for k, v in network.state_dict().items()}
    partial = path.with_suffix(".tmp")
    save_file(state, partial)
    partial.replace(path)


def train(config: TrainingConfig, report: Callable[[str], None]) -> Path:
    """Train, or go on from the last checkpoint in `config.out`; returns the path of the weights.

    `report` is called with one line of text every 50 steps.

    Raises:
        UsageError: `config.data` holds no shards, or `config.out` another training.
    """
    device = pick_device()
    torch.manual_seed(config.seed)
    network, average = GripperNetwork(), GripperNetwork()
    if config.start is None:
        network.load_imagenet_encoder()
    else:
        network = load_network(config.start)
    average.load_state_dict(network.state_dict())
    network.to(device).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    average.to(device).requires_grad_(False)
    decayed = [p for p in network.parameters() if p.ndim > 1]
    plain = [p for p in network.parameters() if p.ndim <= 1]
    groups = [{"params": decayed, "weight_decay": 0.02}, {"params": plain, "weight_decay": 0.0}]
    optimizer = torch.optim.AdamW(groups, lr=config.learning_rate)
    scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: _rate(step, config.steps))

    config.out.mkdir(parents=True, exist_ok=True)
    checkpoint, start = config.out / "checkpoint.pt", 0
    if checkpoint.is_file():
        state = torch.load(checkpoint, weights_only=True, map_location=device)
        if state["config"] != config.identity():
            raise UsageError(
                f"{config.out.name}: holds a training with {state['config']}, asked for was {config.identity()}; "
                "name another folder, or remove this one"
            )
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        scheduler.load_state_dict(state["scheduler"])
        start = int(state["step"])
        report(f"going on from step {start}")

    crops = Crops(Shards(config.data), config.seed)
    batches = Steps(range(start, config.steps), config.batch_size)
    loader = DataLoader(crops, batch_sampler=batches, num_workers=config.workers)
    began, sums = time.monotonic(), torch.zeros(3)
    for step, batch in enumerate(loader, start):
        if step >= _FIXED_FROM * config.steps:
            _fix_statistics(network)
        batch = {k: v.to(device, non_blocking=True) for k, v in batch.items()}
        images = (batch["image"].float() / 255.0).contiguous(memory_format=torch.channels_last)
        with torch.autocast(device.type, torch.bfloat16, enabled=supports_bfloat16(device)):
            output = network(images)
        terms = losses(output, batch)
        optimizer.zero_grad(set_to_none=True)
        terms.total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), _GRADIENT_CLIP)
        optimizer.step()
        scheduler.step()
        with torch.no_grad():
            _update_average(average, network, step)
        sums += torch.stack([terms.part, terms.coordinates, terms.depth]).detach().cpu()
        if (step + 1) % 50 == 0:
            part, coordinates, depth = (sums / 50).tolist()
            pace = (time.monotonic() - began) / (step + 1 - start)
            terms_text = f"part {part:.4f} coordinates {coordinates:.3f} depth {depth:.3f}"
            report(f"step {step + 1}/{config.steps} {terms_text} {pace:.2f} s/step")
            sums.zero_()
        if (step + 1) % config.checkpoint_every == 0 or step + 1 == config.steps:
            state = {"network": network.state_dict(), "average": average.state_dict(), "step": step + 1}
            state |= {"optimizer": optimizer.state_dict(), "scheduler": scheduler.state_dict()}
            state |= {"config": config.identity()}
            torch.save(state, checkpoint.with_suffix(".tmp"))
            checkpoint.with_suffix(".tmp").replace(checkpoint)
    weights = config.out / "gripper.safetensors"
    save_weights(average, weights)
    return weights
