"""The network of the baseline: whole frames in, pose of the TCP and gap between the fingers out.

Published inverse-dynamics networks put pooled features of a pretrained encoder, of one frame or of two, through a few
dense layers (UniPi, Du et al., NeurIPS 2023; WoW's ResNet and DINO variants, Chi et al. 2025). This one is given more
to stand for what such networks can do at their best: the encoder learns, too, features of three strides are joined
as in a feature pyramid (Lin et al., CVPR 2017), attention pooling keeps where things are (a spatial softmax with
features; Levine et al., JMLR 2016), and the frame before and the one after are seen. Rotations are six numbers (Zhou
et al., CVPR 2019).

It knows one camera, that of its training, as all of its kind: the pose on the robot's base is learned with it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinebench_drake.models.perception.network import GripperNetwork


def to_six(R: Tensor) -> Tensor:
    """Six numbers (..., 6) of rotation matrices `R` (..., 3, 3): first column, second column."""
    return R[..., :, :2].transpose(-1, -2).flatten(-2)


def from_six(six: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of any six numbers (..., 6), by Gram-Schmidt (their equation 15)."""
    x = functional.normalize(six[..., :3], dim=-1)
    y = six[..., 3:]
    y = functional.normalize(y - (x * y).sum(dim=-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


CONTEXT = 1
"""Frames before and after that are seen with each."""
POSITION_CENTRE_M = (0.5, 0.0, 0.2)
"""A place in front of the robot [m], in the base frame: where outputs are zero ..."""
POSITION_SCALE_M = 0.1
"""... and the network's unit of position [m]."""
FINGER_SCALE_M = 0.04
"""The network's unit of the gap between the fingers [m]; its zero is half open."""

_CHANNELS = (40, 112, 320)  # of the encoder at strides 8, 16, 32
_PYRAMID = (64, 128)  # of the pyramid at strides 8, 16
_HEADS = 16
_WIDTH = 256
_DROPOUT = 0.1
_DOWN = (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)  # the six numbers of a gripper that points straight down
_FROZEN = ("_conv_stem", "_bn0", "_blocks.0", "_blocks.1", "_blocks.2")


@dataclass(frozen=True, slots=True)
class PoseOutput:
    """What the network says of T frames of B windows."""

    position: Tensor
    """(B, T, 3) panda_hand_tcp in the base frame [m]."""
    rotation: Tensor
    """(B, T, 3, 3) rotation of panda_hand_tcp in the base frame."""
    finger_width: Tensor
    """(B, T) gap between the finger pads [m]."""


def _join(cin: int, cout: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(cin, cout, 3, padding=1, bias=False), nn.BatchNorm2d(cout), nn.ReLU(inplace=True))


class _AttentionPool(nn.Module):
    """Per head a softmax over the map, and the mean of features and place under it."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.attention = nn.Conv2d(channels, _HEADS, 1)
        self.size = _HEADS * (channels + 2)

    def forward(self, x: Tensor) -> Tensor:
        """Vectors (N, size) of maps (N, C, h, w)."""
        n, _, h, w = x.shape
        weight = self.attention(x).float().flatten(2).softmax(dim=-1)
        v, u = torch.meshgrid(
            torch.linspace(-1, 1, h, device=x.device), torch.linspace(-1, 1, w, device=x.device), indexing="ij"
        )
        place = torch.stack([u, v]).flatten(1).expand(n, 2, h * w)
        values = torch.cat([x.float().flatten(2), place], dim=1)
        return torch.einsum("nkp,ncp->nkc", weight, values).flatten(1)


class PoseNetwork(nn.Module):
    """Windows of frames (B, T + 2, 3, S, S) in 0..1, S a multiple of 32, to a `PoseOutput` of the T inner frames.

    The encoder's first layers, edges and textures that ImageNet has taught it, stay as they are.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = GripperNetwork().encoder
        self.squeeze = nn.Conv2d(_CHANNELS[2], _PYRAMID[1], 1)
        self.join_16 = _join(_PYRAMID[1] + _CHANNELS[1], _PYRAMID[1])
        self.join_8 = _join(_PYRAMID[1] + _CHANNELS[0], _PYRAMID[0])
        self.pool = _AttentionPool(_PYRAMID[0])
        self.embedding = nn.Sequential(nn.Linear(self.pool.size + _CHANNELS[2], _WIDTH), nn.GELU())
        self.time = nn.Conv1d(_WIDTH, _WIDTH, 2 * CONTEXT + 1)
        last = nn.Linear(_WIDTH, 3 + 6 + 1)
        with torch.no_grad():  # starts near a gripper that points down in the middle of things
            last.weight.mul_(0.1)
            last.bias.copy_(torch.tensor([0.0, 0.0, 0.0, *_DOWN, 0.0]))
        self.head = nn.Sequential(nn.Dropout(_DROPOUT), nn.Linear(_WIDTH, _WIDTH), nn.GELU(), last)
        for name, parameter in self.encoder.named_parameters():
            parameter.requires_grad_(not name.startswith(_FROZEN))

    def train(self, mode: bool = True) -> "PoseNetwork":
        """Switch to training; the statistics of the layers that do not learn stay as they are."""
        super().train(mode)
        for name, module in self.encoder.named_modules():
            if name.startswith(_FROZEN):
                module.eval()
        return self

    def embed(self, images: Tensor) -> Tensor:
        """Vectors (N, D) of frames (N, 3, S, S)."""
        images = images.contiguous(memory_format=torch.channels_last)
        features = self.encoder(images * 2.0 - 1.0)
        f_8, f_16, f_32 = features[-3], features[-2], features[-1]
        x = functional.interpolate(self.squeeze(f_32), size=f_16.shape[-2:], mode="bilinear", align_corners=False)
        x = self.join_16(torch.cat([x, f_16], dim=1))
        x = functional.interpolate(x, size=f_8.shape[-2:], mode="bilinear", align_corners=False)
        x = self.join_8(torch.cat([x, f_8], dim=1))
        embedded: Tensor = self.embedding(torch.cat([self.pool(x), f_32.float().mean(dim=(2, 3))], dim=1))
        return embedded

    def fuse(self, embedded: Tensor) -> PoseOutput:
        """Poses of the T inner frames of embedded windows (B, T + 2, D)."""
        mixed = self.time(embedded.transpose(1, 2)).transpose(1, 2)
        x = embedded[:, CONTEXT:-CONTEXT] + functional.gelu(mixed)
        y = self.head(x).float()
        centre = torch.tensor(POSITION_CENTRE_M, device=y.device)
        return PoseOutput(
            position=centre + POSITION_SCALE_M * y[..., :3],
            rotation=from_six(y[..., 3:9]),
            finger_width=FINGER_SCALE_M * (1.0 + y[..., 9]),
        )

    def forward(self, windows: Tensor) -> PoseOutput:
        """Run the network."""
        b, t = windows.shape[:2]
        return self.fuse(self.embed(windows.flatten(0, 1)).view(b, t, _WIDTH))

    def load_imagenet_encoder(self) -> None:
        """Start the encoder from ImageNet weights, see `GripperNetwork.load_imagenet_encoder`."""
        donor = GripperNetwork()
        donor.load_imagenet_encoder()
        self.encoder.load_state_dict(donor.encoder.state_dict())
