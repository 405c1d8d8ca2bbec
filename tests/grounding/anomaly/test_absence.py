"""Why a hand is not found: frames of a robot drawn from its CAD models, with and without its hand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import make_pose
from kinebench_drake.grounding.anomaly.absence import Absence, AbsenceFinder, list_lost
from kinebench_drake.grounding.registration.arm_fit import ArmFit, ArmFitter
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.description import RobotPart
from tests.grounding.conftest import fitted_pose
from tests.grounding.robots import CAMERA, drawn, posture, views

FRAMES = 6
SHOWN = np.array([True, True, False, False, False, True])


@pytest.fixture(scope="module")
def finder():
    return AbsenceFinder(ArmModel(), EdgeMatcher())


@pytest.fixture(scope="module")
def explain(finder):
    """Reasons of the frames that do not show the hand, of a robot that moves from a posture to another one."""

    def of(first, last, *, camera: Camera = CAMERA, without_hand=True, without_wrist=False):
        images, wide, poses = [], [], []
        fitter = ArmFitter(camera, finder.model, finder.edges)
        nothing = GripperModel(parts={RobotPart.HAND: trimesh.creation.box([1e-4] * 3)}, max_finger_m=0.0)
        for q, is_shown in zip(np.linspace(first, last, FRAMES), SHOWN, strict=True):
            _, close, whole = views(finder.model, q, 0)
            image = drawn(finder.model, q) if is_shown or not without_hand else drawn(finder.model, q, nothing)
            if not is_shown and without_wrist:
                covered = whole.to_frame(whole.part == RobotPart.LINK7, CAMERA)
                rows, columns = np.nonzero(covered)
                image[max(0, rows.min() - 20) : rows.max() + 90, columns.min() - 60 : columns.max() + 60] = 50
            part = np.where(whole.gripper & (not is_shown), RobotPart.BACKGROUND, whole.part).astype(np.uint8)
            images.append(image)
            wide.append(replace(whole, part=part))
            arm = ArmFit(q=q, X_CH=fitter.hand(q), agrees=True, covariance=1e-6 * np.eye(6))
            poses.append(replace(fitted_pose(close), X_CH=arm.X_CH, arm=arm))
        return finder.explain(np.stack(images), camera, None, wide, poses, SHOWN)

    return of


def test_a_hand_that_its_arm_should_show_is_gone(explain):
    reasons = explain(posture(0), posture(0) + 0.1)
    assert reasons == (None, None, Absence.GONE, Absence.GONE, Absence.GONE, None)


def test_a_hand_that_the_image_shows_is_only_not_recognized(explain):
    assert explain(posture(0), posture(0), without_hand=False)[3] is Absence.UNSURE


def test_what_hides_the_wrist_may_hide_the_hand(explain):
    assert explain(posture(0), posture(0), without_wrist=True)[3] is Absence.UNSURE


def test_a_hand_that_left_the_picture_is_not_gone(explain):
    beside = replace(CAMERA, X_BC=CAMERA.X_BC @ make_pose(np.eye(3), [0.7, 0.0, 0.0]))
    assert explain(posture(0), posture(0), camera=beside)[3] is Absence.OUT


def test_a_hand_that_has_not_appeared_is_not_missing(finder):
    _, close, wide = views(finder.model, posture(0), 0)
    image = drawn(finder.model, posture(0))
    reasons = finder.explain(
        np.stack([image] * 2), CAMERA, None, [wide] * 2, [None, fitted_pose(close)], np.array([False, True])
    )
    assert reasons == (Absence.UNSURE, None)


def test_stretches_of_lost_frames_have_one_reason_each():
    absences = (None, None, Absence.OUT, Absence.OUT, Absence.HIDDEN, None)
    lost = list_lost(np.array([True, False, False, False, False, True]), absences)
    assert [(span["frame_start"], span["frame_end"], span["reason"]) for span in lost] == [
        (1, 1, "found, but not trusted"),
        (2, 3, "out of the picture"),
        (4, 4, "hidden by its own arm"),
    ]
    assert list_lost(np.ones(2, dtype=bool), (None, None)) == []
