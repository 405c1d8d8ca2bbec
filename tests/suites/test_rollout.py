"""The experts in the simulation, and the camera that films them."""

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import invert, pose_difference, transform_points
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import TASKS, find_expert
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, render_video, run_expert
from kinebench_drake.suites.simulator import Simulator, TaskOutcome

Filmed = tuple[Simulator, Rollout, RolloutVideo]


def test_an_expert_of_an_unknown_task_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="StackCube-v1"):
        find_expert("StackCubes")


def test_the_reason_of_a_failure_names_the_false_conditions() -> None:
    conditions = {"above": True, "still": False, "released": False}
    assert TaskOutcome(success=False, progress=0.5, conditions=conditions).reason == "not still, not released"
    assert TaskOutcome(success=True, progress=1.0, conditions=dict.fromkeys(conditions, True)).reason == ""


@pytest.mark.sapien
def test_the_sapien_camera_looks_along_its_x_axis() -> None:
    from kinebench_drake.suites.scene.builder import sapien_from_opencv

    X_WC = benchmark_camera().X_BC
    X_WS = sapien_from_opencv(X_WC)
    assert np.allclose(X_WS[:3, 0], X_WC[:3, 2])
    assert np.allclose(X_WS[:3, 1], -X_WC[:3, 0])
    assert np.allclose(X_WS[:3, 2], -X_WC[:3, 1])


@pytest.mark.sapien
@pytest.mark.parametrize("seed", [11, pytest.param(12, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize(
    ("task", "variant", "robot"),
    [
        *((task, variant, "panda") for task, t in TASKS.items() for variant in t.card.variants),
        ("StackCube-v1", TaskVariant.PLAIN, "panda_wristcam"),
    ],
)
def test_experts_succeed_within_speed_limits(task: str, variant: TaskVariant, robot: str, seed: int) -> None:
    plant = ArmPlant()
    with Simulator(task, robot=robot, variant=variant, renders=robot != "panda") as stage:
        performance = run_expert(stage, find_expert(task), compose(task, seed, variant=variant))
    assert performance.outcome.success, performance.outcome
    q = np.stack([snapshot.q for snapshot in performance.snapshots])
    assert len(q) in [48 * clips + 1 for clips in range(1, TASKS[task].card.clips + 1)]
    assert (np.abs(np.diff(q, axis=0)) / FRAME_PERIOD_S <= plant.velocity_limits).all()
    assert (q > plant.lower).all()
    assert (q < plant.upper).all()
    for name in performance.snapshots[0].joints:
        joints = np.array([snapshot.joints[name] for snapshot in performance.snapshots])
        wrong_way = -np.sign(joints[-1] - joints[0]) * np.diff(joints)
        assert wrong_way.max() < 0.005 * np.ptp(joints)


@pytest.mark.sapien
def test_masked_pixels_lie_on_the_gripper_by_depth_and_pose(filmed: Filmed) -> None:
    """Camera, mask, depth and pose agree: masked pixels, carried through depth and pose, fall into the hand's box."""
    _, _, clip = filmed
    rays = clip.camera.rays()
    for i in range(0, len(clip.t_s), 8):
        assert clip.mask[i].sum() > 100
        z_m = (clip.depth_mm[i][clip.mask[i]] + 0.5) / 1000.0  # the renderer drops fractions of a millimetre
        p_H = transform_points(invert(clip.X_CH[i]), z_m[:, None] * rays[clip.mask[i]])
        low = p_H.min(axis=0)
        high = p_H.max(axis=0)
        assert (low > [-0.04, -0.11, -0.03]).all()
        assert (high < [0.04, 0.11, 0.12]).all()
        assert high[1] - low[1] > 0.15  # both sides of the 0.2 m wide hand are seen


@pytest.mark.sapien
def test_ground_truth_poses_agree_with_drakes_kinematics(filmed: Filmed) -> None:
    _, _, clip = filmed
    plant = ArmPlant()
    X_BG = plant.forward_path(clip.q)
    X_CH = invert(clip.camera.X_BC) @ np.stack([plant.link_poses(q)["panda_hand"] for q in clip.q])
    for found, expected in ((clip.X_BG, X_BG), (clip.X_CH, X_CH)):
        distance, angle = pose_difference(found, expected)
        assert distance.max() < 1e-5
        assert angle.max() < 1e-5
    assert clip.finger_width_m.max() == pytest.approx(0.08, abs=2e-3)
    assert clip.finger_width_m.min() == pytest.approx(0.04, abs=5e-3)  # the cube, which the physics lets pads dent


@pytest.mark.sapien
def test_rendering_afterwards_equals_rendering_during_the_rollout(filmed: Filmed) -> None:
    stage, performance, clip = filmed
    again = render_video(stage, performance.snapshots[30:33], first_frame=30)
    assert np.array_equal(again.rgb, clip.rgb[30:33])
    assert np.array_equal(again.depth_mm, clip.depth_mm[30:33])
    assert np.array_equal(again.t_s, clip.t_s[30:33])
    with Simulator("StackCube-v1", camera=clip.camera) as other:
        assert run_expert(other, find_expert("StackCube-v1"), performance.episode).outcome.success
        picture = other.render()  # straight from the simulation, no snapshot between
        last = render_video(other, [other.snapshot()])
        assert np.array_equal(last.rgb[0], clip.rgb[-1])
        assert np.array_equal(picture.depth_mm, clip.depth_mm[-1])
        assert np.array_equal(picture.mask, clip.mask[-1])
        # of the episode before, the last bit of a joint angle changes the shade of one pixel
        snapshots = run_expert(other, find_expert("StackCube-v1"), compose("StackCube-v1", 1)).snapshots
        straight = other.render()
        assert np.array_equal(straight.rgb, render_video(other, snapshots[-1:]).rgb[0])
    assert (picture.robot & picture.mask).sum() == picture.mask.sum() < picture.robot.sum()
