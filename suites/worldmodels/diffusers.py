"""Local image-to-video pipelines of Hugging Face diffusers: Wan, CogVideoX, LTX-Video, HunyuanVideo, Cosmos, SVD, ...

One adapter by capability: a pipeline gets those arguments that its call takes.
"""

import importlib.util
import math
import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.checkpoint import (
    FRAME_COUNTS,
    add_lora,
    arguments_of,
    checkpoint_name,
    load_pipeline,
)
from kinebench_drake.suites.worldmodels.media import encode_answer
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

_SIZE = r"^[1-9]\d{1,3}x[1-9]\d{1,3}$"
_HUB_ID = re.compile(r"\w[\w.-]*/[\w.-]+")
_DROPPING = "HunyuanVideoImageToVideoPipeline"
"""Pipeline that drops the frames of the first latent where the image is concatenated to the latents."""
_SPATIAL = ("vae_scale_factor_spatial", "vae_spatial_compression_ratio", "vae_scale_factor")
_TEMPORAL = ("vae_scale_factor_temporal", "vae_temporal_compression_ratio")
"""Attributes with the pixels, and frames, of a latent."""


class DiffusersOptions(Options):
    """Options of `diffusers:`."""

    size: str | None = Field(None, pattern=_SIZE, description="WIDTHxHEIGHT at which the model works [px]")
    frames: int | None = Field(
        None, ge=2, description="number of frames at which the model works; the requested one if not given"
    )
    steps: int | None = Field(None, ge=1, description="denoising steps; the pipeline's own number if not given")
    guidance: float | None = Field(
        None, ge=0, allow_inf_nan=False, description="guidance scale; the pipeline's own if not given"
    )
    lora: str | None = Field(None, min_length=1, description="LoRA weights: file, folder, or ORG/NAME[/FILE]")
    lora_scale: float = Field(1.0, allow_inf_nan=False, description="strength of the LoRA weights")
    dtype: Literal["auto", "bfloat16", "float16", "float32"] = Field("auto", description="precision of the weights")
    device: str | None = Field(None, pattern=r"^(cpu|cuda(:\d+)?)$", description="cpu, cuda or cuda:N")
    offload: Literal["none", "model", "sequential"] = Field(
        "none", description="keep parts in main memory, to save the GPU's"
    )


class DiffusersModel:
    """World model that runs a pipeline in this process; the checkpoint is loaded with the first video."""

    def __init__(self, spec: Spec) -> None:
        self._options = spec.read(DiffusersOptions)
        self._source = spec.rest
        if not self._source:
            raise spec.unusable("expected diffusers:PATH_OR_ID, such as diffusers:Wan-AI/Wan2.1-I2V-14B-480P-Diffusers")
        if not Path(self._source).is_dir() and not _HUB_ID.fullmatch(self._source):
            raise spec.unusable(f"there is no folder {self._source}, and an id on the hub looks like ORG/NAME")
        for package in ("diffusers", "transformers"):
            if importlib.util.find_spec(package) is None:
                raise SetupError(f"the package {package} is missing; pip install 'kinebench-drake[diffusers]'")
        lora = f"+{checkpoint_name(self._options.lora)}" if self._options.lora else ""
        self.name = self._options.name or f"{checkpoint_name(self._source)}{lora}"
        self.pipeline: Any = None

    @property
    def chooses_length(self) -> bool:
        """True if the number of frames is that of the checkpoint or of the option `frames`, not the requested one."""
        return self._options.frames is not None or (self.pipeline is not None and _own_frames(self.pipeline) > 0)

    def generate(self, request: Request, out: Path) -> Path:
        """Run the pipeline and write its frames as an mp4 beside `out`."""
        import torch

        options = self._options
        if self.pipeline is None:
            pipeline = load_pipeline(self._source, dtype=options.dtype, device=options.device, offload=options.offload)
            if options.lora:
                add_lora(pipeline, options.lora, options.lora_scale)
            self.pipeline = pipeline
        arguments, size = self._arguments(request)
        try:
            output = self.pipeline(**arguments)
        except torch.OutOfMemoryError:
            raise SetupError(
                f"{self.name} at {size[0]}x{size[1]} needs more memory than the GPU has; use offload=model or another "
                "size"
            ) from None
        frames = np.asarray(output.frames)
        frames = frames[0] if frames.ndim == 5 else frames  # a batch of one
        wanted = None if self.chooses_length else request.num_frames
        return encode_answer(_to_bytes(frames[:wanted], request.first_frame), request.fps, out)

    def close(self) -> None:
        """Release the pipeline and the memory of the GPU."""
        if self.pipeline is not None:
            import torch

            self.pipeline = None
            torch.cuda.empty_cache()

    def _arguments(self, request: Request) -> tuple[dict[str, Any], tuple[int, int]]:
        """Return the arguments of the pipeline's call for a request, and the image's width and height [px]."""
        import torch

        options = self._options
        pipeline = self.pipeline
        accepted = arguments_of(type(pipeline))
        for option, argument in {"size": "width", "guidance": "guidance_scale", "steps": "num_inference_steps"}.items():
            if getattr(options, option) is not None and argument not in accepted:
                raise SetupError(f"{type(pipeline).__name__} takes no {argument}; leave out {option}=")
        image = Image.fromarray(request.first_frame)
        if "width" in accepted:
            image = image.resize(self._size(request.first_frame), Image.Resampling.LANCZOS)
        frames = options.frames or _own_frames(pipeline) or request.num_frames
        values = {
            "image": image,
            "prompt": request.prompt,
            "negative_prompt": request.negative_prompt or None,
            "width": image.width,
            "height": image.height,
            **dict.fromkeys(FRAME_COUNTS, _supported_frames(pipeline, frames)),
            "num_inference_steps": options.steps,
            "guidance_scale": options.guidance,
            # On the CPU, so that a seed gives the same noise on every device.
            "generator": torch.Generator("cpu").manual_seed(request.seed),
            "output_type": "np",
        }
        return {key: v for key, v in values.items() if key in accepted and v is not None}, image.size

    def _size(self, frame: NDArray[np.uint8]) -> tuple[int, int]:
        """Return the supported width and height [px] nearest to the requested ones."""
        pipeline = self.pipeline
        config = _network(self.pipeline).config
        scale = _attribute(pipeline, _SPATIAL, 8)
        if getattr(config, "use_learned_positional_embeddings", False):
            # Learned position embeddings exist for one size only.
            return int(config.sample_width * scale), int(config.sample_height * scale)
        if self._options.size:
            width, height = (int(side) for side in self._options.size.split("x"))
        else:
            height, width = frame.shape[:2]
        # Most pipelines require sides that are multiples of 16.
        least = 32 if type(pipeline).__name__ == "SanaImageToVideoPipeline" else 16
        multiple = math.lcm(least, *(scale * cells for cells in _patch(config)))
        return multiple * max(round(width / multiple), 1), multiple * max(round(height / multiple), 1)


def _network(pipeline: Any) -> Any:
    """Return the denoising network; of Wan 2.2's two, either may be absent."""
    networks = (getattr(pipeline, name, None) for name in ("transformer", "transformer_2", "unet"))
    return next(network for network in networks if network is not None)


def _patch(config: Any) -> tuple[int, ...]:
    """Return the sides, in latents, of the smallest area that the denoising network processes."""
    patch = getattr(config, "patch_size", None)
    if patch is None:  # a U-Net halves the sides between its blocks
        return (2 ** max(len(getattr(config, "block_out_channels", ())) - 1, 0),)
    return (patch,) if isinstance(patch, int) else tuple(patch[-2:])


def _own_frames(pipeline: Any) -> int:
    """Return the number of frames that a checkpoint was trained for, where it has only one; else 0."""
    return int(getattr(getattr(getattr(pipeline, "unet", None), "config", None), "num_frames", 0) or 0)


def _supported_frames(pipeline: Any, wanted: int) -> int:
    """Return the supported number of frames: the next one from `wanted`, at most the largest."""
    config = _network(pipeline).config
    period = _attribute(pipeline, _TEMPORAL, 1)
    if type(pipeline).__name__ == _DROPPING and getattr(config, "image_condition_type", None) == "latent_concat":
        wanted += period
    frames = math.ceil((wanted - 1) / period) * period + 1
    if getattr(config, "use_learned_positional_embeddings", False):
        return min(frames, int(config.sample_frames))
    return frames


def _attribute(pipeline: Any, names: tuple[str, ...], default: int) -> int:
    """Return the first of the attributes that the pipeline has."""
    return next((int(getattr(pipeline, name)) for name in names if hasattr(pipeline, name)), default)


def _to_bytes(frames: NDArray[np.floating], first: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Convert frames (T, H, W, 3) in 0..1 to bytes, resized to the first frame if the aspect ratio differs."""
    if not np.isfinite(frames).all():
        raise WorldModelError("the video has values that are not numbers; another dtype= may help")
    images = (np.clip(frames, 0, 1) * 255).round().astype(np.uint8)
    (height, width) = images.shape[1:3]
    (first_height, first_width) = first.shape[:2]
    if width * first_height == height * first_width:
        return list(images)
    size = (first_width, first_height)
    return [np.asarray(Image.fromarray(image).resize(size, Image.Resampling.LANCZOS)) for image in images]
