"""Cameras fitted to the links alone, on images drawn by ray casting."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import invert, pose_difference
from kinebench_drake.grounding.camera.detections import ArmDetections
from kinebench_drake.grounding.camera.lens import Lens, centred_camera, pixel_shapes
from kinebench_drake.grounding.camera.links import LagEstimate, LinkAgreement, LinkCalibrator, LinkEvidence
from kinebench_drake.grounding.camera.states import RobotStates
from kinebench_drake.models.panda.cad import PartCaster, franka_hand, link_meshes
from kinebench_drake.models.panda.description import ARM, RobotPart
from kinebench_drake.models.robot import N_JOINTS
from tests.grounding.camera.robot import postures, project_robot

T = 24
LAG = 2
WIDTH, HEIGHT = 240, 144  # 5:3, a picture of 16:9 that was stretched


@pytest.fixture(scope="module")
def true():
    square = benchmark_camera()
    fx = 0.9 * WIDTH
    camera = replace(centred_camera(WIDTH, HEIGHT, fx), fy=fx * 192 / 180)
    return replace(camera, X_BC=square.X_BC)


@pytest.fixture(scope="module")
def film(model, true):
    """Joint angles of a moving arm, and images of it."""
    ends = postures(5, reach=0.5, seed=3)
    q = np.stack([np.interp(np.linspace(0, 4, T), np.arange(5), ends[:, j]) for j in range(N_JOINTS)], axis=1)
    caster = PartCaster(franka_hand(), link_meshes())
    rays = true.rays().reshape(-1, 3)
    rng = np.random.default_rng(0)
    frames = []
    for X_BP in model.poses(q):
        hit = caster.cast(invert(true.X_BC) @ X_BP, rays)
        shade = np.where(hit.part > 0, 120.0 + 120.0 * np.abs(hit.normal @ [0.3, -0.8, -0.5]), 50.0)
        grey = np.clip(shade + rng.normal(0, 4.0, len(rays)), 0, 255).astype(np.uint8)
        frames.append(np.repeat(grey.reshape(HEIGHT, WIDTH, 1), 3, axis=2))
    return q, np.stack(frames)


def states_of(q, model):
    return RobotStates(q=q, X_BH=model.poses(q)[:, RobotPart.HAND], finger_m=np.full(len(q), np.nan), source="rows")


@pytest.fixture(scope="module")
def solution(model, film, true):
    """Camera by rows that are two frames late, half of whose cells are wrong."""
    q, frames = film
    late = np.concatenate([np.repeat(q[:1], LAG, axis=0), q[:-LAG]])
    rows = np.arange(3, T - 3)
    cells = project_robot(true, q[rows], model, parts=ARM, noise_px=1.0)
    wrong = np.random.default_rng(0).random(len(cells)) < 0.5
    cells.uv_px[wrong] = np.random.default_rng(1).uniform(0, [WIDTH, HEIGHT], (int(wrong.sum()), 2))
    robot = ArmDetections(
        rows=rows, cells=cells, finger_m=np.zeros(len(rows)), robot=np.zeros((HEIGHT, WIDTH), dtype=bool)
    )
    return LinkCalibrator(None).solve(
        [robot],
        frames,
        states_of(late, model),
        centred_camera(WIDTH, HEIGHT, float(WIDTH)),
        focal_free=True,
        shapes=pixel_shapes(WIDTH, HEIGHT),
        centre_sigma_px=0.0,
    )


def test_links_alone_determine_camera_and_focal_length(solution, true):
    estimate, _ = solution
    distance, angle = pose_difference(estimate.camera.X_BC, true.X_BC)
    assert distance < max(0.02, 2 * estimate.position_sigma_m)
    assert angle < np.deg2rad(1.0)
    assert estimate.camera.fx == pytest.approx(true.fx, rel=max(0.03, 2 * estimate.focal_sigma))
    assert estimate.agreement > 0.6
    assert not np.isin(estimate.part, [part for part in RobotPart if part not in ARM]).any()


def test_frames_that_the_fit_did_not_use_agree_best_with_their_own_joint_angles(model, film, true):
    q, frames = film
    links = LinkCalibrator(None)
    own, exchanged = links._agree_unused(frames, q, np.arange(6), Lens.of_camera(true))
    assert own > exchanged + 0.2
    assert links._agree_unused(frames, q, np.arange(T), Lens.of_camera(true)) is None


def test_joint_angles_that_are_two_frames_late_are_noticed(solution):
    _, evidence = solution
    assert evidence.lag.frames == LAG
    assert evidence.lag.agreement - evidence.lag.runner_up > 0.05
    assert evidence.lag.is_determined
    assert evidence.to_json()["lag_frames"] == LAG
    assert "2 frames late" in evidence.format_lines()[1]


def test_the_shape_of_the_pixels_of_a_stretched_picture_follows_from_the_contours(solution, true):
    estimate, evidence = solution
    assert estimate.camera.fy / estimate.camera.fx == pytest.approx(true.fy / true.fx, rel=1e-6)
    assert evidence.shapes[0][1] > evidence.shapes[1][1]


@pytest.mark.parametrize(
    ("size", "shapes"), [((320, 192), (192 / 180, 1.0, 0.8)), ((640, 480), (1.0,)), ((1280, 720), (1.0,))]
)
def test_only_pictures_of_unusual_shape_may_be_stretched(size, shapes):
    assert pixel_shapes(*size) == pytest.approx(shapes)


@pytest.mark.parametrize("lag", [-1.5, 0.0, 2.0])
def test_joint_angles_at_a_lag_are_those_of_later_rows_and_unknown_beyond_the_ends(model, lag):
    q = np.linspace(0, 1, 10)[:, None] * np.ones(N_JOINTS)
    late = states_of(q, model).q_at_lag(lag)
    rows = np.arange(10) + lag
    inside = (rows >= 0) & (rows <= 9)
    assert np.array_equal(np.isfinite(late).all(axis=1), inside)
    assert np.allclose(late[inside, 0], rows[inside] / 9)


@pytest.mark.parametrize(
    ("agreement", "runner_up", "unused", "said"),
    [
        (0.3, 0.1, None, "30% of their contours do.*the links seen are link5 in 3"),
        (0.6, 0.49, None, "as much at other times"),
        (0.6, 0.1, (0.2, 0.19), "no better with their own joint angles"),
    ],
)
def test_too_little_evidence_is_refused_with_the_links_in_view(agreement, runner_up, unused, said):
    lag = LagEstimate(frames=0.0, agreement=0.5, runner_up=runner_up)
    evidence = LinkEvidence(lag=lag, shapes=((1.0, 0.5),), links="link5 in 3 of 9 frames", unused=unused)
    with pytest.raises(UnmeasurableError, match=said):
        evidence.require_agreement("joints.csv", agreement)


def test_an_unclear_lag_is_no_objection_where_other_frames_confirm_the_camera():
    lag = LagEstimate(frames=0.0, agreement=0.5, runner_up=0.49)
    evidence = LinkEvidence(lag=lag, shapes=((1.0, 0.5),), links="link5 in 9 of 9 frames", unused=(0.5, 0.2))
    evidence.require_agreement("joints.csv", 0.6)
    assert not lag.is_determined


@pytest.mark.parametrize(
    ("own", "control", "frames", "follows"),
    [(0.5, 0.2, 12, True), (0.5, 0.48, 12, None), (0.5, 0.2, 6, None), (0.0, 0.0, 12, None)],
)
def test_links_confirm_a_motion_that_leads_every_control(own, control, frames, follows):
    shares = np.full(frames, own)
    agreement = LinkAgreement(own=shares, controls={"still": np.full(frames, control), "reversed": 0.1 * shares})
    assert agreement.decide()[0] is follows


def test_links_that_lose_the_motion_at_the_end_do_not_confirm_it():
    own = np.where(np.arange(12) < 8, 0.5, 0.1)
    agreement = LinkAgreement(own=own, controls={"still": np.full(12, 0.2)})
    assert agreement.means == {"own": pytest.approx(11 / 30), "still": pytest.approx(0.2)}
    assert agreement.decide()[0] is None
