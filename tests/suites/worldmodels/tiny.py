"""Image-to-video checkpoints that are as small as can be, with weights drawn at random."""

from pathlib import Path
from typing import Any

import torch
from diffusers import (
    AutoencoderKLCogVideoX,
    AutoencoderKLWan,
    CogVideoXDDIMScheduler,
    CogVideoXImageToVideoPipeline,
    CogVideoXTransformer3DModel,
    FlowMatchEulerDiscreteScheduler,
    WanImageToVideoPipeline,
    WanTransformer3DModel,
)
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.pre_tokenizers import Whitespace
from transformers import (
    CLIPImageProcessor,
    CLIPVisionConfig,
    CLIPVisionModel,
    PreTrainedTokenizerFast,
    T5Config,
    T5EncoderModel,
    UMT5Config,
    UMT5EncoderModel,
)

_WIDTH = 32
"""Numbers that stand for a word."""


def _tokenizer() -> PreTrainedTokenizerFast:
    tokenizer = Tokenizer(WordLevel({"<pad>": 0, "</s>": 1, "<unk>": 2, "stack": 3}, unk_token="<unk>"))
    tokenizer.pre_tokenizer = Whitespace()
    return PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, pad_token="<pad>", eos_token="</s>", unk_token="<unk>", model_max_length=16
    )


def _words(kind: type, config: type) -> Any:
    sizes = {"d_model": _WIDTH, "d_kv": 8, "d_ff": 16, "num_layers": 1, "num_heads": 2, "vocab_size": 8}
    return kind(config(**sizes)).eval()


def _wan_network(in_channels: int, out_channels: int, image_dim: int | None) -> WanTransformer3DModel:
    return WanTransformer3DModel(
        patch_size=(1, 2, 2),
        num_attention_heads=2,
        attention_head_dim=12,
        in_channels=in_channels,
        out_channels=out_channels,
        text_dim=_WIDTH,
        freq_dim=16,
        ffn_dim=16,
        num_layers=1,
        cross_attn_norm=True,
        rope_max_seq_len=32,
        image_dim=image_dim,
        added_kv_proj_dim=24 if image_dim else None,
    )


def wan(folder: Path, *, version: str = "2.1") -> Path:
    """Wan 2.1 (a picture encoder), 2.2 (two networks) or 2.2-5B (the first frame in the latents)."""
    torch.manual_seed(0)
    parts: dict[str, Any] = {
        "tokenizer": _tokenizer(),
        "text_encoder": _words(UMT5EncoderModel, UMT5Config),
        "vae": AutoencoderKLWan(
            base_dim=4,
            z_dim=16,
            dim_mult=[1, 1, 1, 1],
            num_res_blocks=1,
            temperal_downsample=[False, True, True],
        ),
        "scheduler": FlowMatchEulerDiscreteScheduler(shift=3.0),
        "image_encoder": None,
        "image_processor": None,
    }
    if version == "2.1":
        sizes = {"hidden_size": 4, "projection_dim": 4, "num_hidden_layers": 2, "num_attention_heads": 2}
        vision = CLIPVisionConfig(**sizes, image_size=16, intermediate_size=8, patch_size=8)
        parts["image_encoder"] = CLIPVisionModel(vision).eval()
        parts["image_processor"] = CLIPImageProcessor(size={"shortest_edge": 16}, crop_size=16)
        parts["transformer"] = _wan_network(36, 16, 4)
    elif version == "2.2":
        parts |= {"transformer": _wan_network(36, 16, None), "transformer_2": _wan_network(36, 16, None)}
        parts["boundary_ratio"] = 0.5
    else:
        parts |= {"transformer": _wan_network(16, 16, None), "expand_timesteps": True}
    WanImageToVideoPipeline(**parts).save_pretrained(folder)
    return folder


def cogvideox(folder: Path, *, learned: bool) -> Path:
    """CogVideoX; with learned positions as the 5b-I2V of 720x480 has them, here of 32x16 and 9 frames."""
    torch.manual_seed(0)
    CogVideoXImageToVideoPipeline(
        tokenizer=_tokenizer(),
        text_encoder=_words(T5EncoderModel, T5Config),
        vae=AutoencoderKLCogVideoX(
            down_block_types=("CogVideoXDownBlock3D",) * 4,
            up_block_types=("CogVideoXUpBlock3D",) * 4,
            block_out_channels=(8, 8, 8, 8),
            latent_channels=4,
            layers_per_block=1,
            norm_num_groups=2,
            temporal_compression_ratio=4,
        ),
        transformer=CogVideoXTransformer3DModel(
            num_attention_heads=2,
            attention_head_dim=16,
            in_channels=8,
            out_channels=4,
            time_embed_dim=2,
            text_embed_dim=_WIDTH,
            num_layers=1,
            sample_width=4,
            sample_height=2,
            sample_frames=9,
            patch_size=2,
            temporal_compression_ratio=4,
            max_text_seq_length=226,
            use_rotary_positional_embeddings=True,
            use_learned_positional_embeddings=learned,
        ),
        scheduler=CogVideoXDDIMScheduler(),
    ).save_pretrained(folder)
    return folder
