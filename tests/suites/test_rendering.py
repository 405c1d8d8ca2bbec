"""Rendering by a software driver: the same images by other shaders, nearly the same with a simplified arm."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.environment.native import RENDER_VARIABLE, has_nvidia_vulkan
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.simulator import CameraImage, Simulator, Snapshot

TASK = "PullCube-v1"
_ENVIRONMENT = "kinebench_drake.suites.scene.environment"


@pytest.fixture(scope="module")
def states() -> Sequence[Snapshot]:
    with Simulator(TASK, renders=False) as simulator:
        return run_expert(simulator, find_expert(TASK), compose(TASK, 0)).snapshots[::12]


def _images(states: Sequence[Snapshot]) -> tuple[int, list[CameraImage]]:
    """Return the number of the robot's triangles, and images of states."""
    import sapien

    with Simulator(TASK) as simulator:
        simulator.reset(compose(TASK, 0))
        links = (link._objs[0].entity for link in simulator.env.agent.robot.links_map.values())
        bodies = (link.find_component_by_type(sapien.render.RenderBodyComponent) for link in links)
        shapes = (shape for body in bodies if body is not None for shape in body.render_shapes)
        count = sum(len(part.triangles) for shape in shapes for part in shape.parts)
        images = []
        for state in states:
            simulator.set_snapshot(state)
            images.append(simulator.render())
        return count, images


@pytest.mark.sapien
def test_software_shaders_render_bit_equal_to_maniskills(
    states: Sequence[Snapshot], monkeypatch: pytest.MonkeyPatch
) -> None:
    from kinebench_drake.suites.scene.rendering import software_shaders

    folder = Path(software_shaders().shader_pack)
    assert "IBL(f" not in (folder / "gbuffer.frag").read_text()
    assert "y += 2" in (folder.parent / "common" / "shadow.glsl").read_text()
    _, images = _images(states)
    monkeypatch.setattr(f"{_ENVIRONMENT}.software_shaders", lambda: None)
    _, own = _images(states)
    assert len(images) >= 4
    for image, other in zip(images, own, strict=True):
        np.testing.assert_array_equal(image.rgb, other.rgb)
        np.testing.assert_array_equal(image.depth_mm, other.depth_mm)


@pytest.mark.sapien
def test_the_simplified_arm_renders_nearly_equal_images(
    states: Sequence[Snapshot], monkeypatch: pytest.MonkeyPatch
) -> None:
    count, images = _images(states)
    monkeypatch.setattr(f"{_ENVIRONMENT}.simplify_arm", lambda robot: None)
    full_count, full_images = _images(states)
    assert count < 0.32 * full_count
    for image, full in zip(images, full_images, strict=True):
        difference = np.abs(image.rgb.astype(int) - full.rgb).max(axis=-1)
        assert difference.any()
        assert (difference > 8).sum() < 0.02 * full.robot.sum()
        assert (image.robot ^ full.robot).sum() < 0.002 * full.robot.sum()
        assert (image.mask ^ full.mask).sum() < 0.002 * full.robot.sum()


_RENDER = f"""
import sys
import numpy as np
from kinebench_drake.environment.native import prepare_vulkan
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.simulator import Simulator
with Simulator("{TASK}") as simulator:
    simulator.reset(compose("{TASK}", 0))
    image = simulator.render()
np.savez(sys.argv[1], driver=prepare_vulkan(), rgb=image.rgb, depth_mm=image.depth_mm, robot=image.robot)
"""


def _render_in(path: Path, environment: Mapping[str, str]) -> Mapping[str, np.ndarray]:
    subprocess.run([sys.executable, "-c", _RENDER, str(path)], env={**os.environ, **environment}, check=True)
    with np.load(path) as image:
        return dict(image)


@pytest.mark.gpu
@pytest.mark.sapien
@pytest.mark.skipif(not has_nvidia_vulkan(), reason="no GPU")
def test_gpu_and_cpu_render_nearly_equal_images(tmp_path: Path) -> None:
    on_gpu, own = (
        _render_in(tmp_path / f"{k}.npz", environment) for k, environment in enumerate(({}, {RENDER_VARIABLE: "cpu"}))
    )
    assert (on_gpu["driver"], own["driver"]) == ("gpu", "cpu")
    assert (on_gpu["robot"] ^ own["robot"]).sum() < 0.01 * own["robot"].sum()
    off_mm = np.abs(on_gpu["depth_mm"].astype(int) - own["depth_mm"])
    assert (off_mm > 2).mean() < 0.01
    assert (np.abs(on_gpu["rgb"].astype(int) - own["rgb"]).max(axis=-1) > 16).mean() < 0.02
