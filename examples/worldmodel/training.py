"""Training of autoencoder and dynamics: for a number of minutes, resumable, on a GPU or on one CPU core."""

import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from .autoencoder import Autoencoder, choose_pixels, distort_colours, to_images, to_uv
from .dynamics import Dynamics, encode_prompts
from .pack import FRAMES, read_pack

_log = logging.getLogger(__name__)
RATE = 1e-3
DECAY = 0.998
"""Learning rate, and the share of the averaged weights that a step keeps."""
CLIP_FRAMES = 8
PIXELS = 256
"""Frames of each clip and pixels of each frame in a batch of the decoder."""
START_NOISE = 0.005
"""Standard deviation of the noise on the first frame's pose numbers: the encoder is not exact."""
LOG_S = 20.0
SAVE_S = 180.0
"""Times between lines of the log and between checkpoints [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig:
    """Options of a training."""

    stage: str  # autoencoder or dynamics
    pack: Path
    out: Path
    minutes: float  # duration of this call, start-up excluded
    steps: int = 10**9  # at which training is complete
    levels: tuple[int, ...] = ()  # steps at which the weights are kept as STAGE_STEP.safetensors as well
    demos: int | None = None  # demonstrations of each task; None: all
    batch: int | None = None  # clips; None: 32, of the autoencoder 8 on a CPU, 64 on a GPU
    cool: bool = False  # the learning rate falls to a twentieth in the course of this call
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Clips:
    """The demonstrations to learn from."""

    frames: Tensor  # (N, FRAMES, SIZE, SIZE, 3) uint8
    poses: Tensor  # pose numbers (N, FRAMES, POSE)
    prompts: Tensor  # bags of words (N, WORDS)

    def draw(self, count: int, late: float, draws: torch.Generator) -> tuple[Tensor, Tensor]:
        """Draw clips and the frame at which each begins (B,): a share `late` not at the demonstration's first."""
        starts = torch.randint(FRAMES - 8, (count,), generator=draws) * (torch.rand(count, generator=draws) < late)
        clips = torch.randint(len(self.frames), (count,), generator=draws)
        return clips.to(self.frames.device), starts.to(self.frames.device)

    def start(self, clips: Tensor, starts: Tensor) -> Tensor:
        """Return the pose numbers of first frames (B, POSE), as inexact as the encoder's."""
        return self.poses[clips, starts] + START_NOISE * torch.randn_like(self.poses[clips, starts])


def autoencoder_loss(model: Autoencoder, clips: Clips, batch: int | None, draws: torch.Generator) -> Tensor:
    """Return the error of painted pixels plus that of the pose numbers that the encoder reads."""
    batch = batch or (64 if clips.frames.is_cuda else 8)
    chosen, starts = clips.draw(batch, 0.3, draws)
    times = torch.randint(FRAMES, (batch, CLIP_FRAMES), generator=draws).to(chosen.device)
    poses = clips.poses[chosen[:, None], times]
    pixels = choose_pixels(poses, PIXELS)
    rows, columns = pixels.unbind(dim=-1)
    first = to_images(clips.frames[chosen, starts])
    colours, share = model(first, clips.start(chosen, starts), poses, to_uv(pixels))
    moments = starts[:, None, None], times[..., None]
    before, truth = (clips.frames[chosen[:, None, None], k, rows, columns].float() / 255 for k in moments)
    error = (colours + share * before - truth).abs().mean()
    chosen, times = clips.draw(2 * batch, 0.8, draws)
    read = model.encoder(distort_colours(to_images(clips.frames[chosen, times])))
    return error + (read - clips.poses[chosen, times]).abs().mean()


def dynamics_loss(model: Dynamics, clips: Clips, batch: int | None, draws: torch.Generator) -> Tensor:
    """Return the flow's error on clips that begin at any frame; after the end the last frame is repeated."""
    chosen, starts = clips.draw(batch or 32, 0.4, draws)
    times = (starts[:, None] + torch.arange(FRAMES, device=starts.device)).clamp(max=FRAMES - 1)
    return model.flow_loss(clips.poses[chosen[:, None], times], clips.start(chosen, starts), clips.prompts[chosen])


def train(config: TrainConfig) -> int:
    """Train a stage; return the step reached."""
    torch.manual_seed(config.seed)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    frames, poses, prompts = read_pack(config.pack, "train", config.demos)
    arrays = torch.from_numpy(frames), torch.from_numpy(poses), encode_prompts(prompts)
    clips = Clips(**dict(zip(("frames", "poses", "prompts"), (x.to(device) for x in arrays), strict=True)))
    model = (Autoencoder() if config.stage == "autoencoder" else Dynamics(arrays[1].flatten(0, 1))).to(device)
    loss_of = autoencoder_loss if config.stage == "autoencoder" else dynamics_loss
    average = AveragedModel(model, multi_avg_fn=get_ema_multi_avg_fn(DECAY), use_buffers=True)
    optimizer = torch.optim.AdamW(model.parameters(), RATE, betas=(0.9, 0.99), weight_decay=0.01, fused=True)
    config.out.mkdir(parents=True, exist_ok=True)
    state = config.out / f"{config.stage}.state"
    step = 0
    if state.exists():
        stored = load_file(state)
        step = int(stored.pop("step"))
        parts: dict[str, dict[str, Tensor]] = {}
        for (group, key), value in ((name.split("/"), value) for name, value in stored.items()):
            parts.setdefault(group, {})[key] = value
        model.load_state_dict(parts.pop("model"))
        average.load_state_dict(parts.pop("average"))
        optimizer.load_state_dict(optimizer.state_dict() | {"state": {int(n): part for n, part in parts.items()}})
    if device.type == "cuda" and config.stage == "dynamics":  # the autoencoder's shapes change from step to step
        model.compile()

    def save(name: str) -> None:
        weights = {key: value.half().contiguous() for key, value in average.module.state_dict().items()}
        groups = {"model": model.state_dict(), "average": average.state_dict()} | optimizer.state_dict()["state"]
        stored = {f"{group}/{key}": value for group, values in groups.items() for key, value in values.items()}
        _replace(config.out / f"{name}.safetensors", weights)
        _replace(state, stored | {"step": torch.tensor(step)})

    began = saved = logged = time.monotonic()
    total = torch.zeros((), device=device)
    count = 0
    while step < config.steps and (past := (time.monotonic() - began) / (60 * config.minutes)) < 1:
        draws = torch.Generator().manual_seed(config.seed * 10**8 + step)
        torch.manual_seed(config.seed * 10**8 + step + 1)
        for group in optimizer.param_groups:
            group["lr"] = RATE * min((step + 1) / 200, 1 - 0.95 * past * config.cool)
        with torch.autocast(device.type, torch.bfloat16):
            loss = loss_of(model, clips, config.batch, draws)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        average.update_parameters(model)
        step = step + 1
        total = total + loss.detach()
        count = count + 1
        if step in config.levels:
            save(f"{config.stage}_{step:05d}")
        now = time.monotonic()
        if now - logged > LOG_S:
            _log.info("step %d loss %.4f, %.2f steps/s", step, float(total) / count, count / (now - logged))
            total = torch.zeros_like(total)
            count = 0
            logged = now
        if now - saved > SAVE_S:
            save(config.stage)
            saved = now
    save(config.stage)
    return step


def _replace(path: Path, tensors: dict[str, Tensor]) -> None:
    part = path.with_suffix(".part")
    save_file(tensors, part)
    os.replace(part, path)
