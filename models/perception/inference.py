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


class _Convolution(nn.Module):
    """Convolution of oneDNN that clamps its output on the way to memory, where an activation follows; for inference."""

    def __init__(self, convolution: nn.Conv2d, activation: nn.Module) -> None:
        super().__init__()
        shape = (convolution.padding, convolution.stride, convolution.dilation)
        self._shape = (*(list(pair) for pair in shape), convolution.groups)
        clamps = {nn.ReLU: ("relu", [], ""), nn.ReLU6: ("hardtanh", [0.0, 6.0], ""), nn.Identity: ("none", [], "")}
        self._clamp = clamps[type(activation)]
        self.weight, self.bias = convolution.weight, convolution.bias
        self._reordered: dict[torch.Size, Tensor] = {}

    def forward(self, x: Tensor) -> Tensor:
        size = x.shape[-2:]
        if size not in self._reordered:  # oneDNN takes the order by the size, and any other one costs time in each call
            reorder = torch.ops.mkldnn._reorder_convolution_weight
            self._reordered[size] = reorder(self.weight.detach(), *self._shape, list(x.shape))
        y: Tensor = torch.ops.mkldnn._convolution_pointwise(
            x, self._reordered[size], self.bias, *self._shape, *self._clamp
        )
        return y


def use_onednn(network: GripperNetwork) -> GripperNetwork:
    """Return a copy for inference on the CPU whose convolutions are oneDNN's, where it is available.

    Weights are in its order, and outputs are clamped where they are computed.

    Args:
        network: network without batch normalisation (`fold_batch_normalisation`).
    """
    network = deepcopy(network)
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return network
    for module in list(network.modules()):
        children = [*module.named_children(), *2 * [("", nn.Identity())]]
        for (name, convolution), (_, between), (last, after) in zip(children, children[1:], children[2:], strict=False):
            if isinstance(convolution, nn.Conv2d):
                clamps = isinstance(between, nn.Identity) and isinstance(after, nn.ReLU | nn.ReLU6)
                setattr(module, name, _Convolution(convolution, after if clamps else nn.Identity()))
                if clamps:
                    setattr(module, last, nn.Identity())
    return network


def supports_bfloat16(device: torch.device) -> bool:
    """Return whether bfloat16 is fast: always on a GPU, on a CPU only with AVX-512 BF16 instructions."""
    return device.type == "cuda" or bool(torch.cpu._is_avx512_bf16_supported())
