"""Fit of the arm behind the gripper: the posture whose links and gripper match the image.

The base is fixed and the link lengths are known, so the arm determines where the hand is, above all its distance, which
the hand alone determines poorly. The initial posture comes from closed-form inverse kinematics of the hand's own pose
over the angles of the last joint; then all joints are fitted to the cells of links and gripper together.

From a posture that is nearly right, or from one of a neighbouring frame, the arm is fitted to the edges of the image.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.registration.arm_model import (
    EVIDENCE_CAP,
    POSTURE_SIGMA_RAD,
    ArmHandModel,
    ArmModel,
    find_posture,
    flip_evidence,
    half_turn,
)
from kinebench_drake.grounding.registration.edges import (
    FIT_POINTS,
    FLANGE,
    RIGID,
    ROBOT,
    SIGMA_PX,
    WRIST,
    EdgeMatcher,
)
from kinebench_drake.grounding.registration.fit import (
    UNSEEN_FINGER_M,
    HandFit,
    HandModel,
    finger_or_default,
    gripper_cells,
    masked_median,
)
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage, follow_surface
from kinebench_drake.grounding.registration.solver import CellRows, Correspondences, Solution, solve
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.gripper import X_HALF_TURN
from kinebench_drake.models.panda.description import ARM, RobotPart
from kinebench_drake.models.robot import N_JOINTS

# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_SHARPENING_GROWTH_PX = 1.0
"""Largest increase of the links' distance by a fit to cells and edges [px of an image 384 px wide].

Beyond it, the edges are those beside the right ones."""
LINKS_DEPTH_SIGMA = 0.1
"""Relative standard deviation of the depth factor where only links are measured: looks are often unfamiliar."""
FOLLOWED_REACHES_PX = (6.0, 4.0, 3.0, 2.0)
"""Farthest image edges in successive passes from a posture that followed the surface [px]."""
LAST_LINKS = (RobotPart.LINK5, RobotPart.LINK6, RobotPart.LINK7)
"""Links whose contours say whether the flange is right; those before them may be wrong, or hidden."""
_POINTS = 300
"""Points of the contours, where the posture is nearly right."""
_EDGE_REACHES_PX = (10.0, 5.0, 2.0)
"""Farthest image edges in successive passes [px]."""
_SAME_CONTOUR_PX = 3.0
"""Reach up to which the contour of the pass before still is the visible one [px]."""
_RIM_SIGMA_CELLS = 0.7
"""Standard deviation of the segmented rim of the hand [cells]."""
_EDGE_NATS = 25.0
"""Log-likelihood ratio per difference of edge agreement of hand and flange."""
_MAX_CONSISTENCY_PX = 6.0
"""Largest median distance between links as estimated and as posed of an arm that agrees [px of 384 px of width]."""
_MAX_ACROSS_M = 0.025
"""Largest deviation of a hand posed by an arm that agrees from the fit of the hand alone, across the view [m]."""
_MAX_ALONG_M = 0.08
"""The same along the line of sight [m]."""
_MAX_GROWTH = 1.4
"""Largest increase of the hand's residual by the arm: factor."""
_MAX_GROWTH_SIGMAS = 0.3
"""Summand of this increase [standard deviations]."""
_LINKS_ONLY_WEIGHT = 0.03
"""Weight of the hand's cells where the links alone determine its distance."""
_Match = Callable[[ArmHandModel, Sequence[int], float], Sequence[Correspondences | None]]
"""Correspondences of arms of some frames, by their numbers, within a reach; None for a frame that has too few."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmFit:
    """Posture of the arm fitted to the views of a frame."""

    q: Array
    """(7,) joint angles [rad]."""
    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame at this posture [m]."""
    finger_m: float = float("nan")
    """Travel of each finger [m]; NaN if no finger is visible."""
    finger_sigma_m: float = float("nan")
    """Standard deviation of the travel [m]."""
    agrees: bool = False
    """True if one posture explains both links and hand."""
    consistency_px: float = float("nan")
    """Median distance between the links as estimated and as posed [px of the frame]; NaN if not measured."""
    scale: float = float("nan")
    """Apparent size of the hand over its size at the distance given by the links; NaN if unknown."""
    evidence: float = 0.0
    """Log-likelihood ratio of the hand's pose against the 180-degree flip, from the links."""
    covariance: Array
    """(6, 6) covariance of the hand's rotation about the camera's axes [rad] and position [m]."""
    edge_agreement: float = float("nan")
    """Share of the contour of hand and wrist that lies on edges of the image; NaN if not measured."""
    hand_agreement: float = float("nan")
    """The same of the contour of the hand alone, or of the last link where no hand is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmView:
    """What a frame shows of the arm, and the fit of its hand alone."""

    hand: HandFit
    close: GripperView
    """View of the gripper's crop."""
    gripper: Correspondences
    """Cells of the gripper in that view."""
    links: Correspondences
    """Cells of the links in that view and in one that shows the arm."""

    @classmethod
    def of(cls, hand: HandFit, close: GripperView, wide: GripperView) -> Self:
        """Collect the cells of the views of a gripper's crop and of the arm."""
        links = Correspondences.join([Correspondences.of_view(v, v.arm) for v in (close, wide)])
        return cls(hand=hand, close=close, gripper=gripper_cells(close), links=links)

    @property
    def cells(self) -> Correspondences:
        """Cells of gripper and links."""
        return Correspondences.join([self.gripper, self.links])


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
    """Fitter of the arm to views and edges of one camera."""

    def __init__(self, camera: Camera, model: ArmModel, edges: EdgeMatcher, places: Array | None = None) -> None:
        """Create the fitter; a moving camera has `places` (T, 3) in the frame of `camera` [m]."""
        X_BC = camera.X_BC if places is None else camera.X_BC @ make_pose(np.eye(3), places)
        self._model = model
        self._edges = edges
        self._camera = camera
        self._X_CB = invert(X_BC).reshape(-1, 4, 4)  # of each frame, or of all
        self._tolerance_px = _MAX_CONSISTENCY_PX * camera.unit_px

    def at(self, numbers: Sequence[int]) -> Self:
        """Return the fitter of some frames, in their order: this one, unless the camera moves."""
        if len(self._X_CB) == 1:
            return self
        fitter = copy(self)
        fitter._X_CB = self._X_CB[list(numbers)]
        return fitter

    def is_turned(self, view: ArmView) -> bool:
        """Return whether the links of a frame match a hand better that is flipped."""
        X_CB = self._X_CB[0]
        posture = find_posture(self._model, view.hand.X_CH, view.links, X_CB)
        if posture is not None:
            return posture[2] < posture[1]
        return find_posture(self._model, view.hand.X_CH @ X_HALF_TURN, view.links, X_CB) is not None

    def fit_all(self, views: Sequence[ArmView], rims: Sequence[Correspondences | None]) -> list[ArmFit | None]:
        """Fit the arms of B frames; None where too little of the arm is visible.

        Args:
            views: the frames.
            rims: correspondences of the hands' silhouettes (`SilhouetteMatcher.match`).
        """
        fits: list[ArmFit | None] = [None] * len(views)
        X_CB = self._bases(len(views))
        initial = {
            b: posture
            for b, view in enumerate(views)
            if (posture := find_posture(self._model, view.hand.X_CH, view.links, X_CB[b])) is not None
        }
        if not initial:
            return fits
        rows = list(initial)
        views = [views[b] for b in rows]
        rims = [rims[b] for b in rows]
        cells = [view.cells for view in views]
        joined = [
            own if rim is None else Correspondences.join([own, rim]) for own, rim in zip(cells, rims, strict=True)
        ]
        q = np.stack([q for q, _, _ in initial.values()])
        start = self._start(q, [view.hand.finger_m for view in views], views, X_CB[rows])
        sigma, log_depth_factor = depth_priors(views)
        solution = solve(start, Correspondences.stack(joined), sigma, log_depth_factor)
        scale = self._scale(solution, cells, views)
        fitted = self._arm_fits(solution, [view.links for view in views], [view.hand for view in views])
        for row, (b, arm) in enumerate(zip(rows, fitted, strict=True)):
            if arm is not None:
                growth = solution.growth(row, len(views[row].gripper))
                agrees = arm.agrees and _is_consistent(arm.X_CH, views[row].hand, growth)
                evidence = flip_evidence(*initial[b][1:])
                fits[b] = replace(arm, agrees=agrees, scale=float(scale[row]), evidence=evidence)
        return fits

    def _bases(self, count: int) -> Array:
        """Return the poses (count, 4, 4) of the base in the camera frames of `count` frames [m]."""
        return np.broadcast_to(self._X_CB, (count, 4, 4))

    def poses(self, arm: ArmFit) -> Array:
        """Return the poses (PARTS, 4, 4) of the parts of an arm in the camera frame [m]."""
        return self._model.gripper.open(self.closed(arm), finger_or_default(arm.finger_m))

    def closed(self, arm: ArmFit) -> Array:
        """Return the same with closed fingers."""
        return np.asarray(self._X_CB[0] @ self._model.poses(arm.q[None])[0])

    def _poses(self, arm: ArmHandModel) -> Array:
        """Return the poses (B, PARTS, 4, 4) of the parts in the camera frame [m]."""
        return self._model.gripper.open(arm.X_CB[:, None] @ self._model.poses(arm.q), arm.finger_m)

    def _start(self, q: Array, finger_m: Sequence[float], views: Sequence[ArmView], X_CB: Array) -> ArmHandModel:
        return ArmHandModel(
            model=self._model,
            X_CB=X_CB,
            q=q,
            q_start=q,
            finger_m=np.array([finger_or_default(travel) for travel in finger_m]),
            finger_free=np.array([view.hand.finger_free for view in views]),
        )

    def _arm_fits(
        self,
        solution: Solution[ArmHandModel],
        cells: Sequence[Correspondences],
        hands: Sequence[HandFit | None],
    ) -> list[ArmFit | None]:
        """Return the fits of B frames, without scale and evidence; None where they diverged.

        The distance of the `cells` of each frame is its consistency; the fingers are unknown without a fit of the hand.
        """
        arm = solution.model
        unknown = float("nan")
        covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(8))
        X_CH, J = arm.hand()
        of_hand = J @ covariance[:, :7, :7] @ J.swapaxes(1, 2)
        consistency = self._consistency_px(arm, cells)
        return [
            ArmFit(
                q=arm.q[b],
                X_CH=X_CH[b],
                finger_m=unknown if hand is None else float(arm.finger_m[b]) if hand.finger_free else hand.finger_m,
                finger_sigma_m=unknown if hand is None else float(covariance[b, 7, 7] ** 0.5),
                agrees=bool(consistency[b] <= self._tolerance_px),
                consistency_px=float(consistency[b]),
                covariance=of_hand[b],
            )
            if solution.valid[b]
            else None
            for b, hand in enumerate(hands)
        ]

    @staticmethod
    def _scale(solution: Solution[ArmHandModel], cells: Sequence[Correspondences], views: Sequence[ArmView]) -> Array:
        """Return the hands' distances (B,) according to the links over those according to their apparent sizes."""
        arm = solution.model
        sigma, _ = depth_priors(views)
        by_links = Correspondences.stack(cells)
        weight = np.where(by_links.part >= RobotPart.LINK0, 1.0, _LINKS_ONLY_WEIGHT) * by_links.weight
        by_links = replace(by_links, weight=weight)
        links_solution = solve(arm, by_links, sigma, solution.log_depth_factor, iterations=4)
        free = HandModel(
            X_CH=np.stack([view.hand.X_CH for view in views]),
            finger_m=arm.finger_m,
            finger_free=arm.finger_free,
            pose_free=np.ones(len(views), dtype=bool),
            max_finger_m=np.full(len(views), arm.model.gripper.max_finger_m),
        )
        by_size = Correspondences.stack([view.gripper for view in views])
        by_size = replace(by_size, range_sigma=np.full_like(by_size.range_sigma, np.inf))
        size_solution = solve(free, by_size, sigma, iterations=4)
        distances = [
            np.linalg.norm(X_CH[:, :3, 3], axis=1)
            for X_CH in (links_solution.model.hand()[0], size_solution.model.X_CH)
        ]
        return np.where(links_solution.valid & size_solution.valid, distances[0] / distances[1], np.nan)

    def _consistency_px(self, arm: ArmHandModel, links: Sequence[Correspondences]) -> Array:
        """Return the median distances (B,) between links as estimated and as posed [px of the frame]."""
        cells = Correspondences.stack(links)
        rows = CellRows.of(cells)
        p_L = rows.in_line_frames(rows.place(arm.X_CB[:, None] @ self._model.poses(arm.q))[0])
        return self._camera.fx * masked_median(np.hypot(p_L[:, 0], p_L[:, 1]) / p_L[:, 2], cells.weight > 0)

    def refine_all(
        self,
        q: Array,
        views: Sequence[ArmView],
        images: Sequence[GradientImage],
        followed: Correspondences | None = None,
        *,
        may_turn: bool = True,
    ) -> list[ArmFit | None]:
        """Fit the arms of B frames to the edges of their images, from postures; None where that diverges.

        The first pass also counts the cells, and it alone the fingers: grippers have fingers of many forms. Near the
        hand, whose bevels look like outlines, the edge nearest to its segmented rim is taken.

        The postures `q` (B, 7) [rad] are of these frames or of neighbouring ones. Points of the surface that led to one
        of a single frame, `followed`, count in place of the cells, in all passes. Where the edges speak for it, a hand
        that `may_turn` is turned by half a turn.
        """
        images = [self._with_rim(image, view.close) for image, view in zip(images, views, strict=True)]
        contours: dict[int, EdgePoints | None] = {}

        def match(arm: ArmHandModel, numbers: Sequence[int], reach_px: float) -> list[Correspondences | None]:
            with_cells = followed is None and reach_px == _EDGE_REACHES_PX[0]
            matched = []
            for i, X_CP in zip(numbers, self._poses(arm), strict=True):
                points = contours.get(i)
                camera = images[i].camera
                if points is None or reach_px > _SAME_CONTOUR_PX:
                    points = self._edges.project(X_CP, camera, ROBOT if with_cells else RIGID, FIT_POINTS)
                else:
                    points = points.moved(X_CP, camera)
                contours[i] = points
                edges = None if points is None else self._edges.match_points(images[i], points, reach_px)
                extra = views[i].cells if with_cells else followed
                matched.append(edges if edges is None or extra is None else Correspondences.join([extra, edges]))
            return matched

        fits: list[ArmFit | None] = [None] * len(views)
        reaches_px = _EDGE_REACHES_PX if followed is None else FOLLOWED_REACHES_PX
        start = self._start(q, [view.hand.finger_m for view in views], views, self._bases(len(views)))
        numbers, solution = _solve_in_passes(start, range(len(views)), match, reaches_px, views)
        if solution is None:
            return fits
        evidence = self._edge_evidence(solution.model, [images[i] for i in numbers])
        for i, fit in zip(numbers, self._with_evidence(solution, evidence, [views[i] for i in numbers]), strict=True):
            fits[i] = fit
        contours.clear()
        doubtful = np.flatnonzero([may_turn and of_turn < 0 for of_turn, _, _ in evidence])
        if len(doubtful):
            turned = half_turn(solution.model.take(doubtful))
            numbers = [numbers[k] for k in doubtful]
            numbers, solution = _solve_in_passes(turned, numbers, match, _EDGE_REACHES_PX[-2:], views)
        if len(doubtful) and solution is not None:
            evidence = self._edge_evidence(solution.model, [images[i] for i in numbers])
            refits = self._with_evidence(solution, evidence, [views[i] for i in numbers])
            for i, (of_turn, _, _), fit in zip(numbers, evidence, refits, strict=True):
                if of_turn > 0:
                    fits[i] = fit
        return fits

    def _with_evidence(
        self, solution: Solution[ArmHandModel], evidence: Sequence[tuple[float, float, float]], views: Sequence[ArmView]
    ) -> list[ArmFit | None]:
        """Return the fits of B frames with what the edges say about them (`_edge_evidence`)."""
        fits = self._arm_fits(solution, [view.cells for view in views], [view.hand for view in views])
        return [
            fit
            and replace(
                fit,
                agrees=agreement >= bounds.EDGE_AGREEMENT,
                evidence=of_turn,
                edge_agreement=agreement,
                hand_agreement=of_hand,
            )
            for fit, (of_turn, agreement, of_hand) in zip(fits, evidence, strict=True)
        ]

    def sharpen_all(
        self, arms: Sequence[ArmFit], views: Sequence[ArmView], images: Sequence[GradientImage]
    ) -> list[ArmFit]:
        """Fit postures of B frames that are right within a few pixels to cells and edges together.

        The edges are more precise, above all in depth, and the cells keep to the right ones among them. Fits `arms` to
        the cells are returned where too few edges are near or the fit moves far away.
        """
        sharpened = list(arms)
        X_CB = self._bases(len(arms))
        start = self._start(np.stack([arm.q for arm in arms]), [arm.finger_m for arm in arms], views, X_CB)
        rimmed = [self._with_rim(image, view.close) for image, view in zip(images, views, strict=True)]
        matched = {
            b: own
            for b, (image, X_CP) in enumerate(zip(rimmed, self._poses(start), strict=True))
            if (own := self._edges.match(image, X_CP, FOLLOWED_REACHES_PX[1], RIGID, _POINTS)) is not None
        }
        if not matched:
            return sharpened
        frames = np.array(list(matched))
        views = [views[b] for b in frames]
        joined = [Correspondences.join([v.gripper, v.links, matched[b]]) for b, v in zip(frames, views, strict=True)]
        solution = solve(start.take(frames), Correspondences.stack(joined), *depth_priors(views), iterations=3)
        fits = self._arm_fits(solution, [view.links for view in views], [view.hand for view in views])
        for b, fitted in zip(frames, fits, strict=True):
            if (
                fitted is not None
                and fitted.agrees
                and pose_difference(fitted.X_CH, arms[b].X_CH)[0] <= bounds.FAR_M
                and fitted.consistency_px - arms[b].consistency_px <= _SHARPENING_GROWTH_PX * self._camera.unit_px
            ):
                sharpened[b] = replace(fitted, scale=arms[b].scale, evidence=arms[b].evidence)
        return sharpened

    def follow(self, near: ArmFit, X_CP: Array, before: GradientImage, after: GradientImage) -> FollowedArm | None:
        """Return where the surface of the arm `near` went since a neighbouring frame; None if it cannot be followed.

        Its parts are at `X_CP` (PARTS, 4, 4) in the camera frame of that frame [m].
        """
        points = follow_surface(self._edges.caster, X_CP, before, after)
        if points is None:
            return None
        solution = solve(self._links_at(near.q[None]), Correspondences.stack([points]), np.array([LINKS_DEPTH_SIGMA]))
        arm = solution.model
        return FollowedArm(q=arm.q[0], X_CH=arm.hand()[0][0], points=points) if solution.valid[0] else None

    def refine_links(self, q: Array, image: GradientImage, followed: Correspondences | None = None) -> Array | None:
        """Return a posture (7,) [rad] fitted to the edges of the links; None where too few are near.

        Points of the surface that led to the posture, `followed`, count as well.
        """
        arm = self._links_at(q[None])
        for reach_px in FOLLOWED_REACHES_PX:
            edges = self._edges.match(image, self._poses(arm)[0], reach_px, ARM, _POINTS)
            if edges is None:
                return None
            rows = edges if followed is None else Correspondences.join([followed, edges])
            solution = solve(arm, Correspondences.stack([rows]), np.array([LINKS_DEPTH_SIGMA]))
            if not solution.valid[0]:
                return None
            arm = solution.model
        return np.asarray(arm.q[0])

    def fit_links(
        self, X_CH: Array, turn_sigma_rad: float, links: Correspondences, image: GradientImage
    ) -> ArmFit | None:
        """Fit the arm to cells and edges of its links alone; None if the base is out of reach or no edges are near.

        The hand still hides what is behind it: other grippers are as large. Its pose `X_CH` (4, 4) [m] is right within
        some pixels, its turn about the flange's axis has the standard deviation `turn_sigma_rad`, and the cells of the
        links also tell postures with this pose apart.
        """
        initial = find_posture(self._model, X_CH, links, self._X_CB[0])
        if initial is None:
            return None
        q_sigma = np.array([*[POSTURE_SIGMA_RAD] * (N_JOINTS - 1), turn_sigma_rad])
        arm = replace(self._links_at(initial[0][None]), q_sigma=q_sigma)
        fit = None
        for reach_px in FOLLOWED_REACHES_PX:
            edges = self._edges.match(image, self._poses(arm)[0], reach_px, ARM, _POINTS)
            if edges is None:
                return None
            solution = solve(arm, Correspondences.stack([Correspondences.join([links, edges])]), [LINKS_DEPTH_SIGMA])
            if not solution.valid[0]:
                return None
            arm = solution.model
            fit = self._arm_fits(solution, [links], [None])[0]
        if fit is None:
            return None
        X_CP = self._poses(arm)[0]
        return replace(
            fit,
            agrees=True,
            edge_agreement=self._edges.agreement(image, X_CP, LAST_LINKS),
            hand_agreement=self._edges.agreement(image, X_CP, (RobotPart.LINK7,)),
        )

    def hand(self, q: Array) -> Array:
        """Return the pose (4, 4) of panda_hand in the camera frame at a posture (7,) [m]."""
        return np.asarray(self._links_at(q[None]).hand()[0][0])

    def edge_agreement(self, q: Array, image: GradientImage) -> float:
        """Return the share of the contour of hand and wrist at a posture (7,) that lies on edges of the image."""
        return self._edges.agreement(image, self._X_CB[0] @ self._model.poses(q[None])[0])

    def _edge_evidence(self, arm: ArmHandModel, images: Sequence[GradientImage]) -> list[tuple[float, float, float]]:
        """Return the log-likelihood ratio of each posture against half a turn of the last joint, from the edges.

        Also how well the edges agree with the contours of the wrist, and of the hand alone.
        """
        groups = (WRIST, FLANGE, (RobotPart.HAND,))
        evidence = []
        for image, X_CP, turned in zip(images, self._poses(arm), self._poses(half_turn(arm)), strict=True):
            wrist, as_fitted, hand = self._edges.agreements(image, X_CP, groups)
            difference = as_fitted - self._edges.agreement(image, turned, FLANGE)
            evidence.append((float(np.clip(_EDGE_NATS * difference, -EVIDENCE_CAP, EVIDENCE_CAP)), wrist, hand))
        return evidence

    def _with_rim(self, image: GradientImage, close: GripperView) -> GradientImage:
        """Return the image with the rim of the segmented gripper."""
        cell_px = close.stride * self._camera.fx / close.crop.focal
        return image.with_hand(close.to_frame(close.gripper, self._camera), _RIM_SIGMA_CELLS * cell_px + SIGMA_PX)

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


def _solve_in_passes(
    arm: ArmHandModel, numbers: Sequence[int], match: _Match, reaches: Sequence[float], views: Sequence[ArmView]
) -> tuple[list[int], Solution[ArmHandModel] | None]:
    """Fit arms of the frames `numbers` of `views` to what `match` returns of them within each of `reaches`.

    Returns the numbers of the frames that have a fit in every pass, and their fits; None without any.
    """
    numbers = list(numbers)
    solution = None
    sigma, log_depth_factor = depth_priors([views[i] for i in numbers])
    for reach in reaches:
        cells = {k: own for k, own in enumerate(match(arm, numbers, reach)) if own is not None}
        if not cells:
            return [], None
        matched = np.array(list(cells))
        stacked = Correspondences.stack(list(cells.values()))
        solution = solve(arm.take(matched), stacked, sigma[matched], log_depth_factor[matched], iterations=4)
        kept = matched[solution.valid]
        if not len(kept):
            return [], None
        solution = solution.take(solution.valid)
        numbers = [numbers[k] for k in kept]
        sigma = sigma[kept]
        arm = solution.model
        log_depth_factor = solution.log_depth_factor
    return numbers, solution


def depth_priors(views: Sequence[ArmView]) -> tuple[Array, Array]:
    """Return the relative standard deviations (B,) of the depth factors, and their logarithms (B,) by the hands."""
    sigma = np.array([view.close.depth_factor_sigma for view in views])
    return sigma, np.log([view.hand.depth_factor for view in views])


def _is_consistent(X_CH: Array, hand: HandFit, residual: float) -> bool:
    """Return whether a hand posed by its arm, with the `residual` of its cells there, is near the pose of its own."""
    difference = X_CH[:3, 3] - hand.X_CH[:3, 3]
    along = float(difference @ hand.X_CH[:3, 3] / np.linalg.norm(hand.X_CH[:3, 3]))
    return bool(
        abs(along) <= _MAX_ALONG_M
        and max(0.0, float(difference @ difference) - along**2) ** 0.5 <= _MAX_ACROSS_M
        and pose_difference(X_CH, hand.X_CH)[1] <= bounds.MAX_ANGLE_RAD
        and residual <= _MAX_GROWTH * hand.residual + _MAX_GROWTH_SIGMAS
    )
