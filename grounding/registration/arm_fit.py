"""Fit of the arm behind the gripper: the posture whose links and gripper match the image.

The base is fixed and the link lengths are known, so the arm determines where the hand is, above all its distance, which
the hand alone determines poorly. The initial posture comes from closed-form inverse kinematics of the hand's own pose
over the angles of the last joint; then all joints are fitted to the cells of links and gripper together.
"""

from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference
from kinebench_drake.grounding.registration.arm_model import OVER_LIMIT_RAD, ArmHandModel, ArmModel
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.edges import FLANGE, RIGID, ROBOT, EdgeMatcher, GradientImage
from kinebench_drake.grounding.registration.fit import (
    UNSEEN_FINGER_M,
    HandFit,
    HandModel,
    finger_or_default,
    gripper_cells,
)
from kinebench_drake.grounding.registration.silhouette import SilhouetteMatcher
from kinebench_drake.grounding.registration.solver import Solution, solve
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.models.panda.cad import open_fingers
from kinebench_drake.models.panda.robot import ARM, GRIPPER, RobotPart

_LAST_ANGLES = np.linspace(-np.pi, np.pi, 32, endpoint=False)
_MAX_CELLS, _SCORED_CELLS = 300, 48
_INDEPENDENT = 30.0  # independent measurements that the arm cells of a view count as
_MIN_CELLS = 60
_COST_CAP = 25.0  # cap of a cell's squared residual
_EVIDENCE_CAP = 6.0
_MAX_CONSISTENCY_PX = 6.0  # of an image 384 px wide
_MAX_ACROSS_M, _MAX_ALONG_M, _MAX_ANGLE_RAD = 0.025, 0.08, np.deg2rad(20.0)  # from the pose of the hand alone
_NO_RANGE_SIGMA = 1e3  # relative standard deviation of an ignored range
_LINKS_ONLY_WEIGHT = 0.03  # weight of the hand's cells where the links alone determine its distance
_NEIGHBOUR_GATES = (8.0, 5.0, 3.0)  # farthest silhouette pairs in successive passes [cells]
_EDGE_REACHES_PX = (10.0, 6.0, 4.0, 3.0, 2.0)  # farthest image edges in successive passes
_CELLS_REACH_PX = 6.0  # from which on the cells count in a pass, too
_SHARPENING_PX, _SHARPENING_POINTS = 4.0, 300  # farthest image edges of a posture that is nearly right
_SHARPENING_M = 0.02  # largest change of such a pose
_SHARPENING_GROWTH_PX = 1.0  # largest increase of the distance of the links, likewise: edges beside the right ones
_RIM_SIGMA_CELLS, _RIM_SIGMA_PX = 0.7, 0.7  # of the segmented rim of the hand
_DISTANCE_FACTORS = np.exp(np.arange(-0.24, 0.25, 0.03))  # distances of a search over that of the hand
_SEARCHED = 6  # distances at which a search looks at the edges
_EDGE_NATS = 25.0  # log-likelihood ratio per difference of edge agreement of hand and flange
_MIN_AGREEMENT = 0.4  # of a posture that the edges confirm
_MAX_GROWTH, _MAX_GROWTH_SIGMAS = 1.4, 0.3  # largest increase of the hand's residual by the arm


LINKS_DEPTH_SIGMA = 0.1
"""Relative standard deviation of the depth factor where only links are measured: looks are often unfamiliar."""
LINK_REACHES_PX = (5.0, 3.0)
"""Farthest edges of links in successive passes [px]."""
LAST_LINKS = (RobotPart.LINK6, RobotPart.LINK7)
"""Links whose contours say whether the flange is right; those before them may be wrong, or hidden."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmFit:
    """Posture of the arm fitted to the views of a frame."""

    q: Array
    """(7,) joint angles [rad]."""
    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame at this posture [m]."""
    finger_m: float
    """Travel of each finger [m]; NaN if no finger is visible."""
    finger_sigma_m: float
    """Standard deviation of the travel [m]."""
    agrees: bool
    """True if one posture explains both links and hand."""
    consistency_px: float
    """Median distance between the links as estimated and as posed [px of the frame]."""
    scale: float
    """Apparent size of the hand over its size at the distance given by the links; NaN if unknown."""
    evidence: float
    """Log-likelihood ratio of the hand's pose against the 180-degree flip, from the links."""
    covariance: Array
    """(6, 6) covariance of the hand's rotation about the camera's axes [rad] and position [m]."""
    edge_agreement: float = float("nan")
    """Share of the contour of hand and wrist that lies on edges of the image; NaN if not measured."""
    hand_agreement: float = float("nan")
    """The same of the contour of the hand alone."""


class ArmFitter:
    """Fitter of the arm to views of one camera."""

    def __init__(self, camera: Camera, model: ArmModel, edges: EdgeMatcher, places: Array | None = None) -> None:
        """Create the fitter; a moving camera has `places` (T, 3) in the frame of `camera` [m]."""
        self._model, self._X_CB, self._edges = model, invert(camera.X_BC), edges
        self._places = places
        self._camera = camera
        self._tolerance_px = _MAX_CONSISTENCY_PX * camera.unit_px

    def at(self, number: int) -> "ArmFitter":
        """Return the fitter of one frame: this one, unless the camera moves."""
        if self._places is None:
            return self
        X_BC = self._camera.X_BC @ make_pose(np.eye(3), self._places[number])
        return ArmFitter(replace(self._camera, X_BC=X_BC), self._model, self._edges)

    def fit(
        self, hand: HandFit, close: GripperView, wide: GripperView, rim: Correspondences | None = None
    ) -> ArmFit | None:
        """Fit the arm behind a hand; None if too little of the arm is visible.

        Args:
            hand: fit of the hand alone to `close`.
            close: view of the gripper's crop.
            wide: view of the whole image.
            rim: correspondences of the hand's silhouette (`SilhouetteMatcher.match`).
        """
        links = self._link_cells(close, wide)
        initial = self._initial_posture(hand.X_CH, links) if len(links) >= _MIN_CELLS else None
        if initial is None:
            return None
        q, cost, flipped_cost = initial
        gripper = gripper_cells(close)
        cells = Correspondences.join([gripper, links])
        start = self._start(q, hand.finger_m, hand)
        joined = cells if rim is None else Correspondences.join([cells, rim])
        solution = solve(start, joined, close.depth_factor_sigma, float(np.log(hand.depth_factor)))
        if solution is None:
            return None
        arm = solution.model
        X_CH = arm.hand()[0]
        n = len(gripper)
        r, robust = solution.residual[:n, :2], solution.robust[:n, :2]
        growth = float(np.sqrt((robust * r**2).sum() / robust.sum()))
        along, across = _split(X_CH[:3, 3] - hand.X_CH[:3, 3], hand.X_CH[:3, 3])
        agrees = (
            along <= _MAX_ALONG_M
            and across <= _MAX_ACROSS_M
            and pose_difference(X_CH, hand.X_CH)[1] <= _MAX_ANGLE_RAD
            and growth <= _MAX_GROWTH * hand.residual + _MAX_GROWTH_SIGMAS
        )
        scale = self._scale(solution, cells, close.depth_factor_sigma, hand)
        evidence = _evidence(cost, flipped_cost)
        return self._arm_fit(solution, links, hand, scale=scale, evidence=evidence, agrees=bool(agrees))

    def fit_from_neighbour(
        self, near: ArmFit, hand: HandFit, close: GripperView, wide: GripperView, silhouette: SilhouetteMatcher
    ) -> ArmFit | None:
        """Fit the arm from the posture in a neighbouring frame, where the hand's CAD coordinates are wrong.

        The wrong coordinates are outliers of that fit, and the silhouette determines the pose of the hand.

        Args:
            near: arm of the neighbouring frame.
            hand: fit of the hand alone.
            close: view of the gripper's crop.
            wide: view of the whole image.
            silhouette: comparison of the rendered with the segmented gripper.
        """
        links = self._link_cells(close, wide)
        if len(links) < _MIN_CELLS:
            return None
        cells = Correspondences.join([gripper_cells(close), links])
        arm, log_depth_factor = self._start(near.q, near.finger_m, hand), float(np.log(hand.depth_factor))
        solution = None
        for gate in _NEIGHBOUR_GATES:
            rim = silhouette.match(close, arm.hand()[0], arm.finger_m, gate)
            if rim is None:
                return None
            joined = Correspondences.join([cells, rim])
            solution = solve(arm, joined, close.depth_factor_sigma, log_depth_factor, iterations=4)
            if solution is None:
                return None
            arm, log_depth_factor = solution.model, solution.log_depth_factor
        if solution is None:
            return None
        evidence = _evidence(*self._costs(np.stack([arm.q, _half_turn(arm).q]), _subsample(links)))
        return self._arm_fit(solution, links, hand, scale=float("nan"), evidence=evidence, agrees=True)

    def fit_links(self, X_CH: Array, q: Array, links: Correspondences, image: GradientImage) -> ArmFit | None:
        """Fit the arm to cells and edges of its links alone; None if that diverges.

        The hand still hides what is behind it: other grippers are as large.

        Args:
            X_CH: (4, 4) initial pose of panda_hand [m].
            q: (7,) joint angles near it [rad]; those that no link shows are arbitrary.
            links: cells of the links.
            image: gradients of the frame.
        """
        if len(links) < _MIN_CELLS:
            return None
        initial = self._initial_posture(X_CH, links)
        solutions = []
        for start in [q] if initial is None else [q, initial[0]]:
            fitted = solve(self._links_at(start), links, LINKS_DEPTH_SIGMA, iterations=12)
            if fitted is not None:
                solutions.append(fitted)
        if not solutions:
            return None
        solution = min(
            solutions, key=lambda s: float(np.minimum((s.residual[:, :2] ** 2).sum(axis=1), _COST_CAP).mean())
        )
        for reach_px in LINK_REACHES_PX:
            edges = self._edges.match(image, self._poses(solution.model), reach_px, ARM, _SHARPENING_POINTS)
            if edges is None:
                break
            joined = Correspondences.join([links, edges])
            sharper = solve(self._links_at(solution.model.q), joined, LINKS_DEPTH_SIGMA, solution.log_depth_factor)
            if sharper is None:
                break
            solution = sharper
        arm = self._arm_fit(solution, links, None, scale=float("nan"), evidence=0.0, agrees=True)
        return replace(arm, edge_agreement=self._edges.agreement(image, self._poses(solution.model), LAST_LINKS))

    def _links_at(self, q: Array) -> ArmHandModel:
        return ArmHandModel(
            model=self._model, X_CB=self._X_CB, q=q, q_start=q, finger_m=UNSEEN_FINGER_M, finger_free=False
        )

    def search(self, hand: HandFit, close: GripperView, wide: GripperView, image: GradientImage) -> ArmFit | None:
        """Fit the arm to edges from the distance of the hand at which links and edges agree best with its direction.

        Args:
            hand: fit of the hand alone, whose distance is wrong.
            close: view of the gripper's crop.
            wide: view that shows the arm.
            image: gradients of the frame.
        """
        links = self._link_cells(close, wide)
        if len(links) < _MIN_CELLS:
            return None
        candidates = []
        for factor in _DISTANCE_FACTORS:
            X_CH = hand.X_CH.copy()
            X_CH[:3, 3] *= factor
            initial = self._initial_posture(X_CH, links)
            if initial is not None:
                candidates.append((initial[1], initial[0]))
        likeliest = sorted(candidates, key=lambda candidate: candidate[0])[:_SEARCHED]
        if not likeliest:
            return None
        q = max((q for _, q in likeliest), key=lambda q: self.edge_agreement(q, image))
        return self.refine(q, hand, close, wide, image)

    def refine(
        self, q: Array, hand: HandFit, close: GripperView, wide: GripperView, image: GradientImage
    ) -> ArmFit | None:
        """Fit the arm to the edges of the image, from a posture; None if that diverges.

        The first pass also counts the cells. The fingers only count in it: grippers have fingers of many forms. Near
        the hand, whose bevels look like outlines, the edge nearest to its segmented rim is taken.

        Args:
            q: (7,) initial joint angles [rad], of this frame or of a neighbouring one.
            hand: fit of the hand alone.
            close: view of the gripper's crop.
            wide: view that shows the arm.
            image: gradients of the frame.
        """
        cells = Correspondences.join([gripper_cells(close), self._link_cells(close, wide)])
        image = self._with_rim(image, close)

        def fit(arm: ArmHandModel, reaches_px: tuple[float, ...]) -> Solution[ArmHandModel] | None:
            log_depth_factor, solution = float(np.log(hand.depth_factor)), None
            for reach_px in reaches_px:
                with_cells = reach_px > _CELLS_REACH_PX
                edges = self._edges.match(image, self._poses(arm), reach_px, ROBOT if with_cells else RIGID)
                if edges is None:
                    return None
                joined = Correspondences.join([cells, edges]) if with_cells else edges
                solution = solve(arm, joined, close.depth_factor_sigma, log_depth_factor, iterations=4)
                if solution is None:
                    return None
                arm, log_depth_factor = solution.model, solution.log_depth_factor
            return solution

        solution = fit(self._start(q, hand.finger_m, hand), _EDGE_REACHES_PX)
        if solution is None:
            return None
        evidence = self._edge_evidence(solution.model, image)
        flipped = fit(_half_turn(solution.model), _EDGE_REACHES_PX[-2:]) if evidence < 0 else None
        if flipped is not None and (other := self._edge_evidence(flipped.model, image)) > 0:
            solution, evidence = flipped, other
        X_CP = self._poses(solution.model)
        agreement = self._edges.agreement(image, X_CP)
        fitted = self._arm_fit(solution, cells, hand, scale=float("nan"), evidence=evidence, agrees=True)
        return replace(
            fitted,
            agrees=agreement >= _MIN_AGREEMENT,
            edge_agreement=agreement,
            hand_agreement=self._edges.agreement(image, X_CP, (RobotPart.HAND,)),
        )

    def sharpen(
        self, arm: ArmFit, hand: HandFit, close: GripperView, wide: GripperView, image: GradientImage
    ) -> ArmFit:
        """Fit a posture that is right within a few pixels to cells and edges together.

        The edges are more precise, above all in depth, and the cells keep to the right ones among them.

        Args:
            arm: fit to the cells, which is returned if too few edges are near or the fit moves far away.
            hand: fit of the hand alone.
            close: view of the gripper's crop.
            wide: view that shows the arm.
            image: gradients of the frame.
        """
        start, links = self._start(arm.q, arm.finger_m, hand), self._link_cells(close, wide)
        image = self._with_rim(image, close)
        edges = self._edges.match(image, self._poses(start), _SHARPENING_PX, RIGID, _SHARPENING_POINTS)
        if edges is None:
            return arm
        joined = Correspondences.join([gripper_cells(close), links, edges])
        solution = solve(start, joined, close.depth_factor_sigma, float(np.log(hand.depth_factor)), iterations=3)
        if solution is None:
            return arm
        fitted = self._arm_fit(solution, links, hand, scale=arm.scale, evidence=arm.evidence, agrees=True)
        moved_m = pose_difference(fitted.X_CH, arm.X_CH)[0]
        away_px = fitted.consistency_px - arm.consistency_px
        near = moved_m <= _SHARPENING_M and away_px <= _SHARPENING_GROWTH_PX * self._camera.unit_px
        return fitted if fitted.agrees and near else arm

    def _with_rim(self, image: GradientImage, close: GripperView) -> GradientImage:
        """Return the image with the rim of the segmented gripper."""
        cell_px = close.stride * self._camera.fx / close.crop.focal
        return image.with_hand(close.to_frame(close.gripper, self._camera), _RIM_SIGMA_CELLS * cell_px + _RIM_SIGMA_PX)

    def _edge_evidence(self, arm: ArmHandModel, image: GradientImage) -> float:
        """Return the log-likelihood ratio of a posture against half a turn of the last joint, from the edges."""
        as_fitted, flipped = (self._edges.agreement(image, self._poses(a), FLANGE) for a in (arm, _half_turn(arm)))
        return float(np.clip(_EDGE_NATS * (as_fitted - flipped), -_EVIDENCE_CAP, _EVIDENCE_CAP))

    def edge_agreement(self, q: Array, image: GradientImage) -> float:
        """Return the share of the contour of hand and wrist at a posture (7,) that lies on edges of the image."""
        return self._edges.agreement(image, self._X_CB @ self._model.poses(q[None])[0])

    def _poses(self, arm: ArmHandModel) -> Array:
        """Return the poses (PARTS, 4, 4) of the parts in the camera frame [m]."""
        return open_fingers(self._X_CB @ self._model.poses(arm.q[None])[0], arm.finger_m)

    @staticmethod
    def _link_cells(close: GripperView, wide: GripperView) -> Correspondences:
        return Correspondences.join(
            [Correspondences.of_view(v, v.arm, _MAX_CELLS, _INDEPENDENT) for v in (close, wide)]
        )

    def _start(self, q: Array, finger_m: float, hand: HandFit) -> ArmHandModel:
        return ArmHandModel(
            model=self._model,
            X_CB=self._X_CB,
            q=q,
            q_start=q,
            finger_m=finger_or_default(finger_m),
            finger_free=hand.finger_free,
        )

    def _arm_fit(
        self,
        solution: Solution[ArmHandModel],
        links: Correspondences,
        hand: HandFit | None,
        *,
        scale: float,
        evidence: float,
        agrees: bool,
    ) -> ArmFit:
        """Return the fit of a posture; without a hand its fingers are unknown."""
        arm = solution.model
        X_CH, J = arm.hand()
        covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(8))
        consistency = self._consistency_px(arm, links)
        return ArmFit(
            q=arm.q,
            X_CH=X_CH,
            finger_m=float("nan") if hand is None else arm.finger_m if hand.finger_free else hand.finger_m,
            finger_sigma_m=float("nan") if hand is None else float(covariance[7, 7] ** 0.5),
            agrees=agrees and consistency <= self._tolerance_px,
            consistency_px=consistency,
            scale=scale,
            evidence=evidence,
            covariance=J @ covariance[:7, :7] @ J.T,
        )

    @staticmethod
    def _scale(
        solution: Solution[ArmHandModel], cells: Correspondences, depth_factor_sigma: float, hand: HandFit
    ) -> float:
        """Return the hand's distance according to the links over its distance according to its apparent size."""
        arm = solution.model
        of_hand = np.isin(cells.part, GRIPPER)
        by_links = replace(cells, weight=np.where(of_hand, _LINKS_ONLY_WEIGHT, 1.0) * cells.weight)
        links_solution = solve(arm, by_links, depth_factor_sigma, solution.log_depth_factor, iterations=4)
        hand_cells = cells.take(of_hand)
        free = HandModel(X_CH=hand.X_CH, finger_m=arm.finger_m, finger_free=arm.finger_free)
        by_size = replace(hand_cells, range_sigma=np.full(len(hand_cells), _NO_RANGE_SIGMA))
        size_solution = solve(free, by_size, depth_factor_sigma, iterations=4)
        if links_solution is None or size_solution is None:
            return float("nan")
        by_links_m = np.linalg.norm(links_solution.model.hand()[0][:3, 3])
        return float(by_links_m / np.linalg.norm(size_solution.model.X_CH[:3, 3]))

    def _initial_posture(self, X_CH: Array, links: Correspondences) -> tuple[Array, float, float] | None:
        """Return the inverse kinematics solution (7,) that matches the links best, its cost and that of the flip.

        The flipped hand, rotated by 180 degrees about its axis, has the same postures except for the last joint.
        """
        X_BF = invert(self._X_CB) @ X_CH @ self._model.X_HF
        q = analytic_ik(X_BF, _LAST_ANGLES).reshape(-1, 7)
        q = q[np.isfinite(q).all(axis=1)]
        flipped = q.copy()
        flipped[:, 6] = (flipped[:, 6] + 2 * np.pi) % (2 * np.pi) - np.pi
        best: list[tuple[float, Array | None]] = []
        scored = _subsample(links)
        for postures in (q, flipped):
            lower, upper = self._model.lower - OVER_LIMIT_RAD, self._model.upper + OVER_LIMIT_RAD
            candidates = postures[((postures >= lower) & (postures <= upper)).all(axis=1)]
            if not len(candidates):
                best.append((_COST_CAP, None))
                continue
            costs = self._costs(candidates, scored)
            best.append((float(costs.min()), candidates[costs.argmin()]))
        (cost, posture), (flipped_cost, _) = best
        if posture is None:
            return None
        return posture, cost, flipped_cost

    def _costs(self, q: Array, cells: Correspondences) -> Array:
        """Return the mean capped squared residual (M,) of the cells for postures `q` (M, 7)."""
        X = (self._X_CB @ self._model.poses(q))[:, cells.part]
        p_C = np.einsum("mnij,nj->mni", X[..., :3, :3], cells.p_P) + X[..., :3, 3]
        p_L = np.einsum("nij,mnj->mni", cells.R_LC, p_C)
        square = (p_L[..., :2] ** 2).sum(axis=-1) / cells.sigma_m[:, 0] ** 2
        return np.asarray(np.where(p_L[..., 2] > 0, np.minimum(square, _COST_CAP), _COST_CAP).mean(axis=1))

    def _consistency_px(self, arm: ArmHandModel, links: Correspondences) -> float:
        p_C, _ = arm.predict(links)
        p_L = np.einsum("nij,nj->ni", links.R_LC, p_C)
        return float(self._camera.fx * np.median(np.linalg.norm(p_L[:, :2], axis=1) / p_L[:, 2]))


def _half_turn(arm: ArmHandModel) -> ArmHandModel:
    """Return the arm with its last joint turned by 180 degrees."""
    q = arm.q + np.pi * (np.arange(7) == 6) * (1.0 if arm.q[6] < 0 else -1.0)
    return replace(arm, q=q, q_start=q)


def _subsample(links: Correspondences) -> Correspondences:
    return links.take(np.linspace(0, len(links) - 1, _SCORED_CELLS).astype(int))


def _evidence(cost: float, flipped_cost: float) -> float:
    """Return the log-likelihood ratio of a pose against its flip from their mean squared residuals."""
    return float(np.clip(0.5 * (flipped_cost - cost), -_EVIDENCE_CAP, _EVIDENCE_CAP))


def _split(difference: Array, direction: Array) -> tuple[float, float]:
    """Return the lengths of a difference (3,) along and across a direction (3,)."""
    along = float(difference @ direction / np.linalg.norm(direction))
    return abs(along), max(0.0, float(difference @ difference) - along**2) ** 0.5
