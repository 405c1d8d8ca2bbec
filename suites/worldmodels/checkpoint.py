"""Image-to-video checkpoints for Hugging Face's diffusers: looked at, then loaded. Weights are safetensors only.

Pipelines: https://huggingface.co/docs/diffusers/api/pipelines/wan and .../api/pipelines/cogvideox
"""

from pathlib import Path
from typing import Any, Literal

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.remark import remark

_WAN = "WanImageToVideoPipeline"
PIPELINES = (_WAN, "CogVideoXImageToVideoPipeline")
"""Classes of pipelines that a checkpoint may name: Wan 2.1 and 2.2, CogVideoX."""
_LIBRARIES = ("diffusers", "transformers", None)
"""Where the parts of a pipeline may come from; None: the part is left out. A checkpoint brings no code of its own."""
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
    """The pipeline of a checkpoint, ready to run.

    Args:
        source: a folder, or an id on Hugging Face's hub.
        dtype: of the weights; auto: bfloat16 on a GPU, else float32.
        device: where it runs; the GPU if not given, else the CPU.
        offload: what is kept in main memory till it is needed.

    Raises:
        SetupError: diffusers is not installed, or the checkpoint is none of the known kinds or cannot be loaded.
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
        # Wan's manual keeps these two exact: half of their precision is seen in the pictures.
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
        raise SetupError(f"the checkpoint {shown(source)} cannot be loaded: {remark(str(error))}") from None
    pipeline.set_progress_bar_config(disable=True)
    return pipeline


def add_lora(pipeline: Any, lora: str, scale: float) -> None:
    """Put LoRA weights on a pipeline.

    Args:
        pipeline: of `load_pipeline`.
        lora: a .safetensors file, a folder with the file that diffusers' trainers write, or ORG/NAME[/FILE] on the hub.
        scale: their strength.

    Raises:
        SetupError: they cannot be loaded.
    """
    folder, file = lora, _LORA_FILE
    if lora.endswith(".safetensors"):
        folder, _, file = lora.rpartition("/")
        folder = folder or "."
    if Path(folder).is_dir() and not (Path(folder) / file).is_file():
        raise SetupError(
            f"the LoRA {shown(lora)} is not there; expected a .safetensors file or a folder with {_LORA_FILE}"
        )
    try:
        pipeline.load_lora_weights(folder, weight_name=file, use_safetensors=True, adapter_name=_ADAPTER)
        if _ADAPTER not in {name for names in pipeline.get_list_adapters().values() for name in names}:
            raise ValueError("it has no weights for the pipeline")
        pipeline.set_adapters([_ADAPTER], [scale])
    except LookupError:
        raise SetupError(f"the LoRA {shown(lora)} cannot be loaded: its weights do not fit the pipeline") from None
    except (OSError, ValueError, ImportError, RuntimeError) as error:
        raise SetupError(f"the LoRA {shown(lora)} cannot be loaded: {remark(str(error))}") from None


def shown(source: str) -> str:
    """A checkpoint as messages and results call it: a path by its last name, an id of the hub as it is."""
    parts = source.rstrip("/").split("/")
    is_path = Path(source).exists() or source.startswith((".", "/", "~")) or len(parts) != 2
    return parts[-1] if is_path else source


def _kind(index: dict[str, Any]) -> str:
    """Name of the pipeline's class.

    Raises:
        ValueError: it is not one of ours, or the checkpoint wants to bring code.
    """
    kind = index.get("_class_name")
    if kind not in PIPELINES:
        raise ValueError(f"its {_INDEX} names {kind}; expected {' or '.join(PIPELINES)}")
    for name, part in index.items():
        if isinstance(part, list | tuple) and len(part) == 2 and part[0] not in _LIBRARIES:
            raise ValueError(f"its {_INDEX} takes {name} from {part[0]}; expected parts of diffusers and transformers")
    return str(kind)
