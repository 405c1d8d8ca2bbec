"""Depth of other programs: input, output, and errors when they are missing."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.grounding.overrides.overrides import DepthPlugIn

EXAMPLE = Path(__file__).parents[3] / "examples" / "moge_depth.py"
FRAMES = np.random.default_rng(0).integers(0, 255, (3, 48, 64, 3), dtype=np.uint8)

CLASS = """
import numpy as np

class Red:
    def depth(self, frames, camera):
        assert frames.shape[1:3] == (camera.height, camera.width)
        return 0.5 + frames[..., 0] / np.float32(255)

class Disparity:
    def depth(self, frames, camera):
        return 1000.0 / (1 + frames[..., 0])

class NeedsArguments:
    def __init__(self, device):
        pass
    def depth(self, frames, camera):
        pass

class NoMethod:
    pass
"""


@pytest.fixture(autouse=True)
def _loaded_anew() -> Iterator[None]:
    DepthPlugIn.load.cache_clear()
    before = list(sys.path)
    yield
    DepthPlugIn.load.cache_clear()
    sys.path[:] = before
    sys.modules.pop("a_depth_of_mine", None)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a module."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a_depth_of_mine.py").write_text(CLASS)
    return tmp_path


@pytest.fixture
def camera() -> Camera:
    return Camera(width=64, height=48, fx=64.0, fy=64.0, cx=32.0, cy=24.0, X_BC=benchmark_camera().X_BC)


def test_a_depth_class_is_loaded_from_the_working_directory(here: Path, camera: Camera) -> None:
    depth = DepthPlugIn("a_depth_of_mine:Red").estimate(FRAMES, camera)
    np.testing.assert_allclose(depth.depth_m, 0.5 + FRAMES[..., 0] / 255, atol=1e-6)
    assert not depth.exact
    assert DepthPlugIn("a_depth_of_mine:Red").files == [here / "a_depth_of_mine.py"]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("no_such_module:Depth", "no module 'no_such_module'.*working directory"),
        ("a_depth_of_mine:Blue", "has no Blue"),
        ("a_depth_of_mine:NoMethod", "method depth"),
        ("a_depth_of_mine:np", "method depth"),
        ("nowhere", "module:Class"),
    ],
)
def test_missing_and_invalid_depth_plug_ins_are_refused_on_check(spec: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        DepthPlugIn(spec).load_class()


@pytest.mark.usefixtures("here")
def test_failing_constructors_and_depth_in_another_unit_are_reported(camera: Camera) -> None:
    with pytest.raises(SetupError, match=r"NeedsArguments.*device"):
        DepthPlugIn("a_depth_of_mine:NeedsArguments").estimate(FRAMES, camera)
    with pytest.raises(InputError, match="another unit"):
        DepthPlugIn("a_depth_of_mine:Disparity").estimate(np.zeros_like(FRAMES), camera)


class FakeMoge:
    """Stand-in for MoGe: depth is the red channel in metres; dark pixels are sky."""

    def __init__(self, checkpoint: str) -> None:
        self.checkpoint = checkpoint
        self.device = ""
        self.asked = list[SimpleNamespace]()

    def to(self, device: str) -> "FakeMoge":
        self.device = device
        return self

    def eval(self) -> "FakeMoge":
        return self

    def infer(self, image: torch.Tensor, *, fov_x: float, use_fp16: bool) -> dict[str, torch.Tensor]:
        self.asked.append(SimpleNamespace(image=image, fov_x=fov_x, use_fp16=use_fp16))
        return {"depth": torch.where(image[0] > 0.2, image[0], torch.inf)}


@pytest.fixture
def moge(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Makes a package moge that can be imported."""

    def install() -> None:
        module = ModuleType("moge.model.v2")
        module.MoGeModel = SimpleNamespace(from_pretrained=FakeMoge)  # type: ignore[attr-defined]
        for name, value in {
            "moge": ModuleType("moge"),
            "moge.model": ModuleType("moge.model"),
            module.__name__: module,
        }.items():
            monkeypatch.setitem(sys.modules, name, value)

    return install


def test_the_example_runs_moge_with_the_cameras_field_of_view(
    moge: Callable[[], None], tmp_path: Path, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = tmp_path / "model.pt"
    monkeypatch.setenv("MOGE_CHECKPOINT", str(checkpoint))
    plug_in = DepthPlugIn(f"{EXAMPLE}:MogeDepth")
    with pytest.raises(UsageError, match="there is no module 'moge'"):
        plug_in.load_class()
    moge()
    depth = plug_in.estimate(FRAMES, camera)
    red = FRAMES[..., 0] / 255
    np.testing.assert_allclose(depth.depth_m, np.where(red > 0.2, red, 0.0), atol=1e-6)
    assert not depth.exact
    model = plug_in.load()._model  # type: ignore[attr-defined]
    assert model.checkpoint == str(checkpoint)
    assert [a.image.shape for a in model.asked] == [(3, 48, 64)] * 3
    assert [a.fov_x for a in model.asked] == pytest.approx([np.degrees(2 * np.arctan(0.5))] * 3)
    assert plug_in.files == [EXAMPLE]
