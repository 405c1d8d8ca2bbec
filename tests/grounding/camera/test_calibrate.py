import functools
import json
from types import SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.geometry import invert, pose_difference, transform_points
from kinebench_drake.grounding.camera import calibrate as calibration
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene
from kinebench_drake.grounding.camera.calibrate import CalibrationConfig, Calibrator, calibrate, format_lines
from kinebench_drake.grounding.camera.lens import Lens, with_focal
from kinebench_drake.grounding.camera.links import LagEstimate, LinkEvidence
from kinebench_drake.grounding.overlay import render_parts
from kinebench_drake.models.panda.description import GripperKind, RobotPart
from tests.grounding.camera.robot import CellsAlone, PerfectEstimator, postures

T = 6


@pytest.fixture
def estimator(camera, model):
    return PerfectEstimator(with_focal(camera, 400.0), postures(T), model, noise_px=0.3)


@pytest.fixture
def video(tmp_path):
    """A still picture; the first pixel of each frame tells its number."""
    frames = np.repeat(np.random.default_rng(0).integers(0, 255, (1, 384, 384, 3), np.uint8), T, axis=0)
    frames[:, 0, 0, 0] = np.arange(T)
    np.save(tmp_path / "video.npy", frames)
    np.savez(tmp_path / "joints.npz", t_s=np.arange(T) * 0.1, q=postures(T))
    return tmp_path / "video.npy"


@pytest.fixture
def program(program, monkeypatch, estimator):
    """Runs the program with the estimator of a rendered arm."""
    monkeypatch.setattr(
        calibration,
        "calibrate",
        functools.partial(calibrate, calibrator=Calibrator(estimator.estimate, estimator.estimate, CellsAlone())),
    )
    return program


def test_calibrate_writes_a_camera_file_its_figures_and_a_check_image(program, video, estimator, tmp_path):
    out = tmp_path / "camera.json"
    figure = tmp_path / "check.png"
    joints = tmp_path / "joints.npz"
    code, stated, err = program("calibrate", video, "--joints", joints, "--out", out, "--figure", figure, "--json")
    assert (code, err) == (0, "")
    camera = load_camera(out).camera
    figures = json.loads(stated)
    assert float(pose_difference(camera.X_BC, estimator.camera.X_BC)[0]) < 0.02
    assert camera.fx == pytest.approx(400.0, rel=0.03)
    assert figures["camera"] == json.loads(out.read_text())
    assert figures["frames"] == list(range(T))
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_a_focal_length_set_by_option_stays_fixed(program, video, tmp_path):
    out = tmp_path / "camera.json"
    code, stated, _ = program(
        "calibrate", video, "--joints", tmp_path / "joints.npz", "--focal", 400, "--out", out, "--frames", 4
    )
    assert code == 0
    assert "400.0 px, fixed" in stated
    assert "4 frames" in stated
    assert load_camera(out).camera.fx == 400.0


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--joints", "0,1,2", "--out", "c.json"], 2, "expected 7 joint angles in radians"),
        (["--joints", "none.csv", "--out", "c.json"], 2, "there is no such file"),
        (["--out", "c.txt"], 2, "--out c.txt: expected a name that ends in .json"),
        (["--focal", "0", "--out", "c.json"], 2, "0.0 is not in the range 1.0<=x<=100000.0"),
        (["--focal", "9", "--camera", "c.json", "--out", "c.json"], 2, "exclude each other"),
        (["--joints-frame", "3", "--out", "c.json"], 2, "there is no --joints, whose posture"),
        (["--joints", "home", "--episode", "3", "--out", "c.json"], 2, "and --joints names none"),
    ],
)
def test_invalid_arguments_are_reported_in_one_line(program, video, arguments, code, said):
    ended, out, err = program("calibrate", video, *arguments)
    assert (ended, out, len(err.splitlines())) == (code, "", 1)
    assert said in err


def test_a_missing_video_is_reported_in_one_line(program, tmp_path):
    code, _, err = program("calibrate", tmp_path / "none.mp4", "--out", tmp_path / "c.json")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "none.mp4: there is no such file" in err


def test_calibration_refuses_a_moving_camera(video, estimator, tmp_path):
    frames = np.load(video)
    background = np.kron(np.random.default_rng(0).integers(0, 255, (24, 24)), np.ones((16, 16))).astype(np.uint8)
    for i, frame in enumerate(frames):
        frame[:] = np.roll(background, 4 * i, axis=1)[..., None]
        frame[0, 0, 0] = i
    np.save(video, frames)
    with pytest.raises(UnmeasurableError, match="the camera moves"):
        calibrate(
            CalibrationConfig(video=video, joints=str(tmp_path / "joints.npz")),
            Calibrator(estimator.estimate, estimator.estimate, CellsAlone()),
        )


@pytest.mark.parametrize("focal_px", [None, 400.0])
def test_the_camera_is_estimated_from_the_arm_without_joint_angles(video, estimator, focal_px):
    class Cameras:
        def estimate(self, frames, camera, *, focal_free):
            assert len(frames) == T
            assert focal_free is (focal_px is None)
            assert focal_free or camera.fx == focal_px
            return SimpleNamespace(doubt="two turns of the base explain its contours")

    with pytest.raises(UnmeasurableError, match=r"two turns of the base .*; give \$joints FILE"):
        calibrate(
            CalibrationConfig(video=video, focal_px=focal_px),
            Calibrator(estimator.estimate, estimator.estimate, Cameras()),
        )


class LinksAlone:
    """Takes the true camera as the one that fits the links, whose joint angles are in time."""

    def __init__(self, estimator):
        self._estimator = estimator

    def detect(self, frames, states, guess, *, focal_free, most, allowed):
        assert allowed is None
        return [self._estimator.estimate(frames, guess)]

    def solve(self, detected, frames, states, guess, **_):
        lens = Lens.of_camera(self._estimator.camera)
        scene = ArmScene(lens=lens, q=states.q, finger_m=np.zeros(len(states.q)))
        start = SimpleNamespace(scene=scene, rows=np.arange(len(states.q)))
        estimate = CellsAlone().refine(frames, guess, start, focal_free=True, centre_sigma_px=0.0)
        lag = LagEstimate(frames=0.0, agreement=0.9, runner_up=0.5)
        return estimate, LinkEvidence(lag=lag, shapes=((1.0, 0.9),), links="link5 in 6 of 6 frames")


def no_hand(frames, camera):
    raise UnmeasurableError("no gripper is seen")


@pytest.mark.parametrize(
    ("gripper", "kind"),
    [("auto", GripperKind.ROBOTIQ_2F85), ("robotiq-2f85", GripperKind.ROBOTIQ_2F85), ("none", GripperKind.NONE)],
)
def test_the_links_alone_are_used_where_the_arm_carries_no_franka_hand(video, estimator, tmp_path, gripper, kind):
    loaded = []
    calibrator = Calibrator(
        no_hand, no_hand, CellsAlone(), lambda gripper: loaded.append(gripper) or LinksAlone(estimator)
    )
    config = CalibrationConfig(video=video, joints=str(tmp_path / "joints.npz"), gripper=GripperKind(gripper))
    calibration = calibrate(config, calibrator)
    assert loaded == [kind]
    assert calibration.to_json()["links_alone"]["lag_frames"] == 0.0
    assert any("links alone" in line for line in format_lines(calibration))
    assert np.isnan(calibration.drawn_parts(0)[RobotPart.HAND]).all()
    assert np.isfinite(calibration.drawn_parts(0)[RobotPart.LINK7]).all()


def test_a_franka_hand_that_is_not_detected_is_refused_if_the_gripper_is_named(video, estimator, tmp_path):
    calibrator = Calibrator(no_hand, no_hand, CellsAlone(), lambda _: LinksAlone(estimator))
    with pytest.raises(UnmeasurableError, match="no gripper is seen"):
        calibrate(
            CalibrationConfig(video=video, joints=str(tmp_path / "joints.npz"), gripper=GripperKind.FRANKA), calibrator
        )
    with pytest.raises(UsageError, match="needs the joint angles of all frames"):
        calibrate(CalibrationConfig(video=video, joints="home", gripper=GripperKind.NONE), calibrator)


def test_the_drawn_robot_lies_where_the_camera_projects_it(camera, model):
    X_BP = model.poses(postures(1))[0]
    labels = render_parts(camera, X_BP, 0.01)
    inside = transform_points(invert(camera.X_BC) @ X_BP[RobotPart.HAND], np.array([[0.0, 0.0, 0.03]]))
    u, v = camera.project(inside)[0].astype(int)
    assert labels[v, u] in (RobotPart.HAND, RobotPart.LINK7, RobotPart.LINK6)
    X_BP[RobotPart.HAND] = np.nan
    assert RobotPart.HAND not in render_parts(camera, X_BP, 0.01)
