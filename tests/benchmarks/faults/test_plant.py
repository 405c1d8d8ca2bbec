"""Planted faults: only the labelled frames change, and ground truth describes the rendered images."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.faults.fault import FaultForm, FaultGrade, PlantedFault
from benchmarks.faults.fault_simulator import RenderFault
from benchmarks.faults.plant import FREEZE_SPEED_M_S, plant
from benchmarks.faults.recording import Recording
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import pose_difference, transform_points
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.rollout import RolloutVideo

pytestmark = pytest.mark.sapien


def planted(
    recording: Recording, kind: AnomalyKind, size: float, form: FaultForm | None = None
) -> tuple[RolloutVideo, PlantedFault]:
    clip, fault = plant(recording, FaultGrade(kind=kind, size=size, form=form))
    assert (fault.kind, fault.size, fault.form) == (kind, size, form)
    assert_only_altered(recording.video, clip, fault)
    return clip, fault


def assert_only_altered(clip: RolloutVideo, faulty: RolloutVideo, fault: PlantedFault) -> None:
    frames = np.arange(len(clip.t_s))
    inside = (frames >= fault.frame_start) & (frames <= fault.frame_end)
    for name in ("rgb", "depth_mm", "mask", "q", "X_CH", "X_BG", "finger_width_m"):
        before = getattr(clip, name)
        after = getattr(faulty, name)
        assert np.array_equal(before[~inside], after[~inside])
    altered = (clip.rgb != faulty.rgb).any(axis=(1, 2, 3))
    assert altered[inside].mean() >= 0.5  # every other frame of a flutter may be as it was
    assert np.array_equal(clip.t_s, faulty.t_s)


def span(fault: PlantedFault) -> slice:
    return slice(fault.frame_start, fault.frame_end + 1)


def test_vanish_removes_the_gripper_and_its_pose_in_the_labelled_frames(recording: Recording) -> None:
    faulty, fault = planted(recording, AnomalyKind.VANISH, 5)
    assert fault.frame_end - fault.frame_start + 1 == 5
    assert not faulty.mask[span(fault)].any()
    assert np.isnan(faulty.X_BG[span(fault)]).all()
    recording.simulator.set_snapshot(recording.rollout.snapshots[fault.frame_start])
    assert np.array_equal(
        recording.simulator.render().rgb, recording.video.rgb[fault.frame_start]
    )  # the links are drawn again


def test_freeze_repeats_the_frame_before_while_the_gripper_would_move(recording: Recording) -> None:
    faulty, fault = planted(recording, AnomalyKind.FREEZE, 8)
    assert fault.frame_end - fault.frame_start + 1 == 8
    assert (faulty.rgb[span(fault)] == recording.video.rgb[fault.frame_start - 1]).all()
    p = recording.video.X_BG[fault.frame_start - 1 : fault.frame_end + 2, :3, 3]
    assert np.linalg.norm(p[-1] - p[0]) / (9 * FRAME_PERIOD_S) >= FREEZE_SPEED_M_S
    assert np.array_equal(faulty.X_BG[fault.frame_end], recording.video.X_BG[fault.frame_start - 1])


def test_freeze_of_a_resting_gripper_is_refused(recording: Recording) -> None:
    still = replace(recording.video, X_BG=np.repeat(recording.video.X_BG[:1], len(recording), axis=0))
    with pytest.raises(InputError, match="would not show"):
        plant(replace(recording, video=still), FaultGrade(kind=AnomalyKind.FREEZE, size=5, form=None))


def test_a_fault_of_a_gripper_out_of_view_is_refused(recording: Recording) -> None:
    unseen = replace(recording.video, mask=np.zeros_like(recording.video.mask))
    with pytest.raises(InputError, match="take another seed"):
        plant(replace(recording, video=unseen), FaultGrade(kind=AnomalyKind.VANISH, size=5, form=None))


@pytest.mark.parametrize("distance_m", [0.05, 0.15])
def test_teleport_displaces_the_arm_by_its_distance_until_the_end(recording: Recording, distance_m: float) -> None:
    faulty, fault = planted(recording, AnomalyKind.TELEPORT, distance_m)
    assert fault.frame_end == len(recording) - 1
    moved = faulty.X_BG[fault.frame_start :, :3, 3] - recording.video.X_BG[fault.frame_start :, :3, 3]
    assert np.allclose(np.linalg.norm(moved, axis=1), distance_m, atol=1e-5)
    assert np.allclose(moved, moved[0], atol=1e-5)
    plant_ = ArmPlant()
    assert np.allclose([plant_.forward(q) for q in faulty.q], faulty.X_BG, atol=1e-5)
    # The picture shows it there: the masked pixels' middle lies nearer to the displaced hand than to the true one.
    i = fault.frame_start
    v, u = np.nonzero(faulty.mask[i])
    middle = np.array([u.mean() + 0.5, v.mean() + 0.5])
    p_H = np.array([[0.0, 0.0, 0.03]])  # near the middle of what is seen of the gripper
    there, here = (c.camera.project(transform_points(c.X_CH[i], p_H))[0] for c in (faulty, recording.video))
    assert np.linalg.norm(middle - there) < min(6.0, np.linalg.norm(middle - here))


def test_drawing_the_gripper_without_deformation_changes_no_pixel(recording: Recording) -> None:
    costume = RenderFault(warp=lambda p: p, X_HP=np.eye(4), replaces=True)
    part = recording.render_again([12], lambda _: recording.simulator.set_fault(costume))
    assert np.array_equal(part.rgb[0], recording.video.rgb[12])
    assert np.array_equal(part.mask[0], recording.video.mask[12])


def test_a_duplicate_leaves_the_gripper_where_it_is(recording: Recording) -> None:
    faulty, fault = planted(recording, AnomalyKind.DUPLICATE, 0.25)
    changed = (faulty.rgb != recording.video.rgb)[span(fault)].any(axis=3)
    assert (changed.sum(axis=(1, 2)) > 0.5 * recording.video.mask[span(fault)].sum(axis=(1, 2))).all()
    assert np.allclose(faulty.X_CH, recording.video.X_CH, atol=1e-6)


def test_a_deformed_gripper_keeps_its_pose(recording: Recording) -> None:
    faulty, fault = planted(recording, AnomalyKind.DEFORMATION, 0.2)
    assert (faulty.mask != recording.video.mask)[span(fault)].any(axis=(1, 2)).all()
    assert np.allclose(faulty.X_CH, recording.video.X_CH, atol=1e-6)


@pytest.mark.parametrize("form", [FaultForm.SHAKE, FaultForm.DRIFT])
def test_camera_motion_moves_the_image_and_not_the_gripper(recording: Recording, form: FaultForm) -> None:
    faulty, _ = planted(recording, AnomalyKind.CAMERA, 4, form)
    assert np.allclose(faulty.X_BG, recording.video.X_BG, atol=1e-6)
    here, there = (recording.video.camera.project(c.X_CH[:, :3, 3]) for c in (recording.video, faulty))
    moved = np.linalg.norm(there - here, axis=1).max()
    assert 0.6 * 4 < moved < 1.8 * 4
    assert recording.simulator.camera is recording.video.camera


def test_planted_flutter_alternates_the_finger_width_alone(recording: Recording) -> None:
    flutter, fault = planted(recording, AnomalyKind.FINGERS, 0.04)
    step = np.diff(flutter.finger_width_m[span(fault)])
    assert (step[1:] * step[:-1] < 0).all()
    assert flutter.finger_width_m.min() >= 0.0
    assert flutter.finger_width_m.max() <= 0.0801
    assert pose_difference(flutter.X_CH, recording.video.X_CH)[0].max() < 1e-5
