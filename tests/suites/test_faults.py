"""Planted faults: only the frames named are touched, and the truth says what is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import transform_points
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.products import AnomalyKind
from kinebench_drake.suites.faults import (
    FREEZE_FRAMES,
    FREEZE_SPEED_M_S,
    TELEPORT_M,
    VANISH_FRAMES,
    PlantedFault,
    plant_freeze,
    plant_teleport,
    plant_vanish,
)
from kinebench_drake.suites.rollout import FRAME_PERIOD_S, Clip, Performance, Stage

Filmed = tuple[Stage, Performance, Clip]
pytestmark = pytest.mark.sapien


def assert_only_altered(clip: Clip, faulty: Clip, fault: PlantedFault) -> None:
    frames = np.arange(len(clip.t_s))
    inside = (frames >= fault.frame_start) & (frames <= fault.frame_end)
    for name in ("rgb", "depth_mm", "mask", "q", "X_CH", "X_BG", "finger_width_m"):
        before, after = getattr(clip, name), getattr(faulty, name)
        assert np.array_equal(before[~inside], after[~inside])
    altered = (clip.rgb != faulty.rgb).any(axis=(1, 2, 3))
    assert altered[inside].all()
    assert np.array_equal(clip.t_s, faulty.t_s)


def test_vanish(filmed: Filmed) -> None:
    stage, performance, clip = filmed
    faulty, fault = plant_vanish(stage, performance, clip)
    assert fault.kind is AnomalyKind.VANISH
    assert fault.frame_end - fault.frame_start + 1 == VANISH_FRAMES
    assert_only_altered(clip, faulty, fault)
    gone = slice(fault.frame_start, fault.frame_end + 1)
    assert not faulty.mask[gone].any()
    assert np.isnan(faulty.X_BG[gone]).all()
    stage.show(performance.snapshots[fault.frame_start])
    assert np.array_equal(stage.picture()[0], clip.rgb[fault.frame_start])  # the links are drawn again


def test_freeze(filmed: Filmed) -> None:
    _, _, clip = filmed
    faulty, fault = plant_freeze(clip)
    assert fault.frame_end - fault.frame_start + 1 == FREEZE_FRAMES
    assert_only_altered(clip, faulty, fault)
    frozen = slice(fault.frame_start, fault.frame_end + 1)
    assert (faulty.rgb[frozen] == clip.rgb[fault.frame_start - 1]).all()
    p = clip.X_BG[fault.frame_start - 1 : fault.frame_end + 2, :3, 3]
    assert np.linalg.norm(p[-1] - p[0]) / ((FREEZE_FRAMES + 1) * FRAME_PERIOD_S) >= FREEZE_SPEED_M_S
    entry = clip.X_BG[fault.frame_start - 1, :3, 3] - clip.X_BG[fault.frame_start - 2, :3, 3]
    assert np.linalg.norm(entry) / FRAME_PERIOD_S >= FREEZE_SPEED_M_S
    assert np.array_equal(faulty.X_BG[fault.frame_end], clip.X_BG[fault.frame_start - 1])


def test_freeze_of_a_resting_gripper_is_refused(filmed: Filmed) -> None:
    _, _, clip = filmed
    still = replace(clip, X_BG=np.repeat(clip.X_BG[:1], len(clip.t_s), axis=0))
    with pytest.raises(InputError, match="would not show"):
        plant_freeze(still)


def test_fault_out_of_view_is_refused(filmed: Filmed) -> None:
    _, _, clip = filmed
    with pytest.raises(InputError, match="take another seed"):
        plant_freeze(replace(clip, mask=np.zeros_like(clip.mask)))


def test_teleport(filmed: Filmed) -> None:
    stage, performance, clip = filmed
    faulty, fault = plant_teleport(stage, performance, clip)
    assert fault.frame_end == len(clip.t_s) - 1
    assert_only_altered(clip, faulty, fault)
    moved = faulty.X_BG[fault.frame_start :, :3, 3] - clip.X_BG[fault.frame_start :, :3, 3]
    assert np.allclose(np.linalg.norm(moved, axis=1), TELEPORT_M, atol=1e-5)
    assert np.allclose(moved, moved[0], atol=1e-5)
    plant = ArmPlant()
    assert np.allclose([plant.forward(q) for q in faulty.q], faulty.X_BG, atol=1e-5)
    # The picture shows it there: the masked pixels' middle lies by the displaced hand, not by the true one.
    i = fault.frame_start
    v, u = np.nonzero(faulty.mask[i])
    middle = np.array([u.mean() + 0.5, v.mean() + 0.5])
    p_H = np.array([[0.0, 0.0, 0.03]])  # near the middle of what is seen of the gripper
    there, here = (clip.camera.project(transform_points(c.X_CH[i], p_H))[0] for c in (faulty, clip))
    assert np.linalg.norm(middle - there) < 6.0
    assert np.linalg.norm(middle - here) > 12.0
