"""The perception network prepared for inference: fewer passes over memory, less precision where that is fast."""

from copy import deepcopy
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.utils import fuse_conv_bn_eval

from kinebench_drake.models.perception.network import GripperNetwork


def fold_batch_normalisation(network: GripperNetwork) -> GripperNetwork:
    """Return a copy for inference with each batch normalisation folded into the convolution before it."""
    network = deepcopy(network).eval()
    for module in list(network.modules()):
        for (before, convolution), (after, normalisation) in pairwise(list(module.named_children())):
            if isinstance(convolution, nn.Conv2d) and isinstance(normalisation, nn.BatchNorm2d):
                setattr(module, before, fuse_conv_bn_eval(convolution, normalisation))
                setattr(module, after, nn.Identity())
    return network


def reduce_precision(network: GripperNetwork) -> GripperNetwork:
    """Return a copy whose layers compute in bfloat16, except the last one, whose outputs are coordinates."""
    network = deepcopy(network)
    for module in (network.encoder, network.squeeze, network.decoder):
        module.to(torch.bfloat16)
    return network


class _ClampedConvolution(nn.Module):
    """Convolution of oneDNN that clamps its output on the way to memory; for inference."""

    def __init__(self, convolution: nn.Conv2d, activation: nn.ReLU | nn.ReLU6) -> None:
        super().__init__()
        shape = (convolution.padding, convolution.stride, convolution.dilation)
        self._shape = (*(list(pair) for pair in shape), convolution.groups)
        clamp = ("hardtanh", [0.0, 6.0], "") if isinstance(activation, nn.ReLU6) else ("relu", [], "")
        self._clamp: tuple[str, list[float], str] = clamp
        self._weight, self._bias = convolution.weight.detach(), convolution.bias
        self._reordered: dict[torch.Size, Tensor] = {}

    def forward(self, x: Tensor) -> Tensor:
        size = x.shape[-2:]
        if size not in self._reordered:  # oneDNN takes the order by the size, and any other one costs time in each call
            reordered = torch.ops.mkldnn._reorder_convolution_weight(self._weight, *self._shape, list(x.shape))
            self._reordered[size] = reordered
        y: Tensor = torch.ops.mkldnn._convolution_pointwise(
            x, self._reordered[size], self._bias, *self._shape, *self._clamp
        )
        return y


def fuse_activations(network: GripperNetwork) -> GripperNetwork:
    """Return a copy for inference on the CPU whose convolutions clamp their outputs themselves, where oneDNN can.

    Args:
        network: network without batch normalisation (`fold_batch_normalisation`).
    """
    network = deepcopy(network)
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return network
    for module in list(network.modules()):
        children = list(module.named_children())
        for (name, convolution), (_, between), (last, activation) in zip(
            children, children[1:], children[2:], strict=False
        ):
            if (
                isinstance(convolution, nn.Conv2d)
                and isinstance(between, nn.Identity)
                and isinstance(activation, nn.ReLU | nn.ReLU6)
            ):
                setattr(module, name, _ClampedConvolution(convolution, activation))
                setattr(module, last, nn.Identity())
    return network


def supports_bfloat16(device: torch.device) -> bool:
    """Return whether bfloat16 is fast: always on a GPU, on a CPU only with AVX-512 BF16 instructions."""
    return device.type == "cuda" or bool(torch.cpu._is_avx512_bf16_supported())
