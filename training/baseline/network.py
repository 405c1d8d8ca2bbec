"""Network of the baseline: whole frames in, pose of the TCP and gap between the fingers out.

Published inverse-dynamics networks pass pooled features of a pretrained encoder, of one frame or of two, through a few
dense layers (UniPi, Du et al., NeurIPS 2023; WoW's ResNet and DINO variants, Chi et al. 2025). This one is stronger, to
stand for the best that such networks can do: the encoder is trained as well, features of three strides are joined as in
a feature pyramid (Lin et al., CVPR 2017), attention pooling keeps positions (a spatial softmax with features; Levine et
al., JMLR 2016), and the previous and the next frame are inputs. Rotations are six numbers (Zhou et al., CVPR 2019).

Like all networks of its kind it works for a single camera, that of its training: the pose relative to the robot's base
is learned with it.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from kinebench_drake.camera import Camera
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.geometry import Array, invert, make_pose
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import hand_from_tcp
from kinebench_drake.models.perception.network import GripperNetwork
from kinebench_drake.track import GripperTrack
from training.loop import pick_device


def from_six(six: Tensor) -> Tensor:
    """Return the rotation matrices (..., 3, 3) whose first two columns are six numbers (..., 6), orthonormalized.

    Gram-Schmidt, equation 15 of Zhou et al. (CVPR 2019); any six numbers give a rotation.
    """
    x = functional.normalize(six[..., :3], dim=-1)
    y = six[..., 3:]
    y = functional.normalize(y - (x * y).sum(dim=-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


CONTEXT = 1
"""Number of previous and of next frames that are inputs for each frame."""
POSITION_CENTRE_M = (0.5, 0.0, 0.2)
"""Position in the base frame at which the outputs are zero [m]: in front of the robot."""
POSITION_SCALE_M = 0.1
"""Unit of position of the network [m]."""
FINGER_SCALE_M = 0.04
"""Unit of the gap between the fingers of the network [m]; its zero is half open."""

_CHANNELS = (40, 112, 320)
"""Channels of the encoder at strides 8, 16, 32."""
_PYRAMID = (64, 128)
"""Channels of the pyramid at strides 8, 16."""
_HEADS = 16
_WIDTH = 256
_DROPOUT = 0.1
_DOWN = (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
"""Six numbers of a gripper that points straight down."""
_FROZEN = ("_conv_stem", "_bn0", "_blocks.0", "_blocks.1", "_blocks.2")
_BATCH = 16
_TRAIN = "train it with `python -m training baseline`"


@dataclass(frozen=True, slots=True)
class PoseOutput:
    """Output for T frames of B windows."""

    position: Tensor
    """(B, T, 3) panda_hand_tcp in the base frame [m]."""
    rotation: Tensor
    """(B, T, 3, 3) rotation of panda_hand_tcp in the base frame."""
    finger_width: Tensor
    """(B, T) gap between the finger pads [m]."""


def _join(cin: int, cout: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(cin, cout, 3, padding=1, bias=False), nn.BatchNorm2d(cout), nn.ReLU(inplace=True))


class _AttentionPool(nn.Module):
    """Attention pooling: per head, the mean of features and position under a softmax over the map."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.attention = nn.Conv2d(channels, _HEADS, 1)
        self.size = _HEADS * (channels + 2)

    def forward(self, x: Tensor) -> Tensor:
        """Return vectors (N, size) of maps (N, C, h, w)."""
        n, _, h, w = x.shape
        weight = self.attention(x).float().flatten(2).softmax(dim=-1)
        v, u = torch.meshgrid(
            torch.linspace(-1, 1, h, device=x.device), torch.linspace(-1, 1, w, device=x.device), indexing="ij"
        )
        position = torch.stack([u, v]).flatten(1).expand(n, 2, h * w)
        values = torch.cat([x.float().flatten(2), position], dim=1)
        return torch.einsum("nkp,ncp->nkc", weight, values).flatten(1)


class PoseNetwork(nn.Module):
    """Network from windows of frames (B, T + 2, 3, S, S) in 0..1, S a multiple of 32, to poses of the T inner frames.

    The first layers of the encoder, which respond to edges and textures, stay frozen at their ImageNet weights.
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
        with torch.no_grad():  # the initial output is a gripper that points down at the centre
            last.weight.mul_(0.1)
            last.bias.copy_(torch.tensor([0.0, 0.0, 0.0, *_DOWN, 0.0]))
        self.head = nn.Sequential(nn.Dropout(_DROPOUT), nn.Linear(_WIDTH, _WIDTH), nn.GELU(), last)
        for name, parameter in self.encoder.named_parameters():
            parameter.requires_grad_(not name.startswith(_FROZEN))

    def train(self, mode: bool = True) -> "PoseNetwork":
        """Switch to training mode; frozen layers keep their batch normalisation statistics."""
        super().train(mode)
        for name, module in self.encoder.named_modules():
            if name.startswith(_FROZEN):
                module.eval()
        return self

    def embed(self, images: Tensor) -> Tensor:
        """Return embeddings (N, D) of frames (N, 3, S, S)."""
        images = images.contiguous(memory_format=torch.channels_last)
        features = self.encoder(images * 2.0 - 1.0)
        f_8 = features[-3]
        f_16 = features[-2]
        f_32 = features[-1]
        x = functional.interpolate(self.squeeze(f_32), size=f_16.shape[-2:], mode="bilinear", align_corners=False)
        x = self.join_16(torch.cat([x, f_16], dim=1))
        x = functional.interpolate(x, size=f_8.shape[-2:], mode="bilinear", align_corners=False)
        x = self.join_8(torch.cat([x, f_8], dim=1))
        embedded: Tensor = self.embedding(torch.cat([self.pool(x), f_32.float().mean(dim=(2, 3))], dim=1))
        return embedded

    def fuse(self, embedded: Tensor) -> PoseOutput:
        """Return the poses of the T inner frames of embedded windows (B, T + 2, D)."""
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
        """Return the poses of the inner frames of windows."""
        b, t = windows.shape[:2]
        return self.fuse(self.embed(windows.flatten(0, 1)).view(b, t, _WIDTH))


def resize_frames(frames: Frames, size: int) -> NDArray[np.uint8]:
    """Return frames (T, size, size, 3) from any (T, H, W, 3), by area averaging if smaller."""
    if frames.shape[1:3] == (size, size):
        return np.asarray(frames)
    smaller = frames.shape[1] >= size and frames.shape[2] >= size
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.stack([np.asarray(cv2.resize(f, (size, size), interpolation=how), dtype=np.uint8) for f in frames])


class Baseline:
    """Trained network with the camera and the tasks of its training."""

    def __init__(
        self, network: PoseNetwork, size: int, tasks: tuple[str, ...], camera: Camera, training: str = "unknown"
    ) -> None:
        """Wrap a `network` for frames of `size` px, trained on videos of `tasks` by `camera`; `training` says how."""
        self._device = pick_device()
        self._network = network.to(self._device).eval()
        self._size = size
        self.tasks = tasks
        self._camera = camera
        self.training = training

    @classmethod
    def load(cls, path: Path) -> "Baseline":
        """Read weights that `python -m training baseline` wrote.

        Raises:
            SetupError: the file is missing or holds something else.
        """
        from safetensors import SafetensorError, safe_open

        if not path.is_file():
            raise SetupError(f"{path.name}: no such weights; {_TRAIN}")
        network = PoseNetwork()
        try:
            with safe_open(path, framework="pt") as file:
                about = file.metadata() or {}
                state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no mapping
            network.load_state_dict({k: v.float() if v.dtype.is_floating_point else v for k, v in state.items()})
            camera = Camera.from_json(json.loads(about["camera"]), "camera")
            tasks = tuple(json.loads(about["tasks"]))
            return cls(network, int(about["size"]), tasks, camera, about.get("training", "unknown"))
        except (SafetensorError, RuntimeError, KeyError, ValueError, TypeError, UsageError) as error:
            first = str(error).splitlines()[0]
            raise SetupError(f"{path.name}: not weights of the baseline ({first}); {_TRAIN}") from None

    def require_camera(self, camera: Camera) -> None:
        """Check that the camera is the one of the training: the network works for no other.

        Raises:
            UsageError: field of view or pose differs; the image size may differ.
        """
        same = camera.resized(self._camera.width, self._camera.height)
        if not (
            np.allclose(same.K, self._camera.K, rtol=1e-3) and np.allclose(same.X_BC, self._camera.X_BC, atol=1e-3)
        ):
            raise UsageError("the baseline was trained for another camera; train it on demonstrations of this one")

    @torch.inference_mode()
    def predict(self, frames: Frames) -> tuple[Array, Array]:
        """Return the poses X_BG (T, 4, 4) and the gaps (T,) between the finger pads [m] of all `frames` (T, H, W, 3).

        Unlike the grounding, the baseline has a pose in every frame.
        """
        images = torch.from_numpy(resize_frames(frames, self._size)).permute(0, 3, 1, 2)
        embedded = torch.cat(
            [self._network.embed(part.to(self._device) / 255.0) for part in torch.split(images, _BATCH)]
        )
        before = embedded[:1].expand(CONTEXT, -1)
        after = embedded[-1:].expand(CONTEXT, -1)
        output = self._network.fuse(torch.cat([before, embedded, after])[None])
        rotation, position = (x[0].cpu().double().numpy() for x in (output.rotation, output.position))
        return make_pose(rotation, position), output.finger_width[0].cpu().double().numpy()

    def track(self, frames: Frames, t_s: Array, camera: Camera) -> GripperTrack:
        """Return the predictions for frames (T, H, W, 3) at times (T,) [s] as a track that is certain everywhere."""
        X_BG, finger_width_m = self.predict(frames)
        return GripperTrack(
            t_s=t_s,
            X_CH=invert(camera.X_BC) @ X_BG @ invert(hand_from_tcp()),
            X_BG=X_BG,
            tracked=np.ones(len(frames), dtype=bool),
            confidence=np.ones(len(frames)),
            finger_width_m=finger_width_m,
        )
