"""Local diffusers pipelines on tiny checkpoints with random weights."""

import importlib
import importlib.util
import json
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.suites.worldmodels import checkpoint as checkpoints
from kinebench_drake.suites.worldmodels.checkpoint import checkpoint_name
from kinebench_drake.suites.worldmodels.diffusers import DiffusersModel
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import Request
from tests.films import decoded

PACKAGES = ("diffusers", "transformers", "peft", "accelerate")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(None in map(importlib.util.find_spec, PACKAGES), reason="needs kinebench-drake[diffusers]"),
]


def tiny() -> ModuleType:
    """The checkpoints; loads these packages, which takes seconds that not every process of the tests has to spend."""
    return importlib.import_module("tests.suites.worldmodels.tiny")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Wan 2.1 checkpoint."""
    return tiny().wan(tmp_path_factory.mktemp("wan") / "Wan-tiny")


def make(folder: Path, request: Request, out: Path, options: str = "") -> np.ndarray:
    """Frames (T, H, W, 3) of a video made in one step, so that it is quick."""
    model = DiffusersModel(parse(f"diffusers:{folder}?steps=1&device=cpu{options}"))
    path = model.generate(request, out)
    model.close()
    assert list(out.parent.iterdir()) == [path]
    return decoded(path)[1]


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference of two videos in grey levels. Encoding such small ones may vary by less than one."""
    return float(np.abs(a.astype(int) - b).mean())


def test_wan_generates_the_requested_frames_reproducibly_by_seed(
    checkpoint: Path, request_: Request, out: Path
) -> None:
    """As many frames as asked for, though it can make 5, 9, 13; one seed gives one video."""
    first = make(checkpoint, replace(request_, num_frames=7), out)
    assert first.shape == (7, 64, 96, 3)
    assert difference(make(checkpoint, replace(request_, num_frames=7), out), first) < 1
    assert difference(make(checkpoint, replace(request_, num_frames=7, seed=1), out), first) > 3


def test_wan_2_2_with_two_networks_generates_the_requested_frames(tmp_path: Path, request_: Request, out: Path) -> None:
    assert make(tiny().wan(tmp_path / "wan", version="2.2"), request_, out, "&size=40x24").shape == (5, 64, 96, 3)


@pytest.mark.parametrize(
    ("save", "names", "loaded"),
    [
        (lambda folder: tiny().wan_5b(folder), "WanPipeline", "WanImageToVideoPipeline"),
        (
            lambda folder: tiny().skyreels(folder),
            "SkyReelsV2DiffusionForcingPipeline",
            "SkyReelsV2DiffusionForcingImageToVideoPipeline",
        ),
        (lambda folder: tiny().ltx(folder), "LTXPipeline", "LTXImageToVideoPipeline"),
        (lambda folder: tiny().ltx(folder, version="0.9.5"), "LTXConditionPipeline", "LTXConditionPipeline"),
        (lambda folder: tiny().hunyuan(folder), "HunyuanVideoImageToVideoPipeline", "HunyuanVideoImageToVideoPipeline"),
        (
            lambda folder: tiny().hunyuan(folder, version="33ch"),
            "HunyuanVideoImageToVideoPipeline",
            "HunyuanVideoImageToVideoPipeline",
        ),
    ],
)
def test_published_checkpoints_load_the_image_to_video_pipeline(
    save: Callable[[Path], Path], names: str, loaded: str, tmp_path: Path, request_: Request, out: Path
) -> None:
    """Whatever class the checkpoint names: it starts from the image, and has as many frames as asked for."""
    folder = save(tmp_path / "published")
    assert json.loads((folder / "model_index.json").read_text())["_class_name"] == names
    model = DiffusersModel(parse(f"diffusers:{folder}?steps=1&device=cpu"))
    asked = replace(request_, num_frames=7, prompt="stack", negative_prompt="")
    red = decoded(model.generate(asked, out))[1]
    assert type(model.pipeline).__name__ == loaded
    assert red.shape == (7, 64, 96, 3)
    assert not model.chooses_length
    blue = decoded(model.generate(replace(asked, first_frame=asked.first_frame[..., ::-1].copy()), out))[1]
    model.close()
    assert difference(red, blue) > 0.5, "the image makes no difference"


def test_svd_has_no_prompt_and_chooses_the_number_of_frames(tmp_path: Path, request_: Request, out: Path) -> None:
    """Arguments that its call does not take are refused by the option's name."""
    folder = tiny().svd(tmp_path / "svd")
    model = DiffusersModel(parse(f"diffusers:{folder}?steps=1&device=cpu"))
    assert decoded(model.generate(request_, out))[1].shape == (6, 64, 96, 3)
    assert model.chooses_length
    (tmp_path / "lora.safetensors").touch()
    for option, argument in (("guidance=2", "guidance_scale"), (f"lora={tmp_path}/lora.safetensors", "LoRA weights")):
        with pytest.raises(SetupError, match=f"StableVideoDiffusionPipeline takes no {argument}; leave out "):
            make(folder, request_, out.with_name("b"), f"&{option}")


def test_frames_of_the_frames_option_are_all_kept(checkpoint: Path, request_: Request, out: Path) -> None:
    assert make(checkpoint, request_, out, "&frames=12").shape == (13, 64, 96, 3)


@pytest.fixture
def guardrail(monkeypatch: pytest.MonkeyPatch) -> type:
    """Stand-ins for the two packages of Cosmos: a guardrail that passes everything, and torchvision's resize."""
    import torch
    from diffusers.models.transformers import transformer_cosmos
    from diffusers.pipelines.cosmos import pipeline_cosmos2_video2world

    class Guardrail:
        def to(self, device: object) -> "Guardrail":
            return self

        def check_text_safety(self, prompt: str) -> bool:
            return True

        def check_video_safety(self, video: np.ndarray) -> np.ndarray:
            return video

    def resize(image: torch.Tensor, size: list[int], interpolation: str) -> torch.Tensor:
        return torch.nn.functional.interpolate(image, size, mode=interpolation)

    stand_in = SimpleNamespace(
        functional=SimpleNamespace(resize=resize), InterpolationMode=SimpleNamespace(NEAREST="nearest")
    )
    for name in ("torchvision", "cosmos_guardrail"):
        package = ModuleType(name)
        package.__spec__ = ModuleSpec(name, None)
        monkeypatch.setitem(sys.modules, name, package)
    monkeypatch.setattr(transformer_cosmos, "transforms", stand_in, raising=False)
    monkeypatch.setattr(pipeline_cosmos2_video2world, "CosmosSafetyChecker", Guardrail)
    return Guardrail


def test_cosmos_generates_the_requested_frames_with_its_guardrail(
    guardrail: type, tmp_path: Path, request_: Request, out: Path
) -> None:
    """The guardrail is no part of the checkpoint: the pipeline brings its own."""
    folder = tiny().cosmos(tmp_path / "cosmos", guardrail())
    assert make(folder, replace(request_, num_frames=7), out).shape == (7, 64, 96, 3)


def test_cosmos_without_its_packages_is_a_setup_error(tmp_path: Path, request_: Request, out: Path) -> None:
    if any(importlib.util.find_spec(name) for name in ("torchvision", "cosmos_guardrail")):
        pytest.skip("they are installed")
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "model_index.json").write_text('{"_class_name": "Cosmos2VideoToWorldPipeline"}')
    with pytest.raises(SetupError, match="needs torchvision and cosmos_guardrail; pip install torchvision cosmos_"):
        make(tmp_path / "c", request_, out)


def test_every_pipeline_with_image_and_frames_is_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rule is the signature of the call; no list of names has to follow diffusers."""
    import diffusers

    monkeypatch.setattr(checkpoints, "_COSMOS_PACKAGES", ())
    accepted = set()
    for name in (name for name in dir(diffusers) if name.endswith("Pipeline")):
        with suppress(ValueError):
            accepted.add(checkpoints.find_class({"_class_name": name, "expand_timesteps": True}).__name__)
    assert {*checkpoints.IMAGE_TO_VIDEO.values()} <= accepted
    assert {"StableVideoDiffusionPipeline", "Kandinsky5I2VPipeline", "Cosmos2VideoToWorldPipeline"} <= accepted
    assert not {"WanAnimatePipeline", "CogVideoXPipeline", "HunyuanVideoPipeline", "FluxPipeline"} & accepted


def test_sizes_are_rounded_and_aspect_ratios_kept(checkpoint: Path, request_: Request, out: Path) -> None:
    """60x40 is done as 64x48, which is 4:3: stretched back to the first frame's 3:2. 48x32 is 3:2, and stays."""
    assert make(checkpoint, request_, out, "&size=60x40").shape == (5, 64, 96, 3)
    assert make(checkpoint, request_, out, "&size=48x32").shape == (5, 32, 48, 3)


def test_half_precision_gives_nearly_the_same_video(
    checkpoint: Path, tmp_path: Path, request_: Request, out: Path
) -> None:
    for folder in (checkpoint, tiny().cogvideox(tmp_path / "cog", learned=False)):
        exact, half = (make(folder, request_, out, f"&dtype={name}") for name in ("float32", "bfloat16"))
        assert difference(exact, half) < 10


@pytest.mark.parametrize(("learned", "shape"), [(True, (9, 64, 96, 3)), (False, (13, 64, 96, 3))])
def test_cogvideox_with_learned_positions_has_a_greatest_length(
    learned: bool, shape: tuple[int, ...], tmp_path: Path, request_: Request, out: Path
) -> None:
    """Learned positions fix size and greatest length."""
    folder = tiny().cogvideox(tmp_path / "cog", learned=learned)
    assert make(folder, replace(request_, num_frames=13), out, "&guidance=1").shape == shape


def test_lora_changes_the_video(checkpoint: Path, tmp_path: Path, request_: Request, out: Path) -> None:
    import torch
    from safetensors.torch import save_file

    names = [f"transformer.blocks.0.attn1.to_{part}" for part in "qkv"]
    weights = {f"{name}.lora_A.weight": torch.ones(2, 24) for name in names}
    weights |= {f"{name}.lora_B.weight": torch.ones(24, 2) for name in names}
    (tmp_path / "lora").mkdir()
    file = tmp_path / "lora" / "pytorch_lora_weights.safetensors"
    save_file(weights, file)
    plain = make(checkpoint, request_, out)
    by_file = make(checkpoint, request_, out, f"&lora={file}")
    assert difference(by_file, plain) > 3
    assert difference(make(checkpoint, request_, out, f"&lora={tmp_path}/lora"), by_file) < 1
    assert difference(make(checkpoint, request_, out, f"&lora={file}&lora_scale=0"), plain) < 1
    save_file({"transformer.nothing.lora_A.weight": torch.ones(2, 24)}, file)
    for options, message in ((f"&lora={file}", "cannot be loaded"), (f"&lora={tmp_path}", "is not there")):
        with pytest.raises(SetupError, match=f"the LoRA .* {message}"):
            make(checkpoint, request_, out, options)


def test_only_safetensors_and_code_of_diffusers_are_loaded(
    checkpoint: Path, tmp_path: Path, request_: Request, out: Path
) -> None:
    index = json.loads((checkpoint / "model_index.json").read_text())
    for change, message in (
        ({"_class_name": "CogVideoXPipeline"}, "names CogVideoXPipeline, which does not generate frames from an"),
        ({"_class_name": "NoSuchPipeline"}, "names NoSuchPipeline, which is no pipeline of diffusers"),
        ({"_class_name": "WanPipeline"}, "generates from text only .WanPipeline without expand_timesteps."),
        ({"_class_name": ["mine", "Pipeline"]}, "names"),
        ({"vae": ["os", "system"]}, "takes vae from os; expected parts of diffusers and transformers"),
        ({"vae": ["my_vae", "Vae"]}, "takes vae from my_vae; expected parts of diffusers and transformers"),
    ):
        shutil.copytree(checkpoint, tmp_path / "a", dirs_exist_ok=True)
        (tmp_path / "a" / "model_index.json").write_text(json.dumps(index | change))
        (tmp_path / "a" / "my_vae.py").write_text("raise SystemExit")
        with pytest.raises(SetupError, match=f"the checkpoint a cannot be loaded: .*{message}"):
            make(tmp_path / "a", request_, out)
    for part, name in (("vae", "diffusion_pytorch_model"), ("text_encoder", "model")):
        folder = tmp_path / f"without-{part}"
        shutil.copytree(checkpoint, folder)
        weights = folder / part / f"{name}.safetensors"
        weights.rename(weights.with_name(f"{name if part == 'vae' else 'pytorch_model'}.bin"))
        with pytest.raises(SetupError, match="cannot be loaded"):
            make(folder, request_, out)
    assert list(out.parent.iterdir()) == []


def test_model_names_contain_no_paths(checkpoint: Path) -> None:
    assert DiffusersModel(parse(f"diffusers:{checkpoint}")).name == "Wan-tiny"
    assert DiffusersModel(parse(f"diffusers:{checkpoint}?lora=/a/b/c.safetensors")).name == "Wan-tiny+c.safetensors"
    assert checkpoint_name("Wan-AI/Wan2.1") == "Wan-AI/Wan2.1"
    assert checkpoint_name("/home/me/") == "me"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("diffusers:", "expected diffusers:PATH_OR_ID"),
        ("diffusers:/no/such/folder", "there is no folder /no/such/folder"),
        ("diffusers:a/b?size=1280", "size=1280"),
        ("diffusers:a/b?dtype=int8", "dtype=int8"),
        ("diffusers:a/b?steps=0", "steps=0"),
    ],
)
def test_unusable_diffusers_specs_are_usage_errors(spec: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        DiffusersModel(parse(spec))
