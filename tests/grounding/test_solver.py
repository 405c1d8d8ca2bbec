"""The batched solver: derivatives, and independence of the frames that are solved together."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array, invert, make_pose
from kinebench_drake.grounding.registration.arm_model import ArmHandModel, ArmModel
from kinebench_drake.grounding.registration.fit import HandModel, fit, fit_all, gripper_cells
from kinebench_drake.grounding.registration.solver import CellRows, Correspondences, FitModel, residuals, solve
from kinebench_drake.grounding.tracking.flange_fit import ChainModel
from kinebench_drake.models.panda.cad import MAX_FINGER_M, GripperCad
from kinebench_drake.models.panda.description import ARM, RobotPart
from tests.grounding.conftest import hand_pose, perfect_view

FRAMES = 3
CELLS = 40


def random_cells(rng: np.random.Generator, parts: list[RobotPart], around: Array) -> Correspondences:
    """Cells of CAD points near the origin of their parts, with lines of sight near `around` (3,)."""
    z = around + rng.normal(0.0, 0.1, (CELLS, 3))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    part = rng.choice(parts, CELLS).astype(np.uint8)
    return Correspondences(
        R_LC=np.stack([x, np.cross(z, x), z], axis=1),
        range_m=rng.uniform(0.7, 0.9, CELLS),
        range_sigma=np.where(rng.random(CELLS) < 0.3, np.inf, 0.01),
        p_P=rng.normal(0.0, 0.03, (CELLS, 3)),
        sigma_m=np.where(rng.random((CELLS, 2)) < 0.2, np.inf, 0.003),
        part=part,
        opening_sign=np.select([part == RobotPart.LEFT_FINGER, part == RobotPart.RIGHT_FINGER], [1.0, -1.0]),
        weight=rng.uniform(0.1, 1.0, CELLS),
    )


def hands(rng: np.random.Generator) -> tuple[FitModel, Correspondences]:
    model = HandModel(
        X_CH=np.stack([hand_pose(seed) for seed in range(FRAMES)]),
        finger_m=rng.uniform(0.01, 0.03, FRAMES),
        finger_free=np.ones(FRAMES, dtype=bool),
        pose_free=np.ones(FRAMES, dtype=bool),
        max_finger_m=np.full(FRAMES, MAX_FINGER_M),
    )
    parts = [RobotPart.HAND, RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER]
    return model, Correspondences.stack([random_cells(rng, parts, X[:3, 3]) for X in model.X_CH])


def arms(rng: np.random.Generator) -> tuple[FitModel, Correspondences]:
    q = np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, 0.8]) + rng.normal(0.0, 0.1, (FRAMES, 7))
    model = ArmHandModel(
        model=ArmModel(),
        X_CB=invert(benchmark_camera().X_BC) @ make_pose(np.eye(3), rng.normal(0.0, 0.02, (FRAMES, 3))),
        q=q,
        q_start=q,
        finger_m=rng.uniform(0.01, 0.03, FRAMES),
        finger_free=np.ones(FRAMES, dtype=bool),
    )
    X_CH = model.hand()[0]
    return model, Correspondences.stack([random_cells(rng, list(RobotPart)[1:], X[:3, 3]) for X in X_CH])


def chains(rng: np.random.Generator) -> tuple[FitModel, Correspondences]:
    q = np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, 0.8]) + rng.normal(0.0, 0.1, (FRAMES, 7))
    X_CH = np.stack([hand_pose(seed) for seed in range(FRAMES)])
    model = ChainModel(model=ArmModel(), X_CH=X_CH, q=q, q_start=q)
    return model, Correspondences.stack([random_cells(rng, list(ARM)[3:], X[:3, 3]) for X in X_CH])


def depths(model: FitModel, rows: CellRows) -> Array:
    """Distances (B, N) of the posed points along the lines of sight [m]."""
    placement = model.place()
    return rows.in_line_frames(rows.place(placement.X_CP, placement.finger_m)[0])[:, 2]


@pytest.mark.parametrize("make", [hands, arms, chains])
def test_jacobians_are_finite_differences_of_the_residuals(make: object) -> None:
    """Of angles at the first distance, and of log ranges with the first standard deviation."""
    model, cells = make(np.random.default_rng(0))  # type: ignore[operator]
    rows = CellRows.of(cells)
    step = 1e-6
    z = depths(model, rows)
    _, J = residuals(model.place(), rows, np.zeros(FRAMES))

    def residuals_at(moved: FitModel, log_depth_factor: Array) -> Array:
        r = residuals(moved.place(), rows, log_depth_factor)[0].copy()
        there = depths(moved, rows)
        r[:, :2] *= (z / there)[:, None]
        with np.errstate(invalid="ignore"):  # cells without a range have infinite ones
            r[:, 2] *= np.hypot(rows.range_sigma, rows.sigma_m / there) / np.hypot(rows.range_sigma, rows.sigma_m / z)
        return np.nan_to_num(r)

    for k in range(J.shape[1] - 1):
        change = step * np.eye(J.shape[1] - 1)[None, k].repeat(FRAMES, axis=0)
        ahead, back = (residuals_at(model.updated(s * change), np.zeros(FRAMES)) for s in (1, -1))
        np.testing.assert_allclose(J[:, k], (ahead - back) / (2 * step), rtol=1e-5, atol=1e-4)
    ahead, back = (residuals_at(model, np.full(FRAMES, s * step)) for s in (1, -1))
    np.testing.assert_allclose(J[:, -1], (ahead - back) / (2 * step), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("make", [hands, arms, chains])
def test_frames_of_a_batch_do_not_influence_each_other(make: object) -> None:
    model, cells = make(np.random.default_rng(1))  # type: ignore[operator]
    sigma = np.array([0.005, 0.02, 0.1])
    together = solve(model, cells, sigma)
    for frame in range(FRAMES):
        one = np.array([frame])
        alone = solve(model.take(one), cells.take(one), sigma[one])
        assert alone.valid[0] == together.valid[frame]
        np.testing.assert_allclose(alone.information[0], together.information[frame], rtol=1e-6, atol=1e-3)
        np.testing.assert_allclose(alone.residual[0], together.residual[frame], atol=1e-6)


def test_padding_a_frame_to_the_batch_size_changes_no_solution(cad: GripperCad) -> None:
    cells = gripper_cells(perfect_view(cad, hand_pose(1), noise_m=0.002))
    fewer = cells.take(np.arange(0, len(cells), 3))
    filled = Correspondences.stack([fewer, cells]).take(np.array([0]))
    one = np.ones(1, dtype=bool)
    model = HandModel(
        X_CH=hand_pose(1)[None],
        finger_m=np.array([0.02]),
        finger_free=one,
        pose_free=one,
        max_finger_m=one * MAX_FINGER_M,
    )
    with_copies = solve(model, filled, np.array([0.01])).model.X_CH
    np.testing.assert_allclose(with_copies, solve(model, Correspondences.stack([fewer]), np.array([0.01])).model.X_CH)


def test_a_batch_fit_equals_the_fits_of_its_frames(cad: GripperCad) -> None:
    views = [perfect_view(cad, hand_pose(seed), noise_m=0.002, seed=seed) for seed in range(4)]
    views[2] = replace(views[2], part=np.zeros_like(views[2].part))
    for view, together in zip(views, fit_all(views, [None] * 4, [None] * 4), strict=True):
        alone = fit(view)
        assert (alone is None) == (together is None)
        if alone is not None and together is not None:
            np.testing.assert_allclose(alone.X_CH, together.X_CH, atol=1e-8)
            assert alone.points == together.points


def test_a_hand_behind_the_camera_is_an_invalid_solution(cad: GripperCad) -> None:
    cells = Correspondences.stack([gripper_cells(perfect_view(cad, hand_pose(0)))])
    behind = hand_pose(0)
    behind[2, 3] *= -1.0
    fixed = np.zeros(1, dtype=bool)
    model = HandModel(
        X_CH=behind[None],
        finger_m=np.array([0.02]),
        finger_free=fixed,
        pose_free=fixed,
        max_finger_m=np.full(1, MAX_FINGER_M),
    )
    assert not solve(model, cells, np.array([0.01])).valid.any()
