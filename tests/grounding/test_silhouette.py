"""Fits to the silhouette of the gripper, on masks rendered from the CAD model."""

import numpy as np
import pytest

from kinebench_drake.geometry import Array, invert, make_pose, pose_difference, rotation_exp, transform_points
from kinebench_drake.grounding.registration.fit import HandModel, gripper_cells
from kinebench_drake.grounding.registration.silhouette import SilhouetteMatcher
from kinebench_drake.grounding.registration.solver import Correspondences, solve
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, Crop, GripperView
from kinebench_drake.models.panda.cad import MAX_FINGER_M, GripperCad
from kinebench_drake.models.panda.description import RobotPart

FINGER_M = 0.03
X_CH = make_pose(rotation_exp([2.2, 0.5, 0.3]), [0.05, -0.02, 0.9])


@pytest.fixture(scope="module")
def silhouette() -> SilhouetteMatcher:
    return SilhouetteMatcher(GripperCad())


def mask_view(X: Array) -> GripperView:
    """A view with the mask of a gripper at `X` (4, 4), without depth and CAD coordinates."""
    crop = Crop.of_gripper(X_CH, 1.3, CLOSE_SIZE)
    n = CLOSE_SIZE // 2
    part = GripperCad().cast(invert(crop.X_CV) @ X, crop.rays(2).reshape(-1, 3), FINGER_M).part.reshape(n, n)
    return GripperView(
        crop=crop,
        stride=2,
        in_image=np.ones((n, n), dtype=bool),
        part=part,
        depth_m=np.full((n, n), 0.9),
        depth_sigma=np.full((n, n), np.inf),
        depth_factor_sigma=0.01,
        coordinates_P=np.zeros((n, n, 3)),
        coordinates_sigma_m=np.full((n, n), np.inf),
    )


def moved(turn: list[float], shift: list[float]) -> Array:
    """The gripper turned about its own axes [rad] and shifted in its own frame [m]."""
    return X_CH @ make_pose(rotation_exp(turn), shift)


def hand_model(X: Array) -> HandModel:
    """One hand at `X` (4, 4), its pose free."""
    one = np.ones(1, dtype=bool)
    return HandModel(
        X_CH=X[None], finger_m=np.array([FINGER_M]), finger_free=~one, pose_free=one, max_finger_m=MAX_FINGER_M * one
    )


@pytest.mark.parametrize(
    ("turn", "shift"), [([0.0, 0.0, 0.12], [0.006, 0.0, 0.0]), ([0.06, 0.0, 0.06], [0.0, 0.007, -0.007])]
)
def test_the_silhouette_alone_recovers_the_pose_across_the_line_of_sight(
    silhouette: SilhouetteMatcher, turn: list[float], shift: list[float]
) -> None:
    """Across the line of sight: the distance is poorly determined."""
    view = mask_view(X_CH)
    X = moved(turn, shift)
    before = silhouette.overlap(view, X, FINGER_M)
    for _ in range(4):
        rim = silhouette.match(view, X, FINGER_M)
        assert rim is not None
        solution = solve(hand_model(X), Correspondences.stack([rim]), np.array([view.depth_factor_sigma]))
        assert solution.valid.all()
        X = solution.model.X_CH[0]
    distance, angle = pose_difference(X, X_CH)
    across = np.linalg.norm((X - X_CH)[:2, 3])
    assert before < 0.9
    assert silhouette.overlap(view, X, FINGER_M) > 0.95
    assert across < 0.003
    assert distance < 0.03
    assert np.rad2deg(angle) < 3.0


def test_the_true_pose_has_no_silhouette_residual(silhouette: SilhouetteMatcher) -> None:
    view = mask_view(X_CH)
    rim = silhouette.match(view, X_CH, FINGER_M)
    assert rim is not None
    p_C = transform_points(X_CH, rim.p_P)
    off = np.einsum("nij,nj->ni", rim.R_LC, p_C)[:, 0] / p_C[:, 2]
    assert np.abs(off).max() < 1e-9


@pytest.mark.parametrize("side", [0, 1])
def test_the_image_border_does_not_count_as_silhouette(silhouette: SilhouetteMatcher, side: int) -> None:
    """A gripper half outside the image: its pose stays, and its visible part is covered."""
    view = mask_view(X_CH)
    middle = int(np.mean(np.nonzero(view.part)[side]))
    np.moveaxis(view.in_image, side, 0)[middle:] = False
    view.part[~view.in_image] = 0
    rim = silhouette.match(view, X_CH, FINGER_M)
    assert rim is not None
    solution = solve(hand_model(X_CH), Correspondences.stack([rim]), np.array([view.depth_factor_sigma]))
    assert solution.valid.all()
    assert np.linalg.norm((solution.model.X_CH[0] - X_CH)[:2, 3]) < 1e-6
    assert silhouette.overlap(view, X_CH, FINGER_M) == 1.0


def test_silhouette_points_constrain_only_their_normal_direction(silhouette: SilhouetteMatcher) -> None:
    """Along itself and along the line of sight: points moved there cost nothing."""
    rim = silhouette.match(mask_view(X_CH), X_CH, FINGER_M)
    assert rim is not None
    assert np.isinf(rim.sigma_m[:, 1]).all()
    assert np.isinf(rim.range_sigma).all()
    assert np.isfinite(rim.sigma_m[:, 0]).all()


def test_the_border_to_the_arm_does_not_count_as_silhouette(silhouette: SilhouetteMatcher) -> None:
    view = mask_view(X_CH)
    rim = silhouette.match(view, X_CH, FINGER_M)
    rows = np.flatnonzero((view.part > 0).any(axis=1))
    view.part[: rows[0] + len(rows) // 2][view.part[: rows[0] + len(rows) // 2] == 0] = RobotPart.LINK7
    less = silhouette.match(view, X_CH, FINGER_M)
    assert rim is not None
    assert less is not None
    assert 0 < len(less) < 0.8 * len(rim)


def test_an_empty_mask_has_no_silhouette(silhouette: SilhouetteMatcher) -> None:
    view = mask_view(X_CH)
    view.part[:] = 0
    assert silhouette.match(view, X_CH, FINGER_M) is None
    assert silhouette.overlap(view, X_CH, FINGER_M) == 0.0


def test_silhouette_points_and_cells_join_to_one_set_of_correspondences(silhouette: SilhouetteMatcher) -> None:
    view = mask_view(X_CH)
    rim = silhouette.match(view, X_CH, FINGER_M)
    assert rim is not None
    cells = gripper_cells(view)
    assert len(Correspondences.join([cells, rim])) == len(cells) + len(rim)
