"""Generation: first frame, prompt and seed -> video at the size of the first frame; over HTTP as well."""

from http.server import HTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional

from examples.world_model_server import Handler
from kinebench_drake.errors import SetupError
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.worldmodels.worldmodel import Request

from .autoencoder import Autoencoder, to_images, to_uv
from .dynamics import LATENT, Dynamics, encode_prompts
from .pack import FRAMES
from .robot import SIZE


class Generator:
    """The trained world model of a folder of weights; dynamics `dynamics_01500`: those of an earlier step."""

    def __init__(self, weights: Path, dynamics: str = "dynamics") -> None:
        self._autoencoder = Autoencoder().eval()
        self._dynamics = Dynamics().eval()
        for model, name in ((self._autoencoder, "autoencoder"), (self._dynamics, dynamics)):
            if not (path := weights / f"{name}.safetensors").exists():
                raise SetupError(f"{path} is missing; python -m examples.worldmodel train --help")
            model.load_state_dict({key: value.float() for key, value in load_file(path).items()})

    def generate(self, first: NDArray[np.uint8], prompt: str, seed: int, count: int = FRAMES) -> NDArray[np.uint8]:
        """Return a video (count, H, W, 3) that begins with `first` (H, W, 3); beyond 49 frames the last is repeated."""
        return self.paint(first, self.imagine(first, prompt, seed)[[min(k, FRAMES - 1) for k in range(count)]])

    @torch.no_grad()
    def imagine(self, first: NDArray[np.uint8], prompt: str, seed: int) -> Tensor:
        """Return the pose numbers (FRAMES, POSE) of a video that begins with `first` (H, W, 3)."""
        noise = torch.randn(1, FRAMES, LATENT, generator=torch.Generator().manual_seed(seed % 2**63))
        return self._dynamics.sample(self._autoencoder.encoder(_shrink(first)), encode_prompts([prompt]), noise)[0]

    @torch.no_grad()
    def paint(self, first: NDArray[np.uint8], poses: Tensor) -> NDArray[np.uint8]:
        """Return a video of the pose numbers (T, POSE); frame 0 is `first` (H, W, 3) itself."""
        small = _shrink(first)
        background = to_images(torch.tensor(first))
        uv = to_uv(torch.cartesian_prod(*[torch.arange(SIZE)] * 2))[None, None]
        frames = [first]
        for pose in poses[1:]:
            with torch.autocast("cpu", torch.bfloat16):
                colours, share = self._autoencoder(small, poses[:1], pose[None, None], uv)
            parts = torch.cat([colours, share], dim=-1)[0].mT.unflatten(2, (SIZE, SIZE))
            parts = functional.interpolate(parts, first.shape[:2], mode="bicubic", align_corners=False)[0]
            image = (parts[:3] + parts[3:] * background).clamp(0, 1)
            frames.append((image * 255).round().byte().movedim(0, -1).numpy())
        return np.stack(frames)


class Learned:
    """The model as a class: `--world-model "examples.worldmodel.generator:Learned?weights=FOLDER&dynamics=NAME"`."""

    def __init__(self, weights: str = "examples/worldmodel/weights", dynamics: str = "dynamics") -> None:
        self.name = "learned"
        self._generator = Generator(Path(weights), dynamics)

    def generate(self, request: Request, out: Path) -> Path:
        """Write the video of a request."""
        path = out.with_name(f"{out.name}.mp4")
        ask = (request.prompt, request.seed, request.num_frames)
        write_video(path, self._generator.generate(request.first_frame, *ask), request.fps)
        return path

    def close(self) -> None:
        """Nothing is held."""


def make_server(generator: Generator, port: int) -> HTTPServer:
    """Return a server on this machine that answers one request at a time; port 0: any free one."""

    class Answer(Handler):
        def imagine(self, first: NDArray[np.uint8], ask: dict[str, Any]) -> NDArray[np.uint8]:
            return generator.generate(first, ask["prompt"], ask["seed"], ask["num_frames"])

    return HTTPServer(("127.0.0.1", port), Answer)


def _shrink(frame: NDArray[np.uint8]) -> Tensor:
    return to_images(torch.from_numpy(cv2.resize(frame, (SIZE, SIZE), interpolation=cv2.INTER_AREA))[None])
