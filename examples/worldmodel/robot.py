"""Light field of the robot: each rigid part answers the rays that pass it with a colour, an opacity and a depth.

A ray is described by points on it in the frame of the part, so that a part has to be learned once for all its poses
(light field networks: Sitzmann et al. 2021; points on the ray: Wang et al. 2022).

The parts' poses follow from the pose numbers, which are the latent vector of a frame: points of robot and objects as
the camera sees them. Each point has three: u, v (-1..1 across the picture) and nearness, which is 0 at 0.7 m. The last
pose number is the joint of the articulated object [rad or m].
"""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

SIZE = 192
"""Width and height of the model's pictures."""
ROBOT = 16
"""Points of the robot: 10 on the axes of the arm's joints, then hand, both ends of the hand, TCP, both finger tips."""
POINTS = ROBOT + 4
"""And two points on each of two objects."""
POSE = 3 * POINTS + 1
"""Pose numbers of a frame."""
FIELD = math.tan(math.radians(30))
"""Tangent of half the camera's angle of view."""
NEAR_M = 0.7
PARTS = (
    (1, 0, 1, 1, 2, 0.20),
    (1, 1, 3, 1, 2, 0.25),
    (3, 1, 3, 4, 5, 0.20),
    (4, 4, 5, 4, 6, 0.20),
    (7, 6, 7, 7, 8, 0.30),
    (7, 7, 8, 7, 9, 0.20),
    (10, 10, 13, 12, 11, 0.20),
    (14, 10, 13, 12, 11, 0.07),
    (15, 10, 13, 12, 11, 0.07),
)
"""Rigid parts, links 1 to 6, hand and fingers: origin, two points along z, two points along y, radius [m]."""
STATIONS = (-0.6, -0.2, 0.2, 0.6)
"""Points on a ray: distances from the point that is closest to the part's origin, in radii."""
OCTAVES = 5
LOOK = 32
"""Frequencies of the waves, and numbers that describe light and colours of a clip."""
SHARPNESS = 60.0
"""Steepness of the order of parts along a ray [1/m]."""


class Robot(nn.Module):
    """Rays and pose numbers -> colour and opacity of the robot."""

    def __init__(self) -> None:
        super().__init__()
        entries = len(STATIONS) * 3 * (1 + 2 * OCTAVES) + 9 + LOOK
        self.parts = nn.ModuleList(make_mlp(entries, 192, 192, 192, 5) for _ in PARTS)
        self.register_buffer("radius", torch.tensor([part[5] for part in PARTS]), persistent=False)

    def forward(self, rays: Tensor, pose: Tensor, look: Tensor) -> tuple[Tensor, Tensor]:
        """Return colours (B, N, 3), multiplied by opacity, and opacities (B, N, 1).

        Args:
            rays: unit directions in the camera's frame (B, N, 3).
            pose: pose numbers (B, POSE).
            look: light and colours (B, LOOK).
        """
        with torch.autocast(rays.device.type, enabled=False):  # half precision would move parts by pixels
            origin, axes = span_parts(pose)
            camera = -torch.einsum("bpij,bpj->pbi", axes, origin)
            along = torch.einsum("bpij,bnj->pbni", axes, rays)
            range_m = -torch.einsum("pbi,pbni->pbn", camera, along)  # to the point closest to the part's origin
            closest = (camera[:, :, None] + range_m[..., None] * along) / self.radius[:, None, None, None]
        setting = torch.cat([axes.flatten(2), look[:, None].expand(-1, len(PARTS), -1)], dim=-1)
        answers = []
        for n, part in enumerate(self.parts):
            near = closest[n].square().sum(dim=-1) < 1
            stations = torch.cat([closest[n][near] + k * along[n][near] for k in STATIONS], dim=-1)
            out = part(torch.cat([spread_waves(stations, OCTAVES), setting[near.nonzero()[:, 0], n]], dim=-1)).float()
            depth = range_m[n][near, None] + self.radius[n] * out[:, 4:]
            answer = torch.cat([torch.sigmoid(out[:, :3]) * 1.1 - 0.05, torch.sigmoid(out[:, 3:4] - 1), depth], dim=-1)
            answers.append(rays.new_zeros(*near.shape, 5).index_put((near,), answer))
        colours, opacity, depth = torch.stack(answers, dim=2).split([3, 1, 1], dim=-1)
        before = torch.sigmoid(SHARPNESS * (depth - depth.mT)) * (1 - torch.eye(len(PARTS), device=rays.device))
        weight = opacity[..., 0] * (1 - before * opacity.mT).prod(dim=-1)  # nothing of the other parts lies before it
        covered = 1 - (1 - opacity).prod(dim=2)
        weight = weight / weight.sum(dim=-1, keepdim=True).clamp(min=1e-6) * covered
        return (weight[..., None] * colours).sum(dim=2), covered


def span_parts(pose: Tensor) -> tuple[Tensor, Tensor]:
    """Return origins (B, P, 3) [m] and axes (B, P, 3, 3), one a row, of the parts in the camera's frame."""
    u, v, nearness = pose[:, :-1].unflatten(1, (POINTS, 3)).unbind(-1)
    z_m = NEAR_M / (1 + nearness).clamp(min=0.1)
    points = torch.stack([u * z_m * FIELD, v * z_m * FIELD, z_m], dim=-1)
    origin, a, b, c, d = (points[:, [part[k] for part in PARTS]] for k in range(5))
    z = functional.normalize(b - a, dim=-1)
    y = functional.normalize(d - c - ((d - c) * z).sum(dim=-1, keepdim=True) * z, dim=-1)
    return origin, torch.stack([torch.linalg.cross(y, z), y, z], dim=-2)


def spread_waves(x: Tensor, octaves: int) -> Tensor:
    """Return x (..., D) with its sines and cosines at `octaves` frequencies (..., D + 2 D octaves)."""
    angles = (x[..., None] * (math.pi * 2.0 ** torch.arange(octaves, device=x.device))).flatten(-2)
    return torch.cat([x, angles.sin(), angles.cos()], dim=-1)


def make_mlp(*widths: int) -> nn.Sequential:
    """Return a perceptron with layers of these widths."""
    layers = [layer for a, b in pairwise(widths) for layer in (nn.Linear(a, b), nn.SiLU())]
    return nn.Sequential(*layers[:-1])
