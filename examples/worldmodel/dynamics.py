"""Dynamics: pose numbers of the first frame, prompt, noise -> pose numbers of all frames.

A transformer with rectified flow (Liu et al. 2022) in the principal components of the pose numbers.
"""

import math
import re
import zlib
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from .pack import FRAMES
from .robot import POSE, make_mlp

WIDTH = 256
DEPTH = 6
WORDS = 512
"""Entries of the bag of words; words are assigned to entries by hash."""
LATENT = 40
"""Principal components: those left out move points of the gripper by 0.2 px at most."""
SMALLEST = 0.005
"""Smallest scale of a component."""


def encode_prompts(prompts: Sequence[str]) -> Tensor:
    """Return the bags of words of prompts (B, WORDS)."""
    bags = torch.zeros(len(prompts), WORDS)
    for bag, prompt in zip(bags, prompts, strict=True):
        for word in re.findall(r"[a-z]+", prompt.lower()):
            bag[zlib.crc32(word.encode()) % WORDS] = 1
    return bags


class Dynamics(nn.Module):
    """Velocity of the flow from noise to the latents of a clip."""

    def __init__(self, poses: Tensor | None = None) -> None:
        """Take the principal components of pose numbers (N, POSE); weights that are loaded have their own."""
        super().__init__()
        self.words = nn.Linear(WORDS, WIDTH)
        self.enter = nn.Linear(3 * LATENT, WIDTH)
        self.places = nn.Parameter(0.02 * torch.randn(FRAMES + 1, WIDTH))
        self.time = make_mlp(64, WIDTH, WIDTH)
        layer = nn.TransformerEncoderLayer(WIDTH, WIDTH // 64, 4 * WIDTH, batch_first=True, norm_first=True)
        self.layers = nn.TransformerEncoder(layer, DEPTH, enable_nested_tensor=False)
        self.leave = nn.Sequential(nn.LayerNorm(WIDTH), nn.Linear(WIDTH, LATENT))
        poses = torch.eye(POSE) if poses is None else poses
        _, spread, basis = torch.linalg.svd(poses - poses.mean(dim=0), full_matrices=False)
        self.register_buffer("mean", poses.mean(dim=0))
        self.register_buffer("basis", basis[:LATENT].T.contiguous())
        self.register_buffer("scale", (spread[:LATENT] / len(poses) ** 0.5).clamp(min=SMALLEST))

    def to_latent(self, pose: Tensor) -> Tensor:
        """Return latents (..., LATENT) of about unit variance of pose numbers (..., POSE)."""
        with torch.autocast(pose.device.type, enabled=False):
            return (pose - self.mean) @ self.basis / self.scale

    def forward(self, x: Tensor, t: Tensor, start: Tensor, prompts: Tensor) -> Tensor:
        """Return the velocity (B, FRAMES, LATENT).

        Args:
            x: latents on the way (B, FRAMES, LATENT).
            t: time of the flow (B,): 0 noise, 1 data.
            start: latents of the first frames (B, LATENT).
            prompts: bags of words (B, WORDS).
        """
        first = torch.zeros_like(x)
        first[:, 0] = start
        x = torch.cat([first[:, :1], x[:, 1:]], dim=1)
        tokens = self.enter(torch.cat([x, start[:, None].expand_as(x), first], dim=-1))
        angles = t[:, None] * torch.exp(torch.linspace(0, math.log(1000), 32, device=t.device))
        time = self.time(torch.cat([angles.cos(), angles.sin()], dim=1))
        tokens = torch.cat([tokens, self.words(prompts)[:, None]], dim=1) + self.places + time[:, None]
        return self.leave(self.layers(tokens)[:, :FRAMES])

    def flow_loss(self, poses: Tensor, start: Tensor, prompts: Tensor) -> Tensor:
        """Return the velocity's squared error on clips (B, FRAMES, POSE), which begin with `start` (B, POSE)."""
        data = self.to_latent(poses)
        t = torch.sigmoid(torch.randn(len(data), device=data.device))
        noise = torch.randn_like(data)
        x = noise + t[:, None, None] * (data - noise)
        velocity = self(x, t, self.to_latent(start), prompts)
        return functional.mse_loss(velocity[:, 1:].float(), (data - noise)[:, 1:])

    @torch.no_grad()
    def sample(self, start: Tensor, prompts: Tensor, noise: Tensor, steps: int = 40) -> Tensor:
        """Integrate the flow to pose numbers (B, FRAMES, POSE) from noise (B, FRAMES, LATENT), by Heun's method."""
        begin = self.to_latent(start)
        x = noise
        times = torch.linspace(0, 1, steps + 1, device=x.device)
        for t, after in pairwise(times):
            slope = self(x, t.expand(len(x)), begin, prompts)
            ahead = x + (after - t) * slope
            x = x + (after - t) * (slope + self(ahead, after.expand(len(x)), begin, prompts)) / 2
        poses = x * self.scale @ self.basis.T + self.mean
        return torch.cat([start[:, None], poses[:, 1:]], dim=1)
