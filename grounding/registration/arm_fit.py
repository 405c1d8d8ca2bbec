"""The arm behind the gripper: the posture in which links and gripper are where the picture shows them.

The base stands still and the links' lengths are known, so the arm tells where the hand is, and most of all how far
away, which a hand alone tells badly. The first posture comes from inverse kinematics of the hand's own pose, in closed
form over the angles of the last joint; then all joints are fitted to the cells of links and gripper together.
"""

from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.grounding.registration.arm_model import OVER_LIMIT_RAD, ArmModel, FittedArm
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.fit import Fit, HandModel, drawn, gripper_cells
from kinebench_drake.grounding.registration.silhouette import Silhouette
from kinebench_drake.grounding.registration.solver import Solution, solve
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.models.panda.robot import ARM, GRIPPER

_LAST_ANGLES = np.linspace(-np.pi, np.pi, 32, endpoint=False)
_MAX_CELLS, _SCORED_CELLS = 300, 48
_INDEPENDENT = 30.0  # measurements that a view's cells of the arm are worth
_MIN_CELLS = 60
_COST_CAP = 25.0  # squared residual of a cell that counts no further
_EVIDENCE_CAP = 6.0
_MAX_CONSISTENCY_PX = 6.0  # of a frame 384 px wide
_MAX_ACROSS_M, _MAX_ALONG_M, _MAX_TURN_RAD = 0.025, 0.08, np.deg2rad(20.0)  # from the hand by itself
_UNKNOWN = 1e3  # relative standard deviation of a range that is not to count
_HAND_LEFT = 0.03  # weight of the hand where the links alone are to tell how far away it is
_FOLLOWING_GATES = (8.0, 5.0, 3.0)  # farthest pairs of outlines, from pass to pass [cells]
_MAX_GROWTH, _MAX_GROWTH_SIGMAS = 1.4, 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmFit:
    """The arm as it goes with the gripper of a frame."""

    q: Array
    """(7,) joint angles [rad]."""
    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame on which arm and hand agree [m]."""
    finger_m: float
    """Opening of each finger [m]; NaN when no finger was seen."""
    finger_sigma_m: float
    """Standard deviation of the opening [m]."""
    agrees: bool
    """Whether they do agree: whether one posture explains both."""
    consistency_px: float
    """Median distance between the links as seen and as the posture has them [px of the frame]."""
    scale: float
    """Apparent size of the hand over that which it has where the links put it; NaN where that cannot be told."""
    evidence: float
    """Log-likelihood ratio of the hand's reading against the one turned by 180 degrees, as the links have it."""
    covariance: Array
    """(6, 6) of rotation about the camera's axes [rad] and position of the hand [m]."""


class ArmFitter:
    """Fits the arm to views of one camera."""

    def __init__(self, camera: Camera, model: ArmModel) -> None:
        self._model, self._X_CB = model, invert(camera.X_BC)
        self._focal_px = camera.fx
        self._tolerance_px = _MAX_CONSISTENCY_PX * camera.unit_px

    def fit(
        self, hand: Fit, close: GripperView, wide: GripperView, rim: Correspondences | None = None
    ) -> ArmFit | None:
        """The arm that goes with a hand fitted to the `close` view of a frame; None where too little is seen of it.

        Args:
            hand: the hand by itself.
            close: the view to which it was fitted.
            wide: the view of the whole frame.
            rim: what the hand's outline says; see `Outline`.
        """
        links = self._links(close, wide)
        first = self._first_posture(hand, links) if len(links) >= _MIN_CELLS else None
        if first is None:
            return None
        q, evidence = first
        gripper = gripper_cells(close)
        cells = Correspondences.join([gripper, links])
        seen = cells if rim is None else Correspondences.join([cells, rim])
        start = self._start(q, hand.finger_m, hand)
        solution = solve(start, seen, close.level_sigma, float(np.log(hand.depth_factor)))
        if solution is None:
            return None
        arm = solution.body
        X_CH = arm.hand()[0]
        n = len(gripper)
        r, robust = solution.residual[:n, :2], solution.robust[:n, :2]
        growth = float(np.sqrt((robust * r**2).sum() / robust.sum()))
        along, across = _split(X_CH[:3, 3] - hand.X_CH[:3, 3], hand.X_CH[:3, 3])
        agrees = (
            along <= _MAX_ALONG_M
            and across <= _MAX_ACROSS_M
            and pose_difference(X_CH, hand.X_CH)[1] <= _MAX_TURN_RAD
            and growth <= _MAX_GROWTH * hand.residual + _MAX_GROWTH_SIGMAS
        )
        scale = self._scale(arm, cells, close.level_sigma, solution.level, hand)
        return self._described(solution, links, hand, scale=scale, evidence=evidence, agrees=bool(agrees))

    def follow(
        self, near: ArmFit, hand: Fit, close: GripperView, wide: GripperView, outline: Silhouette
    ) -> ArmFit | None:
        """The arm of a frame from that of a frame next to it, where the hand by itself was misread.

        Wrong CAD coordinates of the hand are outliers there, and its outline tells where it is.

        Args:
            near: the arm of the frame next to it.
            hand: the hand by itself, misread.
            close: the view of the hand.
            wide: the view of the whole frame.
            outline: what compares the rendered hand's outline with the one seen.
        """
        links = self._links(close, wide)
        if len(links) < _MIN_CELLS:
            return None
        cells = Correspondences.join([gripper_cells(close), links])
        arm, level = self._start(near.q, near.finger_m, hand), float(np.log(hand.depth_factor))
        solution = None
        for gate in _FOLLOWING_GATES:
            rim = outline.rim(close, arm.hand()[0], arm.finger_m, gate)
            joined = None if rim is None else Correspondences.join([cells, rim])
            solution = None if joined is None else solve(arm, joined, close.level_sigma, level, iterations=4)
            if solution is None:
                break
            arm, level = solution.body, solution.level
        if solution is None:
            return None
        turned = arm.q + np.pi * (np.arange(7) == 6) * (1.0 if arm.q[6] < 0 else -1.0)
        some = links.take(np.linspace(0, len(links) - 1, _SCORED_CELLS).astype(int))
        evidence = _evidence(*self._costs(np.stack([arm.q, turned]), some))
        return self._described(solution, links, hand, scale=float("nan"), evidence=evidence, agrees=True)

    def _links(self, close: GripperView, wide: GripperView) -> Correspondences:
        views = (close, wide)
        return Correspondences.join(
            [Correspondences.of_view(v, np.isin(v.part, ARM), _MAX_CELLS, _INDEPENDENT) for v in views]
        )

    def _start(self, q: Array, finger_m: float, hand: Fit) -> FittedArm:
        return FittedArm(
            model=self._model,
            X_CB=self._X_CB,
            q=q,
            q_start=q,
            finger_m=drawn(finger_m),
            opening_free=hand.opening_free,
        )

    def _described(
        self,
        solution: Solution[FittedArm],
        links: Correspondences,
        hand: Fit,
        *,
        scale: float,
        evidence: float,
        agrees: bool,
    ) -> ArmFit:
        arm = solution.body
        X_CH, J = arm.hand()
        covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(8))
        consistency = self._consistency_px(arm, links)
        return ArmFit(
            q=arm.q,
            X_CH=X_CH,
            finger_m=arm.finger_m if hand.opening_free else hand.finger_m,
            finger_sigma_m=float(covariance[7, 7] ** 0.5),
            agrees=agrees and consistency <= self._tolerance_px,
            consistency_px=consistency,
            scale=scale,
            evidence=evidence,
            covariance=J @ covariance[:7, :7] @ J.T,
        )

    def _scale(self, arm: FittedArm, cells: Correspondences, level_sigma: float, level: float, hand: Fit) -> float:
        """How far away the links have the hand over how far away it looks by its size alone."""
        of_hand = np.isin(cells.part, GRIPPER)
        by_links = replace(cells, weight=np.where(of_hand, _HAND_LEFT, 1.0) * cells.weight)
        of_links = solve(arm, by_links, level_sigma, level, iterations=4)
        sizes = cells.take(of_hand)
        free = HandModel(X_CH=hand.X_CH, finger_m=arm.finger_m, opening_free=arm.opening_free)
        by_size = replace(sizes, range_sigma=np.full(len(sizes), _UNKNOWN))
        of_size = solve(free, by_size, level_sigma, iterations=4)
        if of_links is None or of_size is None:
            return float("nan")
        return float(np.linalg.norm(of_links.body.hand()[0][:3, 3]) / np.linalg.norm(of_size.body.X_CH[:3, 3]))

    def _first_posture(self, hand: Fit, links: Correspondences) -> tuple[Array, float] | None:
        """The posture (7,) of the inverse kinematics that suits the links best, and how much better than turned ones.

        Turned by 180 degrees about its axis, the hand takes the same posture but for the last joint.
        """
        X_BF = invert(self._X_CB) @ hand.X_CH @ self._model.X_HF
        q = analytic_ik(X_BF, _LAST_ANGLES).reshape(-1, 7)
        q = q[np.isfinite(q).all(axis=1)]
        turned = q.copy()
        turned[:, 6] = (turned[:, 6] + 2 * np.pi) % (2 * np.pi) - np.pi
        best: list[tuple[float, Array | None]] = []
        some = links.take(np.linspace(0, len(links) - 1, _SCORED_CELLS).astype(int))
        for postures in (q, turned):
            over = OVER_LIMIT_RAD
            inside = ((postures >= self._model.lower - over) & (postures <= self._model.upper + over)).all(axis=1)
            candidates = postures[inside]
            if not len(candidates):
                best.append((_COST_CAP, None))
                continue
            costs = self._costs(candidates, some)
            best.append((float(costs.min()), candidates[costs.argmin()]))
        (cost, posture), (turned_cost, _) = best
        if posture is None:
            return None
        return posture, _evidence(cost, turned_cost)

    def _costs(self, q: Array, cells: Correspondences) -> Array:
        """(M,) mean capped squared residual of cells for postures `q` (M, 7)."""
        X = (self._X_CB @ self._model.poses(q))[:, cells.part]
        p_C = np.einsum("mnij,nj->mni", X[..., :3, :3], cells.p_P) + X[..., :3, 3]
        p_L = np.einsum("nij,mnj->mni", cells.R_LC, p_C)
        square = (p_L[..., :2] ** 2).sum(axis=-1) / cells.sigma_m[:, 0] ** 2
        return np.asarray(np.where(p_L[..., 2] > 0, np.minimum(square, _COST_CAP), _COST_CAP).mean(axis=1))

    def _consistency_px(self, arm: FittedArm, links: Correspondences) -> float:
        p_C, _ = arm.points(links)
        p_L = np.einsum("nij,nj->ni", links.R_LC, p_C)
        return float(self._focal_px * np.median(np.linalg.norm(p_L[:, :2], axis=1) / p_L[:, 2]))


def _evidence(cost: float, turned_cost: float) -> float:
    """Log-likelihood ratio of two readings from their mean squared residuals."""
    return float(np.clip(0.5 * (turned_cost - cost), -_EVIDENCE_CAP, _EVIDENCE_CAP))


def _split(difference: Array, direction: Array) -> tuple[float, float]:
    """Lengths of a difference (3,) along and across a direction (3,)."""
    along = float(difference @ direction / np.linalg.norm(direction))
    return abs(along), max(0.0, float(difference @ difference) - along**2) ** 0.5
