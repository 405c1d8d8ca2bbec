from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import invert, pose_difference
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, Observations, Prior, adjust
from kinebench_drake.grounding.camera.hypotheses import ChainSearch
from kinebench_drake.grounding.camera.lens import Lens
from kinebench_drake.models.panda.description import ARM, GRIPPER
from tests.grounding.camera.robot import postures, project_robot

CAMERA = benchmark_camera()
PARTS = (*GRIPPER, *ARM)
FRAMES = 6


LOOSE = 100.0  # standard deviation of joint angles about which nothing is known [rad]


def observe(cells, sigma_px):
    return replace(Observations.of_cells(cells, np.full(len(cells), sigma_px)), weight=np.ones(len(cells)))


def prior(**changes):
    return Prior(**{"lens": Lens(intrinsics=CAMERA, X_CB=np.eye(4)), "log_focal_sigma": 0.5, **changes})


def truth(q):
    return ArmScene(lens=Lens(intrinsics=CAMERA, X_CB=invert(CAMERA.X_BC)), q=q, finger_m=np.full(len(q), 0.01))


def test_camera_focal_length_and_postures_are_recovered_together(model):
    rng = np.random.default_rng(0)
    q = postures(FRAMES)
    scene = truth(q)
    start = replace(
        scene,
        lens=scene.lens.displace(np.array([0.06, -0.05, 0.04, 0.04, 0.03, -0.06, 0.08, 0.0, 0.0])),
        q=q + rng.uniform(-0.1, 0.1, q.shape),
    )
    observations = observe(project_robot(CAMERA, q, model, parts=PARTS), 0.5)
    fitted = adjust(observations, start, prior(), model, q_sigma=LOOSE, iterations=60).scene
    distance, angle = pose_difference(fitted.lens.to_camera().X_BC, CAMERA.X_BC)
    assert distance < 1e-3
    assert angle < 1e-3
    assert fitted.lens.intrinsics.fx == pytest.approx(CAMERA.fx, rel=1e-3)
    assert fitted.q == pytest.approx(q, abs=2e-3)


def test_errors_of_the_camera_match_the_stated_sigmas(model):
    q = postures(FRAMES)
    cells = project_robot(CAMERA, q, model, parts=PARTS)
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(12):
        noisy = replace(cells, uv_px=cells.uv_px + rng.normal(0.0, 0.3, cells.uv_px.shape))
        bundle = adjust(observe(noisy, 0.3), truth(q), prior(), model, q_sigma=LOOSE)
        lens = bundle.scene.lens
        error = np.concatenate(
            [
                _rotation(lens.X_CB, invert(CAMERA.X_BC)),
                lens.X_CB[:3, 3] - invert(CAMERA.X_BC)[:3, 3],
                [np.log(lens.intrinsics.fx / CAMERA.fx)],
            ]
        )
        squares.append(error @ bundle.information[:7, :7] @ error / 7)
    assert 0.5 < np.mean(squares) < 2.0


def _rotation(X_1, X_2):
    from kinebench_drake.geometry import rotation_log

    return rotation_log(X_1[:3, :3] @ X_2[:3, :3].T)


def test_fixed_parameters_keep_their_value_and_have_no_information(model):
    q = postures(FRAMES)
    start = replace(truth(q), q=q + 0.05)
    observations = observe(project_robot(CAMERA, q, model, parts=PARTS), 0.5)
    place = adjust(observations, start, prior(log_focal_sigma=0.0, place_free=False), model)
    assert np.array_equal(place.scene.lens.X_CB, start.lens.X_CB)
    assert not place.information.any()
    focal = adjust(observations, start, prior(log_focal_sigma=0.0), model)
    assert focal.scene.lens.intrinsics.fx == CAMERA.fx
    assert not focal.information[6].any()
    assert (np.diag(focal.information)[:6] > 0).all()


def test_an_offset_for_each_part_absorbs_errors_common_to_its_contours(model):
    q = postures(FRAMES)
    points = observe(project_robot(CAMERA, q, model, parts=PARTS), 0.5)
    normals = np.random.default_rng(0).normal(size=(len(points), 2))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    contours = replace(points, whitening=np.stack([normals / 0.5, np.zeros_like(normals)], axis=1))
    shift_px = np.where(points.part == ARM[3], 0.4, 0.0)[:, None] * normals
    moved = replace(contours, uv_px=contours.uv_px + shift_px)

    def fit(offset_sigma, iterations=20):
        offsets = prior(offset_sigma=offset_sigma)
        return adjust(moved, truth(q), offsets, model, q_sigma=LOOSE, iterations=iterations)

    rigid = fit(0.0)
    free = fit(1.0)
    far, near = (pose_difference(b.scene.lens.to_camera().X_BC, CAMERA.X_BC)[0] for b in (rigid, free))
    assert near < 0.1 * far
    assert free.scene.offset[ARM[3]] == pytest.approx(0.4 / 0.5, rel=0.05)
    assert np.abs(np.delete(free.scene.offset, ARM[3])).max() < 0.1
    assert not rigid.scene.offset.any()
    # What the offsets explain is not known about the camera.
    assert np.linalg.eigvalsh(fit(0.0, 0).information[:7, :7] - fit(1.0, 0).information[:7, :7]).min() > -1e-3


def test_the_turn_about_joint_1_is_undetermined_without_cells_of_the_base(model):
    q = postures(FRAMES)

    def sigma(parts):
        observations = observe(project_robot(CAMERA, q, model, parts=parts), 0.5)
        information = adjust(observations, truth(q), prior(), model, q_sigma=LOOSE, iterations=0).information[:7, :7]
        return np.linalg.inv(information + 1e-9 * np.eye(7))[:3, :3].trace() ** 0.5

    assert sigma(PARTS) < np.deg2rad(1.0)
    assert sigma((*GRIPPER, *ARM[1:])) > np.deg2rad(90.0)


@pytest.mark.parametrize("zoom", [1.0, 1.3])
def test_the_chain_search_finds_the_camera_without_an_initial_estimate(model, zoom):
    q = postures(FRAMES, seed=2)
    camera = replace(CAMERA, fx=CAMERA.fx * zoom, fy=CAMERA.fy * zoom)
    cells = project_robot(camera, q, model, parts=PARTS, cells=20)
    search = ChainSearch(cells, np.full(FRAMES, 0.01), model)
    best = search.run(CAMERA, [250.0, 330.0, 430.0])[0]
    assert best.lens.intrinsics.fx == (330.0 if zoom == 1.0 else 430.0)
    start = ArmScene(lens=best.lens, q=best.q, finger_m=np.full(FRAMES, 0.01))
    observations = observe(cells.flip(best.flipped), 0.5)
    fitted = adjust(observations, start, prior(), model, q_sigma=LOOSE, iterations=60).scene.lens
    distance, angle = pose_difference(fitted.to_camera().X_BC, camera.X_BC)
    assert distance < 5e-3
    assert angle < np.deg2rad(0.3)
