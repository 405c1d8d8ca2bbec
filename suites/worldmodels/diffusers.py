"""Local image-to-video pipelines of Hugging Face diffusers: Wan 2.1 and 2.2, CogVideoX, with LoRA weights.

Pipelines: https://huggingface.co/docs/diffusers/api/pipelines/wan and .../api/pipelines/cogvideox
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
from kinebench_drake.suites.worldmodels.remote import clean
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.suites.worldmodels.videofile import encode_answer
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

_WAN = "WanImageToVideoPipeline"
PIPELINES = (_WAN, "CogVideoXImageToVideoPipeline")
"""Pipeline classes that a checkpoint may name: Wan 2.1 and 2.2, CogVideoX."""
_LIBRARIES = ("diffusers", "transformers", None)
"""Libraries of the parts of a pipeline; None: the part is absent. Code in a checkpoint is never run."""
_INDEX = "model_index.json"
_LORA_FILE = "pytorch_lora_weights.safetensors"
_ADAPTER = "lora"


def load_pipeline(
    source: str,
    *,
    dtype: Literal["auto", "bfloat16", "float16", "float32"],
    device: str | None,
    offload: Literal["none", "model", "sequential"],
) -> Any:
    """Load the pipeline of a checkpoint.

    Args:
        source: a folder, or an id on Hugging Face's hub.
        dtype: precision of the weights; auto: bfloat16 on a GPU, else float32.
        device: device to run on; None: the GPU if there is one, else the CPU.
        offload: parts kept in main memory while unused.

    Raises:
        SetupError: diffusers is not installed, or the checkpoint is not supported or cannot be loaded.
    """
    try:
        import diffusers
        import torch
        import transformers
    except ImportError as error:
        raise SetupError(f"diffusers cannot be imported ({error}); pip install 'kinebench-drake[diffusers]'") from None
    for library in (diffusers, transformers):
        library.utils.logging.disable_progress_bar()
    place = device or ("cuda" if torch.cuda.is_available() else "cpu")
    automatic = torch.float32 if place == "cpu" else torch.bfloat16
    precision = automatic if dtype == "auto" else getattr(torch, dtype)
    try:
        kind = _kind(diffusers.DiffusionPipeline.load_config(source))
        # Wan's documentation keeps these two in float32: half precision is visible in the video.
        exact = {"vae": torch.float32, "image_encoder": torch.float32} if kind == _WAN else {}
        pipeline = getattr(diffusers, kind).from_pretrained(
            source, dtype={"default": precision, **exact}, use_safetensors=True
        )
        if offload == "model":
            pipeline.enable_model_cpu_offload(device=place)
        elif offload == "sequential":
            pipeline.enable_sequential_cpu_offload(device=place)
        else:
            pipeline.to(place)
    except (OSError, ValueError, ImportError, RuntimeError) as error:
        raise SetupError(f"the checkpoint {checkpoint_name(source)} cannot be loaded: {clean(error)}") from None
    pipeline.set_progress_bar_config(disable=True)
    return pipeline


def add_lora(pipeline: Any, lora: str, scale: float) -> None:
    """Add LoRA weights to a pipeline.

    Args:
        pipeline: pipeline of `load_pipeline`.
        lora: a .safetensors file, a folder with the file that diffusers' trainers write, or ORG/NAME[/FILE] on the hub.
        scale: strength of the weights.

    Raises:
        SetupError: the weights cannot be loaded.
    """
    name, folder, file = checkpoint_name(lora), lora, _LORA_FILE
    if lora.endswith(".safetensors"):
        folder, _, file = lora.rpartition("/")
        folder = folder or "."
    if Path(folder).is_dir() and not (Path(folder) / file).is_file():
        raise SetupError(f"the LoRA {name} is not there; expected a .safetensors file or a folder with {_LORA_FILE}")
    try:
        pipeline.load_lora_weights(folder, weight_name=file, use_safetensors=True, adapter_name=_ADAPTER)
        if _ADAPTER not in {adapter for adapters in pipeline.get_list_adapters().values() for adapter in adapters}:
            raise ValueError("it has no weights for the pipeline")
        pipeline.set_adapters([_ADAPTER], [scale])
    except LookupError:
        raise SetupError(
            f"the LoRA {checkpoint_name(lora)} cannot be loaded: its weights do not fit the pipeline"
        ) from None
    except (OSError, ValueError, ImportError, RuntimeError) as error:
        raise SetupError(f"the LoRA {checkpoint_name(lora)} cannot be loaded: {clean(error)}") from None


def checkpoint_name(source: str) -> str:
    """Return the name of a checkpoint in messages and results: the last part of a path, or an id of the hub."""
    parts = source.rstrip("/").split("/")
    is_path = Path(source).exists() or source.startswith((".", "/", "~")) or len(parts) != 2
    return parts[-1] if is_path else source


def _kind(index: dict[str, Any]) -> str:
    """Return the name of the pipeline class.

    Raises:
        ValueError: it is not supported, or a part comes from another library.
    """
    kind = index.get("_class_name")
    if kind not in PIPELINES:
        raise ValueError(f"its {_INDEX} names {kind}; expected {' or '.join(PIPELINES)}")
    for name, part in index.items():
        if isinstance(part, list | tuple) and len(part) == 2 and part[0] not in _LIBRARIES:
            raise ValueError(f"its {_INDEX} takes {name} from {part[0]}; expected parts of diffusers and transformers")
    return str(kind)


_SIZE = r"^[1-9]\d{1,3}x[1-9]\d{1,3}$"
_HUB_ID = re.compile(r"\w[\w.-]*/[\w.-]+")
_WAN_SIDES = 16
"""The Wan pipeline requires sides that are multiples of this."""


class DiffusersOptions(Options):
    """Options of `diffusers:`."""

    size: str | None = Field(None, pattern=_SIZE, description="WIDTHxHEIGHT at which the model works [px]")
    steps: int = Field(50, ge=1, description="denoising steps")
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
        self._pipeline: Any = None

    def generate(self, request: Request, out: Path) -> Path:
        """Run the pipeline and write its frames as an mp4 beside `out`."""
        import torch

        options = self._options
        if self._pipeline is None:
            pipeline = load_pipeline(self._source, dtype=options.dtype, device=options.device, offload=options.offload)
            if options.lora:
                add_lora(pipeline, options.lora, options.lora_scale)
            self._pipeline = pipeline
        width, height = self._size(request.first_frame)
        guidance = {} if options.guidance is None else {"guidance_scale": options.guidance}
        try:
            output = self._pipeline(
                image=Image.fromarray(request.first_frame).resize((width, height), Image.Resampling.LANCZOS),
                prompt=request.prompt,
                negative_prompt=request.negative_prompt or None,
                height=height,
                width=width,
                num_frames=self._num_frames(request.num_frames),
                num_inference_steps=options.steps,
                # On the CPU, so that a seed gives the same noise on every device.
                generator=torch.Generator("cpu").manual_seed(request.seed),
                output_type="np",
                **guidance,
            )
        except torch.OutOfMemoryError:
            raise SetupError(
                f"{self.name} at {width}x{height} needs more memory than the GPU has; use offload=model or another size"
            ) from None
        frames = _to_bytes(np.asarray(output.frames[0])[: request.num_frames], request.first_frame)
        return encode_answer(frames, request.fps, out)

    def close(self) -> None:
        """Release the pipeline and the memory of the GPU."""
        if self._pipeline is not None:
            import torch

            self._pipeline = None
            torch.cuda.empty_cache()

    def _size(self, frame: NDArray[np.uint8]) -> tuple[int, int]:
        """Return the supported width and height [px] nearest to the requested ones."""
        pipeline, network = self._pipeline, _network(self._pipeline)
        scale, patch = pipeline.vae_scale_factor_spatial, network.config.patch_size
        if getattr(network.config, "use_learned_positional_embeddings", False):
            # Learned position embeddings exist for one size only.
            return int(network.config.sample_width * scale), int(network.config.sample_height * scale)
        if self._options.size:
            width, height = (int(side) for side in self._options.size.split("x"))
        else:
            height, width = frame.shape[:2]
        multiple = scale * patch if isinstance(patch, int) else math.lcm(_WAN_SIDES, scale * patch[1], scale * patch[2])
        return _nearest(width, multiple), _nearest(height, multiple)

    def _num_frames(self, wanted: int) -> int:
        """Return the supported number of frames: the next one from `wanted`, at most the largest."""
        network, period = _network(self._pipeline), self._pipeline.vae_scale_factor_temporal
        frames: int = math.ceil((wanted - 1) / period) * period + 1
        if getattr(network.config, "use_learned_positional_embeddings", False):
            return min(frames, int(network.config.sample_frames))
        return frames


def _network(pipeline: Any) -> Any:
    """Return the denoising network; of Wan 2.2's two, either may be absent."""
    return pipeline.transformer if pipeline.transformer is not None else pipeline.transformer_2


def _nearest(side_px: int, multiple: int) -> int:
    return max(round(side_px / multiple), 1) * multiple


def _to_bytes(frames: NDArray[np.floating], first: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Convert frames (T, H, W, 3) in 0..1 to bytes, resized to the first frame if the aspect ratio differs."""
    if not np.isfinite(frames).all():
        raise WorldModelError("the video has values that are not numbers; another dtype= may help")
    images = (np.clip(frames, 0, 1) * 255).round().astype(np.uint8)
    (height, width), (first_height, first_width) = images.shape[1:3], first.shape[:2]
    if width * first_height == height * first_width:
        return list(images)
    size = (first_width, first_height)
    return [np.asarray(Image.fromarray(image).resize(size, Image.Resampling.LANCZOS)) for image in images]
