"""Fit of the arm behind the gripper: the posture whose links and gripper match the image.

The base is fixed and the link lengths are known, so the arm determines where the hand is, above all its distance, which
the hand alone determines poorly. The initial posture comes from closed-form inverse kinematics of the hand's own pose
over the angles of the last joint; then all joints are fitted to the cells of links and gripper together.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference
from kinebench_drake.grounding.registration.arm_model import OVER_LIMIT_RAD, POSTURE_SIGMA_RAD, ArmHandModel, ArmModel
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.edges import FLANGE, RIGID, ROBOT, EdgeMatcher, GradientImage
from kinebench_drake.grounding.registration.fit import (
    UNSEEN_FINGER_M,
    HandFit,
    HandModel,
    finger_or_default,
    gripper_cells,
    masked_median,
)
from kinebench_drake.grounding.registration.flow import follow_surface
from kinebench_drake.grounding.registration.silhouette import SilhouetteMatcher
from kinebench_drake.grounding.registration.solver import CellRows, Solution, solve
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.models.panda.cad import open_fingers
from kinebench_drake.models.panda.robot import ARM, RobotPart
from kinebench_drake.models.robot import N_JOINTS

_LAST_ANGLES = np.linspace(-np.pi, np.pi, 32, endpoint=False)
_MAX_CELLS, _SCORED_CELLS = 300, 48
_INDEPENDENT = 30.0  # independent measurements that the arm cells of a view count as
_MIN_CELLS = 60
_SHOULDER_SIGMA_RAD = 1.0  # of joints 1 and 3 about zero: half a turn of both, joint 2 reversed, looks alike
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
FOLLOWED_REACHES_PX = (6.0, 4.0, 3.0, 2.0)
"""Farthest image edges in successive passes from a posture that followed the surface [px]."""
LAST_LINKS = (RobotPart.LINK5, RobotPart.LINK6, RobotPart.LINK7)
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
    """The same of the contour of the hand alone, or of the last link where no hand is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowedArm:
    """Posture that followed the surface of the arm from another frame."""

    q: Array
    """(7,) joint angles [rad]."""
    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    points: Correspondences
    """Points of the surface."""


class ArmFitter:
    """Fitter of the arm to views of one camera."""

    def __init__(self, camera: Camera, model: ArmModel, edges: EdgeMatcher, places: Array | None = None) -> None:
        """Create the fitter; a moving camera has `places` (T, 3) in the frame of `camera` [m]."""
        X_BC = camera.X_BC if places is None else camera.X_BC @ make_pose(np.eye(3), places)
        self._model, self._edges, self._camera = model, edges, camera
        self._X_CB = invert(X_BC).reshape(-1, 4, 4)  # of each frame, or of all
        self._tolerance_px = _MAX_CONSISTENCY_PX * camera.unit_px

    def at(self, numbers: Sequence[int]) -> "ArmFitter":
        """Return the fitter of some frames, in their order: this one, unless the camera moves."""
        if len(self._X_CB) == 1:
            return self
        fitter = copy(self)
        fitter._X_CB = self._X_CB[list(numbers)]
        return fitter

    def fit_all(
        self,
        hands: Sequence[HandFit],
        close: Sequence[GripperView],
        wide: Sequence[GripperView],
        rims: Sequence[Correspondences | None],
    ) -> list[ArmFit | None]:
        """Fit the arms behind the hands of B frames; None where too little of the arm is visible.

        Args:
            hands: fits of the hands alone to `close`.
            close: views of the gripper's crop.
            wide: views of the whole image.
            rims: correspondences of the hands' silhouettes (`SilhouetteMatcher.match`).
        """
        fits: list[ArmFit | None] = [None] * len(hands)
        X_CB = self._bases(len(hands))
        links = [self._link_cells(*views) for views in zip(close, wide, strict=True)]
        initial = {
            b: posture
            for b, cells in enumerate(links)
            if len(cells) >= _MIN_CELLS
            and (posture := self._initial_posture(hands[b].X_CH, cells, X_CB[b])) is not None
        }
        if not initial:
            return fits
        shown = list(initial)
        hands, links = [hands[b] for b in shown], [links[b] for b in shown]
        gripper = [gripper_cells(close[b]) for b in shown]
        cells = [Correspondences.join(pair) for pair in zip(gripper, links, strict=True)]
        joined = [
            own if (rim := rims[b]) is None else Correspondences.join([own, rim])
            for b, own in zip(shown, cells, strict=True)
        ]
        sigma = np.array([close[b].depth_factor_sigma for b in shown])
        q = np.stack([q for q, _, _ in initial.values()])
        start = self._start(q, [h.finger_m for h in hands], hands, X_CB[shown])
        solution = solve(start, Correspondences.stack(joined), sigma, _log_depth_factors(hands))
        X_CH, J = solution.model.hand()
        scale = self._scale(solution, cells, gripper, sigma, hands)
        fitted = self._arm_fits(solution, X_CH, J, links, hands)
        for row, (b, arm) in enumerate(zip(shown, fitted, strict=True)):
            hand, (_, cost, flipped_cost) = hands[row], initial[b]
            if arm is not None:
                agrees = arm.agrees and _is_consistent(arm.X_CH, hand, solution.growth(row, len(gripper[row])))
                evidence = _evidence(cost, flipped_cost)
                fits[b] = replace(arm, agrees=agrees, scale=float(scale[row]), evidence=evidence)
        return fits

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
        arm = self._start(near.q[None], [near.finger_m], [hand], self._X_CB)
        log_depth_factor = _log_depth_factors([hand])
        solution = None
        for gate in _NEIGHBOUR_GATES:
            rim = silhouette.match(close, arm.hand()[0][0], float(arm.finger_m[0]), gate)
            if rim is None:
                return None
            joined = Correspondences.stack([Correspondences.join([cells, rim])])
            solution = solve(arm, joined, np.array([close.depth_factor_sigma]), log_depth_factor, iterations=4)
            if not solution.valid[0]:
                return None
            arm, log_depth_factor = solution.model, solution.log_depth_factor
        if solution is None:
            return None
        evidence = _evidence(*self._costs(np.concatenate([arm.q, _half_turn(arm).q]), _subsample(links), self._X_CB[0]))
        fitted = self._arm_fits(solution, *arm.hand(), [links], [hand])[0]
        return None if fitted is None else replace(fitted, evidence=evidence)

    def fit_links(
        self, X_CH: Array, turn_sigma_rad: float, links: Correspondences, image: GradientImage
    ) -> ArmFit | None:
        """Fit the arm to cells and edges of its links alone; None if the base is out of reach or no edges are near.

        The hand still hides what is behind it: other grippers are as large.

        Args:
            X_CH: (4, 4) pose of panda_hand, right within some pixels [m].
            turn_sigma_rad: standard deviation of its turn about the flange's axis [rad].
            links: cells of the links, which also tell postures with this pose apart.
            image: gradients of the frame.
        """
        initial = self._initial_posture(X_CH, links, self._X_CB[0]) if len(links) >= _MIN_CELLS else None
        if initial is None:
            return None
        q_sigma = np.array([*[POSTURE_SIGMA_RAD] * (N_JOINTS - 1), turn_sigma_rad])
        arm = replace(self._links_at(initial[0][None]), q_sigma=q_sigma)
        fit = None
        for reach_px in FOLLOWED_REACHES_PX:
            edges = self._edges.match(image, self._poses(arm)[0], reach_px, ARM, _SHARPENING_POINTS)
            if edges is None:
                return None
            solution = solve(arm, Correspondences.stack([Correspondences.join([links, edges])]), [LINKS_DEPTH_SIGMA])
            if not solution.valid[0]:
                return None
            arm, fit = solution.model, self._arm_fits(solution, *solution.model.hand(), [links], [None])[0]
        if fit is None:
            return None
        X_CP = self._poses(arm)[0]
        return replace(
            fit,
            agrees=True,
            edge_agreement=self._edges.agreement(image, X_CP, LAST_LINKS),
            hand_agreement=self._edges.agreement(image, X_CP, (RobotPart.LINK7,)),
        )

    def _links_at(self, q: Array) -> ArmHandModel:
        """Return postures (B, 7) of one frame with fixed fingers."""
        return ArmHandModel(
            model=self._model,
            X_CB=self._bases(len(q)),
            q=q,
            q_start=q,
            finger_m=np.full(len(q), UNSEEN_FINGER_M),
            finger_free=np.zeros(len(q), dtype=bool),
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
            initial = self._initial_posture(X_CH, links, self._X_CB[0])
            if initial is not None:
                candidates.append((initial[1], initial[0]))
        likeliest = sorted(candidates, key=lambda candidate: candidate[0])[:_SEARCHED]
        if not likeliest:
            return None
        q = max((q for _, q in likeliest), key=lambda q: self.edge_agreement(q, image))
        return self.refine(q, hand, close, wide, image)

    def follow(self, near: ArmFit, X_CP: Array, before: GradientImage, after: GradientImage) -> FollowedArm | None:
        """Return where the surface of the arm went since a neighbouring frame; None if it cannot be followed.

        Args:
            near: arm of the neighbouring frame.
            X_CP: (PARTS, 4, 4) poses of its parts in the camera frame of that frame [m].
            before: gradients of the neighbouring frame.
            after: gradients of this frame.
        """
        points = follow_surface(self._edges.caster, X_CP, before, after)
        if points is None:
            return None
        solution = solve(self._links_at(near.q[None]), Correspondences.stack([points]), np.array([LINKS_DEPTH_SIGMA]))
        if not solution.valid[0]:
            return None
        return FollowedArm(q=solution.model.q[0], X_CH=solution.model.hand()[0][0], points=points)

    def refine(
        self,
        q: Array,
        hand: HandFit,
        close: GripperView,
        wide: GripperView,
        image: GradientImage,
        followed: Correspondences | None = None,
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
            followed: points of the surface that led to `q`; they count in place of the cells, in all passes.
        """
        cells = Correspondences.join([gripper_cells(close), self._link_cells(close, wide)])
        image = self._with_rim(image, close)

        def fit(arm: ArmHandModel, reaches_px: tuple[float, ...]) -> Solution[ArmHandModel] | None:
            log_depth_factor, solution = _log_depth_factors([hand]), None
            for reach_px in reaches_px:
                with_cells = followed is None and reach_px > _CELLS_REACH_PX
                edges = self._edges.match(image, self._poses(arm)[0], reach_px, ROBOT if with_cells else RIGID)
                if edges is None:
                    return None
                extra = cells if with_cells else followed
                joined = Correspondences.stack([edges if extra is None else Correspondences.join([extra, edges])])
                solution = solve(arm, joined, np.array([close.depth_factor_sigma]), log_depth_factor, iterations=4)
                if not solution.valid[0]:
                    return None
                arm, log_depth_factor = solution.model, solution.log_depth_factor
            return solution

        reaches_px = _EDGE_REACHES_PX if followed is None else FOLLOWED_REACHES_PX
        solution = fit(self._start(q[None], [hand.finger_m], [hand], self._X_CB), reaches_px)
        if solution is None:
            return None
        evidence = self._edge_evidence(solution.model, image)
        flipped = fit(_half_turn(solution.model), _EDGE_REACHES_PX[-2:]) if evidence < 0 else None
        if flipped is not None and (other := self._edge_evidence(flipped.model, image)) > 0:
            solution, evidence = flipped, other
        X_CP = self._poses(solution.model)[0]
        agreement = self._edges.agreement(image, X_CP)
        fitted = self._arm_fits(solution, *solution.model.hand(), [cells], [hand])[0]
        if fitted is None:
            return None
        return replace(
            fitted,
            agrees=agreement >= _MIN_AGREEMENT,
            evidence=evidence,
            edge_agreement=agreement,
            hand_agreement=self._edges.agreement(image, X_CP, (RobotPart.HAND,)),
        )

    def sharpen_all(
        self,
        arms: Sequence[ArmFit],
        hands: Sequence[HandFit],
        close: Sequence[GripperView],
        wide: Sequence[GripperView],
        images: Sequence[GradientImage],
    ) -> list[ArmFit]:
        """Fit postures of B frames that are right within a few pixels to cells and edges together.

        The edges are more precise, above all in depth, and the cells keep to the right ones among them.

        Args:
            arms: fits to the cells, which are returned where too few edges are near or the fit moves far away.
            hands: fits of the hands alone.
            close: views of the gripper's crop.
            wide: views that show the arm.
            images: gradients of the frames.
        """
        sharpened = list(arms)
        q, X_CB = np.stack([arm.q for arm in arms]), self._bases(len(arms))
        start = self._start(q, [arm.finger_m for arm in arms], hands, X_CB)
        edges = self._edges.match_all(
            [self._with_rim(*pair) for pair in zip(images, close, strict=True)],
            self._poses(start),
            _SHARPENING_PX,
            RIGID,
            _SHARPENING_POINTS,
        )
        matched = {b: own for b, own in enumerate(edges) if own is not None}
        if not matched:
            return sharpened
        frames = np.array(list(matched))
        hands, links = [hands[b] for b in frames], [self._link_cells(close[b], wide[b]) for b in frames]
        joined = [
            Correspondences.join([gripper_cells(close[b]), own, matched[b]])
            for b, own in zip(frames, links, strict=True)
        ]
        sigma = np.array([close[b].depth_factor_sigma for b in frames])
        solution = solve(
            start.take(frames), Correspondences.stack(joined), sigma, _log_depth_factors(hands), iterations=3
        )
        fits = self._arm_fits(solution, *solution.model.hand(), links, hands)
        for b, fitted in zip(frames, fits, strict=True):
            if fitted is None or not fitted.agrees:
                continue
            grown_px = fitted.consistency_px - arms[b].consistency_px
            if (
                pose_difference(fitted.X_CH, arms[b].X_CH)[0] <= _SHARPENING_M
                and grown_px <= _SHARPENING_GROWTH_PX * self._camera.unit_px
            ):
                sharpened[b] = replace(fitted, scale=arms[b].scale, evidence=arms[b].evidence)
        return sharpened

    def _with_rim(self, image: GradientImage, close: GripperView) -> GradientImage:
        """Return the image with the rim of the segmented gripper."""
        cell_px = close.stride * self._camera.fx / close.crop.focal
        return image.with_hand(close.to_frame(close.gripper, self._camera), _RIM_SIGMA_CELLS * cell_px + _RIM_SIGMA_PX)

    def _edge_evidence(self, arm: ArmHandModel, image: GradientImage) -> float:
        """Return the log-likelihood ratio of a posture against half a turn of the last joint, from the edges."""
        as_fitted, flipped = (self._edges.agreement(image, self._poses(a)[0], FLANGE) for a in (arm, _half_turn(arm)))
        return float(np.clip(_EDGE_NATS * (as_fitted - flipped), -_EVIDENCE_CAP, _EVIDENCE_CAP))

    def edge_agreement(self, q: Array, image: GradientImage) -> float:
        """Return the share of the contour of hand and wrist at a posture (7,) that lies on edges of the image."""
        return self._edges.agreement(image, self._X_CB[0] @ self._model.poses(q[None])[0])

    def _bases(self, count: int) -> Array:
        """Return the poses (count, 4, 4) of the base in the camera frames of `count` frames [m]."""
        return np.broadcast_to(self._X_CB, (count, 4, 4))

    def poses(self, arm: ArmFit) -> Array:
        """Return the poses (PARTS, 4, 4) of the parts of an arm in the camera frame [m]."""
        return open_fingers(self._X_CB[0] @ self._model.poses(arm.q[None])[0], finger_or_default(arm.finger_m))

    def _poses(self, arm: ArmHandModel) -> Array:
        """Return the poses (B, PARTS, 4, 4) of the parts in the camera frame [m]."""
        return open_fingers(arm.X_CB[:, None] @ self._model.poses(arm.q), arm.finger_m)

    @staticmethod
    def _link_cells(close: GripperView, wide: GripperView) -> Correspondences:
        return Correspondences.join(
            [Correspondences.of_view(v, v.arm, _MAX_CELLS, _INDEPENDENT) for v in (close, wide)]
        )

    def _start(self, q: Array, finger_m: Sequence[float], hands: Sequence[HandFit], X_CB: Array) -> ArmHandModel:
        return ArmHandModel(
            model=self._model,
            X_CB=X_CB,
            q=q,
            q_start=q,
            finger_m=np.array([finger_or_default(travel) for travel in finger_m]),
            finger_free=np.array([hand.finger_free for hand in hands]),
        )

    def _arm_fits(
        self,
        solution: Solution[ArmHandModel],
        X_CH: Array,
        J: Array,
        links: Sequence[Correspondences],
        hands: Sequence[HandFit | None],
    ) -> list[ArmFit | None]:
        """Return the fits of B frames, without scale and evidence; None where they diverged.

        Args:
            solution: solution of the frames.
            X_CH: (B, 4, 4) poses of the hands.
            J: (B, 6, 7) their derivatives.
            links: correspondences whose distance is the consistency.
            hands: fits of the hands alone; None where the fingers are unknown.
        """
        arm, unknown = solution.model, float("nan")
        covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(8))
        of_hand = J @ covariance[:, :7, :7] @ J.swapaxes(1, 2)
        consistency = self._consistency_px(arm, links)
        return [
            ArmFit(
                q=arm.q[b],
                X_CH=X_CH[b],
                finger_m=unknown if hand is None else float(arm.finger_m[b]) if hand.finger_free else hand.finger_m,
                finger_sigma_m=unknown if hand is None else float(covariance[b, 7, 7] ** 0.5),
                agrees=bool(consistency[b] <= self._tolerance_px),
                consistency_px=float(consistency[b]),
                scale=unknown,
                evidence=0.0,
                covariance=of_hand[b],
            )
            if solution.valid[b]
            else None
            for b, hand in enumerate(hands)
        ]

    @staticmethod
    def _scale(
        solution: Solution[ArmHandModel],
        cells: Sequence[Correspondences],
        gripper: Sequence[Correspondences],
        depth_factor_sigma: Array,
        hands: Sequence[HandFit],
    ) -> Array:
        """Return the hands' distances (B,) according to the links over those according to their apparent sizes."""
        arm = solution.model
        stacked = Correspondences.stack(cells)
        by_links = np.where(stacked.part >= RobotPart.LINK0, 1.0, _LINKS_ONLY_WEIGHT) * stacked.weight
        links_solution = solve(
            arm, replace(stacked, weight=by_links), depth_factor_sigma, solution.log_depth_factor, iterations=4
        )
        free = HandModel(
            X_CH=np.stack([hand.X_CH for hand in hands]),
            finger_m=arm.finger_m,
            finger_free=arm.finger_free,
            pose_free=np.ones(len(hands), dtype=bool),
        )
        by_size = Correspondences.stack(gripper)
        by_size = replace(by_size, range_sigma=np.full_like(by_size.range_sigma, _NO_RANGE_SIGMA))
        size_solution = solve(free, by_size, depth_factor_sigma, iterations=4)
        distances = [
            np.linalg.norm(X_CH[:, :3, 3], axis=1)
            for X_CH in (links_solution.model.hand()[0], size_solution.model.X_CH)
        ]
        return np.where(links_solution.valid & size_solution.valid, distances[0] / distances[1], np.nan)

    def _initial_posture(self, X_CH: Array, links: Correspondences, X_CB: Array) -> tuple[Array, float, float] | None:
        """Return the inverse kinematics solution (7,) that matches the links best, its cost and that of the flip.

        The flipped hand, rotated by 180 degrees about its axis, has the same postures except for the last joint.
        """
        X_BF = invert(X_CB) @ X_CH @ self._model.X_HF
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
            costs = self._costs(candidates, scored, X_CB) + _shoulder_cost(candidates)
            best.append((float(costs.min()), candidates[costs.argmin()]))
        (cost, posture), (flipped_cost, _) = best
        if posture is None:
            return None
        return posture, cost, flipped_cost

    def _costs(self, q: Array, cells: Correspondences, X_CB: Array) -> Array:
        """Return the mean capped squared residual (M,) of the cells for postures `q` (M, 7)."""
        rows = CellRows.of(Correspondences.stack([cells]))
        p_L = rows.in_line_frames(rows.place_closed(X_CB @ self._model.poses(q)))
        square = (p_L[:, :2] ** 2).sum(axis=1) * rows.inverse_sigma[:, 0] ** 2
        return np.asarray(np.where(p_L[:, 2] > 0, np.minimum(square, _COST_CAP), _COST_CAP).mean(axis=1))

    def _consistency_px(self, arm: ArmHandModel, links: Sequence[Correspondences]) -> Array:
        """Return the median distances (B,) between links as estimated and as posed [px of the frame]."""
        cells = Correspondences.stack(links)
        rows = CellRows.of(cells)
        p_L = rows.in_line_frames(rows.place_closed(arm.X_CB[:, None] @ self._model.poses(arm.q)))
        distance = np.hypot(p_L[:, 0], p_L[:, 1]) / p_L[:, 2]
        return self._camera.fx * masked_median(distance, cells.weight > 0)


def _log_depth_factors(hands: Sequence[HandFit]) -> Array:
    return np.log([hand.depth_factor for hand in hands])


def _is_consistent(X_CH: Array, hand: HandFit, residual: float) -> bool:
    """Return whether a hand posed by its arm, with the `residual` of its cells there, is near the pose of its own."""
    along, across = _split(X_CH[:3, 3] - hand.X_CH[:3, 3], hand.X_CH[:3, 3])
    return bool(
        along <= _MAX_ALONG_M
        and across <= _MAX_ACROSS_M
        and pose_difference(X_CH, hand.X_CH)[1] <= _MAX_ANGLE_RAD
        and residual <= _MAX_GROWTH * hand.residual + _MAX_GROWTH_SIGMAS
    )


def _half_turn(arm: ArmHandModel) -> ArmHandModel:
    """Return the arm with its last joint turned by 180 degrees."""
    q = arm.q + np.pi * (np.arange(7) == 6) * np.where(arm.q[:, 6:] < 0, 1.0, -1.0)
    return replace(arm, q=q, q_start=q)


def _shoulder_cost(q: Array) -> Array:
    """Return the cost (M,) of how far the shoulder is turned at postures `q` (M, 7), in the unit of a cell's."""
    return np.asarray(((q[:, [0, 2]] / _SHOULDER_SIGMA_RAD) ** 2).sum(axis=1) / _INDEPENDENT)


def _subsample(links: Correspondences) -> Correspondences:
    return links.take(np.linspace(0, len(links) - 1, _SCORED_CELLS).astype(int))


def _evidence(cost: float, flipped_cost: float) -> float:
    """Return the log-likelihood ratio of a pose against its flip from their mean squared residuals."""
    return float(np.clip(0.5 * (flipped_cost - cost), -_EVIDENCE_CAP, _EVIDENCE_CAP))


def _split(difference: Array, direction: Array) -> tuple[float, float]:
    """Return the lengths of a difference (3,) along and across a direction (3,)."""
    along = float(difference @ direction / np.linalg.norm(direction))
    return abs(along), max(0.0, float(difference @ difference) - along**2) ** 0.5
