"""Image-to-video checkpoints that are as small as can be, with weights drawn at random.

Each is saved as its publisher saves it: by the class that the published model_index.json names.
"""

from pathlib import Path
from typing import Any

import torch
from diffusers import (
    AutoencoderKLCogVideoX,
    AutoencoderKLHunyuanVideo,
    AutoencoderKLLTXVideo,
    AutoencoderKLTemporalDecoder,
    AutoencoderKLWan,
    CogVideoXDDIMScheduler,
    CogVideoXImageToVideoPipeline,
    CogVideoXTransformer3DModel,
    Cosmos2VideoToWorldPipeline,
    CosmosTransformer3DModel,
    DiffusionPipeline,
    EulerDiscreteScheduler,
    FlowMatchEulerDiscreteScheduler,
    HunyuanVideoImageToVideoPipeline,
    HunyuanVideoTransformer3DModel,
    LTXConditionPipeline,
    LTXPipeline,
    LTXVideoTransformer3DModel,
    SkyReelsV2DiffusionForcingPipeline,
    SkyReelsV2Transformer3DModel,
    StableVideoDiffusionPipeline,
    UNetSpatioTemporalConditionModel,
    UniPCMultistepScheduler,
    WanImageToVideoPipeline,
    WanPipeline,
    WanTransformer3DModel,
)
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.pre_tokenizers import Whitespace
from transformers import (
    CLIPImageProcessor,
    CLIPTextConfig,
    CLIPTextModel,
    CLIPVisionConfig,
    CLIPVisionModel,
    CLIPVisionModelWithProjection,
    LlamaConfig,
    LlavaConfig,
    LlavaForConditionalGeneration,
    PreTrainedTokenizerFast,
    T5Config,
    T5EncoderModel,
    UMT5Config,
    UMT5EncoderModel,
)

_WIDTH = 32
"""Numbers that stand for a word."""


def _tokenizer(*specials: str) -> PreTrainedTokenizerFast:
    tokenizer = Tokenizer(WordLevel({"<pad>": 0, "</s>": 1, "<unk>": 2, "stack": 3}, unk_token="<unk>"))
    tokenizer.pre_tokenizer = Whitespace()
    names = {"pad_token": "<pad>", "eos_token": "</s>", "unk_token": "<unk>", "additional_special_tokens": [*specials]}
    return PreTrainedTokenizerFast(tokenizer_object=tokenizer, model_max_length=16, **names)


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


def _wan_vae(**changes: Any) -> AutoencoderKLWan:
    sizes = {"base_dim": 4, "z_dim": 16, "dim_mult": [1, 1, 1, 1], "num_res_blocks": 1}
    return AutoencoderKLWan(**{**sizes, "temperal_downsample": [False, True, True], **changes})


def _t5() -> dict[str, Any]:
    return {"tokenizer": _tokenizer(), "text_encoder": _words(T5EncoderModel, T5Config)}


def _save(pipeline: DiffusionPipeline, folder: Path) -> Path:
    pipeline.save_pretrained(folder)
    return folder


def wan(folder: Path, *, version: str = "2.1") -> Path:
    """Wan-AI/Wan2.1-I2V-14B (a picture encoder), Wan2.2-I2V-A14B (two networks) or Wan2.1-T2V (no pictures)."""
    torch.manual_seed(0)
    words = {"tokenizer": _tokenizer(), "text_encoder": _words(UMT5EncoderModel, UMT5Config)}
    parts: dict[str, Any] = {**words, "vae": _wan_vae(), "scheduler": UniPCMultistepScheduler()}
    if version == "T2V":
        return _save(WanPipeline(**parts, transformer=_wan_network(16, 16, None)), folder)
    parts |= {"image_encoder": None, "image_processor": None}
    if version == "2.1":
        sizes = {"hidden_size": 4, "projection_dim": 4, "num_hidden_layers": 2, "num_attention_heads": 2}
        vision = CLIPVisionConfig(**sizes, image_size=16, intermediate_size=8, patch_size=8)
        parts["image_encoder"] = CLIPVisionModel(vision).eval()
        parts["image_processor"] = CLIPImageProcessor(size={"shortest_edge": 16}, crop_size=16)
        parts["transformer"] = _wan_network(36, 16, 4)
    else:
        parts |= {"transformer": _wan_network(36, 16, None), "transformer_2": _wan_network(36, 16, None)}
        parts["boundary_ratio"] = 0.9
    return _save(WanImageToVideoPipeline(**parts), folder)


def wan_5b(folder: Path) -> Path:
    """Wan-AI/Wan2.2-TI2V-5B: text or image in one network, latents of 16 px; it names the text pipeline."""
    torch.manual_seed(0)
    latents = {"z_dim": 48, "latents_mean": [0.0] * 48, "latents_std": [1.0] * 48, "scale_factor_spatial": 16}
    pipeline = WanPipeline(
        tokenizer=_tokenizer(),
        text_encoder=_words(UMT5EncoderModel, UMT5Config),
        vae=_wan_vae(**latents, in_channels=12, out_channels=12, is_residual=True, patch_size=2),
        scheduler=UniPCMultistepScheduler(),
        transformer=_wan_network(48, 48, None),
        expand_timesteps=True,
    )
    return _save(pipeline, folder)


def skyreels(folder: Path) -> Path:
    """Skywork/SkyReels-V2-DF-1.3B: diffusion forcing, text or image in one network."""
    torch.manual_seed(0)
    network = SkyReelsV2Transformer3DModel(
        patch_size=(1, 2, 2),
        num_attention_heads=2,
        attention_head_dim=12,
        in_channels=16,
        out_channels=16,
        text_dim=_WIDTH,
        freq_dim=16,
        ffn_dim=16,
        num_layers=1,
        rope_max_seq_len=32,
    )
    pipeline = SkyReelsV2DiffusionForcingPipeline(
        tokenizer=_tokenizer(),
        text_encoder=_words(UMT5EncoderModel, UMT5Config),
        transformer=network,
        vae=_wan_vae(),
        scheduler=UniPCMultistepScheduler(flow_shift=8.0, use_flow_sigmas=True),
    )
    return _save(pipeline, folder)


def cogvideox(folder: Path, *, learned: bool) -> Path:
    """THUDM/CogVideoX-5b-I2V, with learned positions for one size, here 32x16 and 9 frames; CogVideoX1.5 without."""
    torch.manual_seed(0)
    sizes = {"sample_width": 4, "sample_height": 2}
    newer = {"sample_width": 12, "sample_height": 8, "patch_size_t": 2, "patch_bias": False, "ofs_embed_dim": 2}
    pipeline = CogVideoXImageToVideoPipeline(
        **_t5(),
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
            sample_frames=9,
            patch_size=2,
            temporal_compression_ratio=4,
            max_text_seq_length=226,
            use_rotary_positional_embeddings=True,
            use_learned_positional_embeddings=learned,
            **(sizes if learned else newer),
        ),
        scheduler=CogVideoXDDIMScheduler(),
    )
    return _save(pipeline, folder)


def ltx(folder: Path, *, version: str = "0.9") -> Path:
    """Lightricks/LTX-Video, which names the text pipeline, or LTX-Video-0.9.5, which names the one with conditions."""
    torch.manual_seed(0)
    vae = AutoencoderKLLTXVideo(
        latent_channels=8,
        block_out_channels=(8, 8, 8, 8),
        decoder_block_out_channels=(8, 8, 8, 8),
        layers_per_block=(1, 1, 1, 1, 1),
        decoder_layers_per_block=(1, 1, 1, 1, 1),
    )
    network = LTXVideoTransformer3DModel(
        in_channels=8,
        out_channels=8,
        num_attention_heads=4,
        attention_head_dim=8,
        cross_attention_dim=32,
        num_layers=1,
        caption_channels=_WIDTH,
    )
    kind = LTXPipeline if version == "0.9" else LTXConditionPipeline
    return _save(kind(**_t5(), vae=vae, transformer=network, scheduler=FlowMatchEulerDiscreteScheduler()), folder)


def cosmos(folder: Path, guardrail: Any) -> Path:
    """nvidia/Cosmos-Predict2-2B-Video2World, whose guardrail is a package and not part of the checkpoint."""
    torch.manual_seed(0)
    network = CosmosTransformer3DModel(
        in_channels=17,
        out_channels=16,
        num_attention_heads=2,
        attention_head_dim=16,
        num_layers=1,
        mlp_ratio=2,
        text_embed_dim=_WIDTH,
        adaln_lora_dim=4,
        max_size=(4, 32, 32),
    )
    scheduler = FlowMatchEulerDiscreteScheduler(use_karras_sigmas=True)
    pipeline = Cosmos2VideoToWorldPipeline(
        **_t5(), transformer=network, vae=_wan_vae(), scheduler=scheduler, safety_checker=guardrail
    )
    pipeline.register_modules(safety_checker=None)
    return _save(pipeline, folder)


def hunyuan(folder: Path, *, version: str = "16ch") -> Path:
    """hunyuanvideo-community/HunyuanVideo-I2V (image as first latent) or -I2V-33ch (image beside the latents)."""
    torch.manual_seed(0)
    network = HunyuanVideoTransformer3DModel(
        in_channels=4 if version == "16ch" else 9,
        out_channels=4,
        num_attention_heads=2,
        attention_head_dim=10,
        num_layers=1,
        num_single_layers=1,
        num_refiner_layers=1,
        guidance_embeds=version == "16ch",
        text_embed_dim=16,
        pooled_projection_dim=8,
        rope_axes_dim=(2, 4, 4),
        image_condition_type="token_replace" if version == "16ch" else "latent_concat",
    )
    vae = AutoencoderKLHunyuanVideo(
        latent_channels=4, block_out_channels=(8, 8, 8, 8), layers_per_block=1, norm_num_groups=4
    )
    words = {"num_attention_heads": 2, "num_hidden_layers": 3, "intermediate_size": 8, "vocab_size": 16}
    eyes = {"num_attention_heads": 2, "num_hidden_layers": 2, "intermediate_size": 8}
    tokenizer = _tokenizer("<image>", "<|end_header_id|>")
    llava = LlavaConfig(
        text_config=LlamaConfig(hidden_size=16, pad_token_id=0, **words),
        vision_config=CLIPVisionConfig(hidden_size=8, image_size=336, patch_size=14, **eyes),
        pad_token_id=0,
        image_token_index=tokenizer.convert_tokens_to_ids("<image>"),
    )
    pipeline = HunyuanVideoImageToVideoPipeline(
        text_encoder=LlavaForConditionalGeneration(llava).eval(),
        tokenizer=tokenizer,
        transformer=network,
        vae=vae,
        scheduler=FlowMatchEulerDiscreteScheduler(shift=7.0),
        text_encoder_2=CLIPTextModel(CLIPTextConfig(hidden_size=8, eos_token_id=1, **words)).eval(),
        tokenizer_2=_tokenizer(),
        image_processor=CLIPImageProcessor(size={"shortest_edge": 336}, crop_size=336),
    )
    return _save(pipeline, folder)


def svd(folder: Path) -> Path:
    """stabilityai/stable-video-diffusion-img2vid: no prompt, trained for one number of frames, here 6."""
    torch.manual_seed(0)
    vision = {"hidden_size": 32, "projection_dim": 32, "num_hidden_layers": 1, "num_attention_heads": 2}
    pipeline = StableVideoDiffusionPipeline(
        vae=AutoencoderKLTemporalDecoder(
            down_block_types=("DownEncoderBlock2D",) * 4, block_out_channels=(32, 32, 32, 32)
        ),
        image_encoder=CLIPVisionModelWithProjection(
            CLIPVisionConfig(**vision, intermediate_size=16, image_size=224, patch_size=32)
        ).eval(),
        unet=UNetSpatioTemporalConditionModel(
            block_out_channels=(32, 64),
            layers_per_block=1,
            down_block_types=("CrossAttnDownBlockSpatioTemporal", "DownBlockSpatioTemporal"),
            up_block_types=("UpBlockSpatioTemporal", "CrossAttnUpBlockSpatioTemporal"),
            cross_attention_dim=32,
            num_attention_heads=2,
            projection_class_embeddings_input_dim=96,
            addition_time_embed_dim=32,
            num_frames=6,
        ),
        scheduler=EulerDiscreteScheduler(prediction_type="v_prediction", timestep_type="continuous", sigma_min=0.002),
        feature_extractor=CLIPImageProcessor(size={"shortest_edge": 224}, crop_size=224),
    )
    return _save(pipeline, folder)
