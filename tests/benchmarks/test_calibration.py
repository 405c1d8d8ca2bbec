import json

import numpy as np
import pytest

from benchmarks.calibration import CONDITIONS, CalibrationCondition, measure, trial_table
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.geometry import invert
from kinebench_drake.grounding.camera.calibrate import Calibrator
from kinebench_drake.grounding.camera.calibration_result import CalibrationMethod
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.models.panda.description import RobotPart
from tests.grounding.camera.robot import CellsAlone, PerfectEstimator, postures

T = 5


@pytest.fixture
def estimator():
    return PerfectEstimator(benchmark_camera(), postures(T), ArmModel())


def cells_alone(estimator):
    return Calibrator(estimator.estimate, estimator.estimate, CellsAlone())


@pytest.fixture
def folder(tmp_path, estimator):
    frames = np.zeros((T, 384, 384, 3), np.uint8)
    frames[:, 0, 0, 0] = np.arange(T)
    np.save(tmp_path / "a.npy", frames)
    (tmp_path / "manifest.jsonl").write_text(json.dumps({"video": "a.npy", "task": "PullCube-v1"}) + "\n")
    save_camera(estimator.camera, tmp_path / "camera.json")
    (tmp_path / "truth").mkdir()
    X_CH = invert(estimator.camera.X_BC) @ estimator.model.poses(estimator.q)[:, RobotPart.HAND]
    np.savez(tmp_path / "truth" / "a.npz", q=estimator.q, finger_width_m=np.full(T, 0.02), camera_from_hand=X_CH)
    return tmp_path


def test_calibration_from_perfect_estimates_is_within_5_mm(folder, estimator):
    conditions = [c for c in CONDITIONS if not c.focal_free and c.method is not CalibrationMethod.ESTIMATE]
    trials = list(measure(folder, limit=None, frames=T, conditions=conditions, calibrator=cells_alone(estimator)))
    assert [t.condition for t in trials] == conditions
    for trial in trials:
        told = trial.condition.method in (CalibrationMethod.JOINTS, CalibrationMethod.POSES)
        assert trial.distance_m < (1e-5 if told else 5e-3)
    assert len(trial_table(trials)) == 2 + len(conditions)


def test_a_folder_without_joint_angles_is_refused(folder, estimator):
    np.savez(folder / "truth" / "a.npz", finger_width_m=np.zeros(T))
    condition = CalibrationCondition(method=CalibrationMethod.JOINTS, focal_free=False)
    with pytest.raises(UsageError, match="holds no joint angles"):
        next(measure(folder, limit=None, frames=T, conditions=[condition], calibrator=cells_alone(estimator)))
