"""Rendering by a software driver: the same images by other shaders, nearly the same with a simplified arm."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.suites.episode import compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.simulator import CameraImage, Simulator, Snapshot

TASK = "PullCube-v1"
_ENVIRONMENT = "kinebench_drake.suites.tasks.environment"


@pytest.fixture(scope="module")
def states() -> Sequence[Snapshot]:
    with Simulator(TASK, renders=False) as simulator:
        return run_expert(simulator, find_expert(TASK), compose(TASK, 0)).snapshots[::12]


def _images(states: Sequence[Snapshot]) -> tuple[int, list[CameraImage]]:
    """Return the number of the robot's triangles, and images of states."""
    import sapien

    with Simulator(TASK) as simulator:
        simulator.reset(compose(TASK, 0))
        links = (link._objs[0].entity for link in simulator._env.agent.robot.links_map.values())
        bodies = (link.find_component_by_type(sapien.render.RenderBodyComponent) for link in links)
        shapes = (shape for body in bodies if body is not None for shape in body.render_shapes)
        count = sum(len(part.triangles) for shape in shapes for part in shape.parts)
        images = []
        for state in states:
            simulator.set_snapshot(state)
            images.append(simulator.render())
        return count, images


@pytest.mark.sapien
def test_shaders_give_the_images_of_maniskill_s_to_the_bit(
    states: Sequence[Snapshot], monkeypatch: pytest.MonkeyPatch
) -> None:
    from kinebench_drake.suites.tasks.rendering import software_shaders

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
def test_a_simplified_arm_looks_as_before(states: Sequence[Snapshot], monkeypatch: pytest.MonkeyPatch) -> None:
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
