"""Local pipelines, tiny ones; what Wan and CogVideoX make of numbers they were never trained for does not matter."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.suites.worldmodels.diffusers import DiffusersModel, checkpoint_name
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import Request
from tests.films import decoded

for package in ("diffusers", "transformers", "peft", "accelerate"):
    pytest.importorskip(package, reason="needs kinebench-drake[diffusers]")

tiny = pytest.importorskip("tests.suites.worldmodels.tiny")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Wan 2.1 checkpoint."""
    return tiny.wan(tmp_path_factory.mktemp("wan") / "Wan-tiny")


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


def test_wan(checkpoint: Path, request_: Request, out: Path) -> None:
    """As many frames as asked for, though it can make 5, 9, 13; one seed gives one video."""
    first = make(checkpoint, replace(request_, num_frames=7), out)
    assert first.shape == (7, 64, 96, 3)
    assert difference(make(checkpoint, replace(request_, num_frames=7), out), first) < 1
    assert difference(make(checkpoint, replace(request_, num_frames=7, seed=1), out), first) > 3


@pytest.mark.parametrize("version", ["2.2", "2.2-5B"])
def test_wan_of_other_kinds(version: str, tmp_path: Path, request_: Request, out: Path) -> None:
    assert make(tiny.wan(tmp_path / "wan", version=version), request_, out, "&size=40x24").shape == (5, 64, 96, 3)


def test_sizes_are_rounded_and_shapes_kept(checkpoint: Path, request_: Request, out: Path) -> None:
    """60x40 is done as 64x48, which is 4:3: stretched back to the first frame's 3:2. 48x32 is 3:2, and stays."""
    assert make(checkpoint, request_, out, "&size=60x40").shape == (5, 64, 96, 3)
    assert make(checkpoint, request_, out, "&size=48x32").shape == (5, 32, 48, 3)


def test_half_precision_is_nearly_the_same(checkpoint: Path, tmp_path: Path, request_: Request, out: Path) -> None:
    for folder in (checkpoint, tiny.cogvideox(tmp_path / "cog", learned=False)):
        exact, half = (make(folder, request_, out, f"&dtype={name}") for name in ("float32", "bfloat16"))
        assert difference(exact, half) < 10


@pytest.mark.parametrize(("learned", "shape"), [(True, (9, 64, 96, 3)), (False, (13, 64, 96, 3))])
def test_cogvideox(learned: bool, shape: tuple[int, ...], tmp_path: Path, request_: Request, out: Path) -> None:
    """Learned positions fix size and greatest length."""
    folder = tiny.cogvideox(tmp_path / "cog", learned=learned)
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


def test_only_safetensors_and_known_code_are_loaded(
    checkpoint: Path, tmp_path: Path, request_: Request, out: Path
) -> None:
    index = json.loads((checkpoint / "model_index.json").read_text())
    for change, message in (
        (
            {"_class_name": "StableDiffusionPipeline"},
            "names StableDiffusionPipeline; expected WanImageToVideoPipeline or",
        ),
        ({"_class_name": ["mine", "Pipeline"]}, "names"),
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


def test_names_hold_no_paths(checkpoint: Path) -> None:
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
def test_specs_that_cannot_be_used(spec: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        DiffusersModel(parse(spec))
