"""The trained baseline: a video in, a pose and a gap for every frame out."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from kinebench_drake.camera import Camera
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.grounding.baseline.dataset import resized
from kinebench_drake.grounding.baseline.network import CONTEXT, PoseNetwork
from kinebench_drake.grounding.training.loop import pick_device
from kinebench_drake.grounding.view import Frames

_BATCH = 16
_TRAIN = "train it with `kinebench-drake perception baseline train`"


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """What the baseline says of a video; it says something of every frame."""

    X_BG: Array
    """(T, 4, 4) pose of panda_hand_tcp in the base frame [m]."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""


class Baseline:
    """A trained network with what it was trained on."""

    def __init__(self, network: PoseNetwork, size: int, tasks: tuple[str, ...], camera: Camera) -> None:
        """Take a `network` that sees frames of `size` px, trained on `tasks` seen by `camera`."""
        self._device = pick_device()
        self._network = network.to(self._device).eval()
        self._size, self.tasks, self._camera = size, tasks, camera

    @classmethod
    def load(cls, path: Path) -> "Baseline":
        """Read weights that `kinebench-drake perception baseline train` wrote.

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
            return cls(network, int(about["size"]), tuple(json.loads(about["tasks"])), camera)
        except (SafetensorError, RuntimeError, KeyError, ValueError, TypeError, UsageError) as error:
            first = str(error).splitlines()[0]
            raise SetupError(f"{path.name}: not weights of the baseline ({first}); {_TRAIN}") from None

    def require_camera(self, camera: Camera) -> None:
        """Refuse a camera other than the one of the training: the network knows no other.

        Raises:
            UsageError: the view or the place differs; the number of pixels may.
        """
        same = camera.resized(self._camera.width, self._camera.height)
        if not (
            np.allclose(same.K, self._camera.K, rtol=1e-3) and np.allclose(same.X_BC, self._camera.X_BC, atol=1e-3)
        ):
            raise UsageError("the baseline was trained for another camera; train it on demonstrations of this one")

    @torch.inference_mode()
    def predict(self, frames: Frames) -> Prediction:
        """Poses of all `frames` (T, H, W, 3)."""
        images = torch.from_numpy(resized(frames, self._size)).permute(0, 3, 1, 2)
        embedded = torch.cat(
            [self._network.embed(part.to(self._device) / 255.0) for part in torch.split(images, _BATCH)]
        )
        before, after = embedded[:1].expand(CONTEXT, -1), embedded[-1:].expand(CONTEXT, -1)
        output = self._network.fuse(torch.cat([before, embedded, after])[None])
        rotation, position = (x[0].cpu().double().numpy() for x in (output.rotation, output.position))
        return Prediction(
            X_BG=make_pose(rotation, position), finger_width_m=output.finger_width[0].cpu().double().numpy()
        )
