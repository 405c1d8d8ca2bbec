"""Perception network: EfficientNet-Lite0 encoder and U-Net decoder with dense outputs for gripper and arm.

For a square crop around the gripper it predicts, for every second pixel, the robot part, the CAD coordinates of the
visible point, its depth, and the uncertainty of the latter two. The encoder is EfficientNet-Lite0 (Tan and Le, ICML
2019; the Lite variant has no squeeze-and-excitation and uses ReLU6), the decoder follows U-Net (Ronneberger et al.,
MICCAI 2015); dense CAD coordinates follow NOCS (Wang et al., CVPR 2019), here metric in the frame of the hand.
"""

from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import fuse_conv_bn_eval

from kinebench_drake.errors import SetupError
from kinebench_drake.models.panda.description import GripperKind, RobotPart

WEIGHTS = Path(__file__).with_name("gripper.safetensors")
"""Shipped weights, in half precision."""
ROBOTIQ_WEIGHTS = Path(__file__).with_name("robotiq.safetensors")
"""Those for the Robotiq 2F-85."""
ARM_WEIGHTS = Path(__file__).with_name("arm.safetensors")
"""Those for the arm alone, whatever gripper it carries."""
WEIGHTS_OF = {
    GripperKind.FRANKA: WEIGHTS,
    GripperKind.ROBOTIQ_2F85: ROBOTIQ_WEIGHTS,
    GripperKind.NONE: ARM_WEIGHTS,
}
"""Weights by the gripper of the robot."""
PARTS = len(RobotPart)
STRIDE = 2
"""Input pixels per output pixel."""
COORDINATE_SCALE_M = 0.1
"""Unit of the network's CAD coordinates [m]."""
DEPTH_CENTRE = 0.31
"""Offset of the log depth log(z * size / focal / DEPTH_CENTRE) for a crop `size` wide: typical values are near 0."""

# Repeats, kernel, stride of the first, expansion, channels out of each stage (Tan and Le 2019, table 1).
_STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
_SKIPS = {0: 16, 2: 24, 4: 40, 10: 112}  # last block before each stride -> its channels
_DECODER = (128, 96, 64, 48)
_FIX = "reinstall kinebench-drake, which contains them, or train new ones with `python -m training train`"


@dataclass(frozen=True, slots=True)
class DenseOutput:
    """Output for a batch of B crops, on a grid of h x w = size / STRIDE."""

    part_logits: Tensor
    """(B, PARTS, h, w) logits of the parts."""
    coordinates: Tensor
    """(B, 2, 3, h, w) CAD point in units of COORDINATE_SCALE_M: for cells of the gripper (first; in the hand frame with
    closed fingers) and for cells of an arm link (second; in the frame of the link)."""
    coordinate_log_scale: Tensor
    """(B, 2, h, w) log of the Laplace scale of the coordinates, in the same unit."""
    log_depth: Tensor
    """(B, h, w) log depth log(z * size / focal / DEPTH_CENTRE)."""
    depth_log_scale: Tensor
    """(B, h, w) log of the Laplace scale of log_depth."""


def _same_pad(kernel: int, stride: int) -> nn.ZeroPad2d:
    """Return TensorFlow's padding before a strided convolution: the odd pixel is added right and below."""
    total = kernel - stride if stride > 1 else kernel - 1
    return nn.ZeroPad2d((total // 2, total - total // 2) * 2)


class _Block(nn.Module):
    """Inverted-residual block; names match the published weights."""

    def __init__(self, cin: int, cout: int, kernel: int, stride: int, expand: int) -> None:
        super().__init__()
        mid = cin * expand
        self._residual = stride == 1 and cin == cout
        self._expands = expand != 1
        if self._expands:
            self._expand_conv = nn.Conv2d(cin, mid, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(mid, eps=1e-3, momentum=0.01)
            self._relu0 = nn.ReLU6()
        padding = kernel // 2 if stride == 1 else 0
        self._pad = nn.Identity() if stride == 1 else _same_pad(kernel, stride)
        self._depthwise_conv = nn.Conv2d(mid, mid, kernel, stride, padding, groups=mid, bias=False)
        self._bn1 = nn.BatchNorm2d(mid, eps=1e-3, momentum=0.01)
        self._relu1 = nn.ReLU6()
        self._project_conv = nn.Conv2d(mid, cout, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(cout, eps=1e-3, momentum=0.01)

    def forward(self, x: Tensor) -> Tensor:
        y = self._relu0(self._bn0(self._expand_conv(x))) if self._expands else x
        y = self._relu1(self._bn1(self._depthwise_conv(self._pad(y))))
        y = self._bn2(self._project_conv(y))
        return torch.add(x, y) if self._residual else y


class _Encoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self._pad = _same_pad(3, 2)
        self._conv_stem = nn.Conv2d(3, 32, 3, 2, bias=False)
        self._bn0 = nn.BatchNorm2d(32, eps=1e-3, momentum=0.01)
        self._relu0 = nn.ReLU6()
        blocks = []
        channels = 32
        for repeats, kernel, stride, expand, cout in _STAGES:
            for i in range(repeats):
                blocks.append(_Block(channels, cout, kernel, stride if i == 0 else 1, expand))
                channels = cout
        self._blocks = nn.ModuleList(blocks)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return features at strides 2, 4, 8, 16, 32."""
        x = self._relu0(self._bn0(self._conv_stem(self._pad(x))))
        features = []
        for i, block in enumerate(self._blocks):
            x = block(x)
            if i in _SKIPS:
                features.append(x)
        return [*features, x]


def _fuse(cin: int, cout: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(cin, cout, 3, padding=1, bias=False),
        nn.BatchNorm2d(cout),
        nn.ReLU(inplace=True),
        nn.Conv2d(cout, cout, 3, padding=1, bias=False),
        nn.BatchNorm2d(cout),
        nn.ReLU(inplace=True),
    )


class GripperNetwork(nn.Module):
    """Network from images (B, 3, S, S) in 0..1, S a multiple of 32, to a `DenseOutput`."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = _Encoder()
        skips = list(_SKIPS.values())[::-1]
        self.squeeze = nn.Conv2d(_STAGES[-1][-1], _DECODER[0], 1)
        channels = (_DECODER[0], *_DECODER[:-1])
        self.decoder = nn.ModuleList(_fuse(c + s, d) for c, s, d in zip(channels, skips, _DECODER, strict=True))
        self.head = nn.Conv2d(_DECODER[-1], PARTS + 2 * 4 + 2, 1)

    def forward(self, images: Tensor) -> DenseOutput:
        """Run the network; log scales are clamped to -5..2."""
        *skips, x = self.encoder((images * 2.0 - 1.0).to(self.squeeze.weight.dtype))
        x = self.squeeze(x)
        for fuse, skip in zip(self.decoder, reversed(skips), strict=True):
            x = functional.interpolate(x, size=skip.shape[-2:], mode="bilinear", align_corners=False)
            x = fuse(torch.cat([x, skip], dim=1))
        parts, coordinates, depth = self.head(x.to(self.head.weight.dtype)).float().split([PARTS, 2 * 4, 2], dim=1)
        coordinates = coordinates.unflatten(1, (2, 4))
        return DenseOutput(
            part_logits=parts,
            coordinates=coordinates[:, :, :3],
            coordinate_log_scale=coordinates[:, :, 3].clamp(-5.0, 2.0),
            log_depth=depth[:, 0],
            depth_log_scale=depth[:, 1].clamp(-5.0, 2.0),
        )


def load_network(path: Path = WEIGHTS) -> GripperNetwork:
    """Load the network with the weights of a safetensors file, in single precision and evaluation mode.

    Raises:
        SetupError: the file is missing or contains weights of another network.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise SetupError(f"{path.name}: no such weights; {_FIX}")
    network = GripperNetwork()
    try:
        state = load_file(path)
        network.load_state_dict({k: v.float() if v.dtype.is_floating_point else v for k, v in state.items()})
    except (SafetensorError, RuntimeError) as error:
        first = str(error).splitlines()[0]
        raise SetupError(f"{path.name}: not weights of this network ({first}); {_FIX}") from None
    return network.eval()


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
        self.weight = convolution.weight
        self.bias = convolution.bias
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
    """Return a copy for the CPU whose convolutions are oneDNN's, with weights in its order, where it is available.

    The network has no batch normalisation (`fold_batch_normalisation`).
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
