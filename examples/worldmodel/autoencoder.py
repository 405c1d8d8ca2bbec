"""Autoencoder of frames whose latent vector are pose numbers.

The encoder reads them from a frame. The decoder paints them into a first frame, pixel by pixel: the robot's light field
before the scene. At each pixel the scene is a mixture of the first frame, of what the objects carry there, and of
paint. Pixels are independent of each other, so that training takes few pixels of many frames.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from .robot import FIELD, LOOK, POSE, ROBOT, SIZE, Robot, make_mlp, spread_waves

FEATURES = 32
MAPS = 64
"""Features of a pixel of the scene, and heat maps of the encoder."""
WIDTHS = (48, 64, 96, 128)
"""Channels at 48, 24, 12 and 6 px."""
OBJECTS = 2


class Block(nn.Module):
    """Residual block."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(8, channels)
        self.one = nn.Conv2d(channels, channels, 3, padding=1)
        self.two = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + 0.5 * self.two(functional.silu(self.one(functional.silu(self.norm(x)))))


class Encoder(nn.Module):
    """Frame (B, 3, SIZE, SIZE), 0..1 -> pose numbers (B, POSE), from peaks of heat maps and from coarse features."""

    def __init__(self) -> None:
        super().__init__()
        fine = [nn.Conv2d(48, 64, 3, padding=1), Block(64), nn.Conv2d(64, 96, 3, stride=2, padding=1), Block(96)]
        self.fine = nn.Sequential(nn.PixelUnshuffle(4), *fine, Block(96))
        self.heat = nn.Conv2d(96, MAPS, 1)
        coarse = [nn.Conv2d(96, 128, 3, stride=2, padding=1), Block(128), nn.Conv2d(128, 32, 3, stride=2, padding=1)]
        self.coarse = nn.Sequential(*coarse, nn.SiLU(), nn.Flatten())
        self.head = make_mlp(2 * MAPS + 32 * 36, 256, POSE)

    def forward(self, image: Tensor) -> Tensor:
        fine = self.fine(image)
        heat = self.heat(fine).float().flatten(2).softmax(dim=-1).unflatten(2, fine.shape[2:])
        axis = torch.linspace(-1, 1, fine.shape[-1], device=image.device)
        peaks = torch.cat([(heat.sum(dim=k) * axis).sum(dim=-1) for k in (2, 3)], dim=1)
        return self.head(torch.cat([peaks, self.coarse(fine)], dim=1)).float()


class Modulated(nn.Module):
    """Perceptron of pixels (B, N, entries); a vector of the frame (B, condition) modulates the hidden layers."""

    def __init__(self, entries: int, condition: int, out: int, width: int = 128) -> None:
        super().__init__()
        self.enter = nn.Linear(entries, width)
        self.middle = nn.Linear(width, width)
        self.leave = make_mlp(width, width, out)
        self.condition = make_mlp(condition, 256, 4 * width)

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        a, b, c, d = (0.3 * self.condition(condition)[:, None]).chunk(4, dim=-1)
        x = functional.silu(self.enter(x) * (1 + a) + b)
        return self.leave(functional.silu(self.middle(x) * (1 + c) + d)).float()


class Scene(nn.Module):
    """First frame, pose numbers -> colours behind the robot."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(nn.PixelUnshuffle(4), nn.Conv2d(48, WIDTHS[0], 3, padding=1))
        self.blocks = nn.ModuleList(Block(c) for c in WIDTHS)
        self.downs = nn.ModuleList(nn.Conv2d(a, b, 3, stride=2, padding=1) for a, b in pairwise(WIDTHS))
        self.ups = nn.ModuleList(nn.Conv2d(a + b, a, 3, padding=1) for a, b in pairwise(WIDTHS))
        self.features = nn.Conv2d(WIDTHS[0], FEATURES, 1)
        self.look = nn.Linear(WIDTHS[3], LOOK)
        poses = 2 * (POSE - 3 * ROBOT)
        self.mix = Modulated(3 + FEATURES + 18 + OBJECTS * (3 + FEATURES + 10), poses + LOOK, 2 + OBJECTS + 3)
        self.shade = Modulated(FEATURES + 18, 2 * POSE + LOOK, 1)

    def see(self, first: Tensor) -> tuple[Tensor, Tensor]:
        """Return features (C, FEATURES, 48, 48) and the look (C, LOOK) of first frames (C, 3, SIZE, SIZE)."""
        levels = [self.blocks[0](self.stem(first))]
        for down, block in zip(self.downs, self.blocks[1:], strict=True):
            levels.append(block(down(levels[-1])))
        x = levels.pop()
        look = self.look(x.mean(dim=(2, 3)))
        for up in reversed(self.ups):
            x = functional.silu(up(torch.cat([levels.pop(), functional.interpolate(x, scale_factor=2.0)], dim=1)))
        return self.features(x).float(), look.float()

    def forward(
        self, first: Tensor, features: Tensor, look: Tensor, start: Tensor, pose: Tensor, uv: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Paint what `Autoencoder` paints, without the robot; look, start, pose and uv are those of C T frames."""
        seen = fetch(features, uv)
        place = spread_waves(uv, 4)
        entries = [fetch(first, uv), seen, place]
        copies = []
        old, new = (p[:, 3 * ROBOT : -1].unflatten(1, (OBJECTS, 2, 3))[:, :, 0, None] for p in (start, pose))
        for before, now in zip(old.unbind(1), new.unbind(1), strict=True):
            distance = 1 / (1 + now[..., 2:]).clamp(min=0.1)
            offset = uv - now[..., :2]
            source = before[..., :2] + offset * distance * (1 + before[..., 2:])  # the object carries its picture along
            copies.append(fetch(first, source))
            entries += [copies[-1], fetch(features, source), spread_waves((5 * offset * distance).clamp(-2, 2), 2)]
        objects = torch.cat([start[:, 3 * ROBOT :], pose[:, 3 * ROBOT :], look], dim=1)
        out = self.mix(torch.cat(entries, dim=-1), objects)
        light = 2 * torch.sigmoid(self.shade(torch.cat([seen, place], dim=-1), torch.cat([start, pose, look], dim=1)))
        share = out[..., : 2 + OBJECTS].softmax(dim=-1) * light
        layers = torch.stack([torch.sigmoid(out[..., 2 + OBJECTS :]) * 1.1 - 0.05, *copies], dim=-1)
        return (layers * share[..., None, 1:]).sum(dim=-1), share[..., :1]


class Autoencoder(nn.Module):
    """Encoder, and the decoder: scene and robot."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder()
        self.scene = Scene()
        self.robot = Robot()

    def forward(self, first: Tensor, start: Tensor, poses: Tensor, uv: Tensor) -> tuple[Tensor, Tensor]:
        """Paint pixels of T frames of each of C clips.

        Args:
            first: first frames (C, 3, SIZE, SIZE), 0..1.
            start: their pose numbers (C, POSE).
            poses: pose numbers of the frames (C, T, POSE).
            uv: pixels of these frames (C, T, N, 2), -1..1.

        Returns:
            Colours (C, T, N, 3) without what remains of the first frame, and the share (C, T, N, 1) that remains of it.
        """
        shape = poses.shape[:2]
        features, look = self.scene.see(first)
        start, look = (x.repeat_interleave(shape[1], dim=0) for x in (start, look))
        pose = poses.flatten(0, 1)
        uv = uv.flatten(0, 1)
        behind, share = self.scene(first, features, look, start, pose, uv)
        rays = functional.normalize(torch.cat([uv * FIELD, torch.ones_like(uv[..., :1])], dim=-1), dim=-1)
        colours, covered = self.robot(rays, pose, look)
        return tuple(x.unflatten(0, shape) for x in (colours + (1 - covered) * behind, (1 - covered) * share))


def fetch(maps: Tensor, uv: Tensor) -> Tensor:
    """Sample maps (C, K, H, W) of C clips at pixels (C T, N, 2) of T frames each; return (C T, N, K)."""
    grid = uv.reshape(len(maps), -1, 1, 2)
    values = functional.grid_sample(maps, grid, padding_mode="border", align_corners=False)
    return values[..., 0].transpose(1, 2).reshape(*uv.shape[:2], -1)


def choose_pixels(poses: Tensor, count: int) -> Tensor:
    """Draw rows and columns (C, T, count, 2) of pixels, most of them near the points of pose numbers (C, T, POSE)."""
    shape = (*poses.shape[:2], count)
    everywhere = torch.randint(SIZE, (*shape, 2), device=poses.device)
    points = poses[..., :-1].unflatten(-1, (-1, 3))[..., 7:, :2].flip(-1)  # from the arm's wrist on
    chosen = torch.randint(points.shape[2], (*shape, 1), device=poses.device).expand(*shape, 2)
    centres = points.gather(2, chosen)
    near = ((centres + 1) * SIZE / 2 + 10 * torch.randn_like(centres)).floor().long()
    outside = ((near < 0) | (near >= SIZE)).any(dim=-1, keepdim=True)
    return torch.where(outside | (torch.rand(*shape, 1, device=poses.device) < 0.25), everywhere, near)


def to_images(frames: Tensor) -> Tensor:
    """Convert frames (..., H, W, 3) uint8 to images (..., 3, H, W), 0..1."""
    return frames.movedim(-1, -3).float() / 255


def to_uv(pixels: Tensor) -> Tensor:
    """Convert rows and columns of pixels (..., 2) to u, v of their centres."""
    return (pixels.flip(-1) + 0.5) * 2 / SIZE - 1


def distort_colours(images: Tensor) -> Tensor:
    """Change contrast, brightness and colour cast of images (B, 3, H, W), 0..1, at random."""
    gain, shift = torch.randn(2, len(images), 3, 1, 1, device=images.device)
    common = torch.randn(2, len(images), 1, 1, 1, device=images.device)
    images = images * (1 + 0.1 * gain + 0.2 * common[0]) + 0.05 * shift + 0.1 * common[1]
    return images.clamp(0, 1)
