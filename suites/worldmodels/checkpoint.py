"""Checkpoints of Hugging Face diffusers, loaded as image-to-video pipelines, with LoRA weights.

Any pipeline class of diffusers is accepted that generates frames from an image, and from a prompt if it takes one.
"""

import importlib.util
import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.remote import clean

IMAGE_TO_VIDEO: Mapping[str, str] = {
    "WanPipeline": "WanImageToVideoPipeline",
    "LTXPipeline": "LTXImageToVideoPipeline",
    "LTX2Pipeline": "LTX2ImageToVideoPipeline",
    "MotifVideoPipeline": "MotifVideoImage2VideoPipeline",
    "SanaVideoPipeline": "SanaImageToVideoPipeline",
    "SkyReelsV2DiffusionForcingPipeline": "SkyReelsV2DiffusionForcingImageToVideoPipeline",
}
"""Image-to-video classes for the weights of text-to-video classes, where one checkpoint serves both."""
_WAN_WITH_IMAGE = "expand_timesteps"
"""Configuration of Wan checkpoints trained for text and images (Wan 2.2 TI2V); those for text only lack it."""
_FLOAT32_VAE = ("Wan", "SkyReelsV2", "Helios", "ChronoEdit")
"""Pipelines whose documentation keeps video and image encoders in float32: half precision is visible in the video."""
_COSMOS_PACKAGES = ("torchvision", "cosmos_guardrail")
"""Packages that pipelines of Cosmos import beside those of the extra; the guardrail is part of their licence."""
FRAME_COUNTS = ("num_frames", "frames")
"""Names of the argument for the number of frames."""
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
    """Load a checkpoint, a folder or an id on Hugging Face's hub, as an image-to-video pipeline.

    Args:
        dtype: precision of the weights; auto: bfloat16 on a GPU, else float32.
        device: device to run on; None: the GPU if there is one, else the CPU.

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
        kind = find_class(diffusers.DiffusionPipeline.load_config(source))
        exact = dict.fromkeys(("vae", "image_encoder"), torch.float32) if kind.__name__.startswith(_FLOAT32_VAE) else {}
        pipeline = kind.from_pretrained(source, dtype={"default": precision, **exact}, use_safetensors=True)
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

    Raises:
        SetupError: the weights cannot be loaded.
    """
    name = checkpoint_name(lora)
    folder = lora
    file = _LORA_FILE
    if lora.endswith(".safetensors"):
        folder, _, file = lora.rpartition("/")
        folder = folder or "."
    if Path(folder).is_dir() and not (Path(folder) / file).is_file():
        raise SetupError(f"the LoRA {name} is not there; expected a .safetensors file or a folder with {_LORA_FILE}")
    if not hasattr(pipeline, "load_lora_weights"):
        raise SetupError(f"{type(pipeline).__name__} takes no LoRA weights; leave out lora=")
    try:
        pipeline.load_lora_weights(folder, weight_name=file, use_safetensors=True, adapter_name=_ADAPTER)
        if _ADAPTER not in {adapter for adapters in pipeline.get_list_adapters().values() for adapter in adapters}:
            raise ValueError("it has no weights for the pipeline")
        pipeline.set_adapters([_ADAPTER], [scale])
    except (LookupError, OSError, ValueError, ImportError, RuntimeError) as error:
        reason = "its weights do not fit the pipeline" if isinstance(error, LookupError) else clean(error)
        raise SetupError(f"the LoRA {name} cannot be loaded: {reason}") from None


def checkpoint_name(source: str) -> str:
    """Return the name of a checkpoint in messages and results: the last part of a path, or an id of the hub."""
    parts = source.rstrip("/").split("/")
    is_path = Path(source).exists() or source.startswith((".", "/", "~")) or len(parts) != 2
    return parts[-1] if is_path else source


def arguments_of(kind: type) -> Mapping[str, inspect.Parameter]:
    """Return the arguments of a pipeline's call by name."""
    return inspect.signature(kind.__call__).parameters


def find_class(index: dict[str, Any]) -> Any:
    """Return the image-to-video class for a checkpoint; a ValueError says why there is none."""
    import diffusers

    name = str(index.get("_class_name"))  # a list names code in the checkpoint
    named = getattr(diffusers, name, None)
    if not isinstance(named, type) or not issubclass(named, diffusers.DiffusionPipeline):
        raise ValueError(f"its {_INDEX} names {name}, which is no pipeline of diffusers {diffusers.__version__}")
    for part, source in index.items():
        if isinstance(source, list | tuple) and len(source) == 2 and not _is_known(source[0]):
            raise ValueError(
                f"its {_INDEX} takes {part} from {source[0]}; expected parts of diffusers and transformers"
            )
    if name == "WanPipeline" and not index.get(_WAN_WITH_IMAGE):
        raise ValueError(f"it generates from text only ({name} without {_WAN_WITH_IMAGE}); expected image-to-video")
    kind = getattr(diffusers, IMAGE_TO_VIDEO.get(name, name))
    missing = [package for package in _COSMOS_PACKAGES if importlib.util.find_spec(package) is None]
    if name.startswith("Cosmos") and missing:  # found out only after the download otherwise
        raise ValueError(f"{name} needs {' and '.join(missing)}; pip install {' '.join(missing)}")
    arguments = arguments_of(kind)
    required = {key for key, value in arguments.items() if value.default is inspect.Parameter.empty}
    if "image" not in arguments or not {*FRAME_COUNTS} & {*arguments}:
        raise ValueError(f"its {_INDEX} names {name}, which does not generate frames from an image")
    if others := required - {"self", "image", "prompt", "args", "kwargs"}:
        raise ValueError(f"{name} needs more than an image and a prompt: {', '.join(sorted(others))}")
    return kind


def _is_known(library: object) -> bool:
    """Return whether a part's library is diffusers, one of its pipelines, transformers, or none: the part is absent.

    Code in a checkpoint is never run.
    """
    if library is None or library in ("diffusers", "transformers"):
        return True
    name = str(library)
    return name.isidentifier() and importlib.util.find_spec(f"diffusers.pipelines.{name}") is not None
