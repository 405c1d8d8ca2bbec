"""Poses in a row: what is left out of them, and what is known beforehand."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.grounding.frame_pose import FramePose
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.smoothing import RawTrack
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.types import Anomaly, AnomalyKind
from tests.grounding.conftest import hand_pose, perfect_view

FRAMES = 12


@pytest.fixture(scope="module")
def pose(cad: GripperCad) -> FramePose:
    view = perfect_view(cad, hand_pose(1))
    found = fit(view)
    assert found is not None
    return FramePose(
        X_CH=found.X_CH,
        finger_m=0.02,
        finger_sigma_m=1e-3,
        hand=found,
        hand_without_silhouette=found,
        arm=None,
        view=view,
        overlap=0.95,
    )


def made(pose: FramePose, confidence: np.ndarray, anomalies: tuple[Anomaly, ...] = (), **known: np.ndarray) -> RawTrack:
    return RawTrack.from_poses(
        [None if c == 0.0 else pose for c in confidence],
        confidence,
        anomalies,
        known.get("lost", np.zeros(FRAMES, dtype=bool)),
        known.get("X_prior", np.full((FRAMES, 4, 4), np.nan)),
    )


def test_what_is_no_gripper_is_left_out(pose: FramePose) -> None:
    confidence = np.full(FRAMES, 0.9)
    confidence[[0, 1]] = 0.0, 0.01
    gone = Anomaly(kind=AnomalyKind.VANISH, frame_start=4, frame_end=6, severity=3.0)
    lost = np.arange(FRAMES) == 9
    assert np.flatnonzero(made(pose, confidence, (gone,), lost=lost).has_pose).tolist() == [2, 3, 7, 8, 10, 11]


def test_nothing_is_smoothed_across_a_jump(pose: FramePose) -> None:
    jump = Anomaly(kind=AnomalyKind.TELEPORT, frame_start=6, frame_end=6, severity=0.1)
    raw = made(pose, np.full(FRAMES, 0.9), (jump,))
    X_AH = raw.X_AH.copy()
    X_AH[6:, 0, 3] += 0.1
    smooth = replace(raw, X_AH=X_AH).smooth(np.ones(FRAMES, dtype=bool), raw.confidence)
    np.testing.assert_allclose(smooth, X_AH, atol=1e-9)


def test_given_poses_are_certain_and_stay(pose: FramePose) -> None:
    X_prior = np.full((FRAMES, 4, 4), np.nan)
    X_prior[3] = pose.X_CH
    X_prior[3, :3, 3] += 0.05
    confidence = np.full(FRAMES, 0.9)
    confidence[3] = 0.0
    raw = made(pose, confidence, X_prior=X_prior)
    assert raw.from_prior.nonzero()[0].tolist() == [3]
    assert raw.confidence[3] == 1.0
    np.testing.assert_array_equal(raw.smooth(raw.has_pose, raw.confidence)[3], X_prior[3])


def test_a_frame_that_its_neighbours_deny_shows_it(pose: FramePose) -> None:
    raw = made(pose, np.full(FRAMES, 0.9))
    X_AH = raw.X_AH.copy()
    X_AH[6, :3, 3] += 0.1
    distance = replace(raw, X_AH=X_AH).features()[:, 1]
    assert distance.argmax() == 6
    assert distance[6] == pytest.approx(np.log(np.sqrt(3) * 0.1 / 0.01), abs=0.1)
