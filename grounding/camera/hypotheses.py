"""Initial cameras and postures of frames whose camera, focal length and joint angles are all unknown.

For a focal length, perspective-n-point gives the hand's pose in the camera of one frame. From the hand the arm is
followed link by link towards the base: each joint's angle decides where the next link appears (beam search). The
camera of each frame's best chain is then tried in the other frames: closed-form inverse kinematics of their hands gives
their postures, and the cells of their links say how well the camera explains them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.camera.detections import CalibrationCorrespondences
from kinebench_drake.grounding.camera.lens import Lens, solve_pnp, with_focal
from kinebench_drake.grounding.registration.arm_model import LAST_ANGLES_RAD, USUAL_Q, ArmModel
from kinebench_drake.grounding.registration.solver import NEAREST_M
from kinebench_drake.grounding.tracking.flange_fit import MIN_LINK_CELLS
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.models.gripper import X_HALF_TURN
from kinebench_drake.models.panda.description import ARM, RobotPart
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.segments import evenly

_ANGLES = 36
"""Angles of a joint whose next link is visible."""
_COARSE_ANGLES = 9
"""Angles of a joint whose next link is not visible."""
_BEAM = 100
_CELLS = 8
"""Cells of a link that are compared."""
_CAP = 16.0
"""Greatest squared error of a cell [variances]."""
_EXPLAINED = 9.0
"""Mean capped error of a frame above which its hand is no hand, or the camera another."""
_SLACK_M = 0.02
"""Standard deviation that the start of the chain adds to a cell [m]."""
_SLACK_PX = 2.0
"""The same in the image [px]."""
_LINK_FACTOR = 0.4
"""Factor of the cells' standard deviations: a wrong chain is farther off than they are."""
_DEPTH_SIGMA = 0.04
_ROLL_SIGMA_RAD = np.deg2rad(12.0)
_USUAL_SIGMA = np.array([1.2, 0.7, 0.6, 0.7, 0.7, 0.7, 1.3])
_PRIOR_WEIGHT = 0.05
_TIE = 1e-3
"""Difference of costs that says nothing."""
_DISTANCES = np.exp(np.array([0.0, -0.16, -0.08, 0.08, 0.16]))
"""Distances of a hand that are tried, over that of its pose."""
_COMPARED_FRAMES = 6
"""Frames in which all chains are compared."""
_KEPT = 32
"""Chains that are compared in all frames."""
_FLIP_COST = 0.5
"""Cost of a gripper turned against its cells."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hypothesis:
    """Camera and postures of all frames."""

    lens: Lens
    q: Array
    """(T, 7) joint angles [rad]; NaN in frames that it does not explain."""
    flipped: NDArray[np.bool_]
    """(T,) frames whose gripper is turned by 180 degrees against its cells."""
    costs: Array
    """(T,) mean capped squared errors of the cells of hand and links; NaN in frames without them."""

    @property
    def cost(self) -> float:
        """Mean of `costs`."""
        return float(np.nanmean(self.costs)) if np.isfinite(self.costs).any() else _CAP


class ChainSearch:
    """Search for cameras that explain the cells of several frames."""

    def __init__(self, cells: CalibrationCorrespondences, finger_m: Array, model: ArmModel) -> None:
        """Sort the cells of T frames, whose fingers are each opened by `finger_m` (T,), by frame and part."""
        self._model = model
        self._frames = len(finger_m)
        frames = [cells.take(cells.frame == t) for t in range(self._frames)]
        self._gripper = [self._opened(own, finger) for own, finger in zip(frames, finger_m, strict=True)]
        self._links = [self._link_cells(own) for own in frames]
        zero = model.poses(np.zeros((1, N_JOINTS)))[0]
        self._X_H7 = invert(zero[RobotPart.HAND]) @ zero[RobotPart.LINK7]
        self._grids = [self._relative(joint, _ANGLES) for joint in range(N_JOINTS)]
        self._coarse = [self._relative(joint, _COARSE_ANGLES) for joint in range(N_JOINTS)]

    @staticmethod
    def _opened(cells: CalibrationCorrespondences, finger_m: float) -> CalibrationCorrespondences | None:
        """Return the cells of the gripper in the hand's frame, opened by `finger_m`; None if there are too few."""
        cells = cells.take(cells.of_gripper)
        opened_H = cells.p_P + cells.opening_sign[:, None] * [0.0, finger_m, 0.0]
        return replace(cells, p_P=opened_H) if len(cells) >= MIN_LINK_CELLS else None

    @staticmethod
    def _link_cells(cells: CalibrationCorrespondences) -> dict[int, CalibrationCorrespondences]:
        """Return some cells of each link that shows enough of them."""
        links = {int(part): cells.take(cells.part == part) for part in ARM}
        return {part: _some(own, _CELLS) for part, own in links.items() if len(own) >= MIN_LINK_CELLS}

    def _relative(self, joint: int, count: int) -> tuple[Array, Array]:
        """Return angles (G,) of a joint [rad] and poses (G, 4, 4) of the link before it in the link after it."""
        angle = np.linspace(self._model.lower[joint], self._model.upper[joint], count)
        q = np.zeros((count, N_JOINTS))
        q[:, joint] = angle
        X = self._model.poses(q)
        return angle, invert(X[:, ARM[joint + 1]]) @ X[:, ARM[joint]]

    def hands(self, camera: Camera) -> list[Array | None]:
        """Return the poses X_CH (4, 4) of the hand in all frames by perspective-n-point; None where it fails."""
        solutions = [None if cells is None else solve_pnp(cells.p_P, cells.uv_px, camera) for cells in self._gripper]
        poses = (None if solution is None else solution[0] for solution in solutions)
        return [X_CH if X_CH is not None and X_CH[2, 3] > NEAREST_M else None for X_CH in poses]

    def _errors(self, X_CP: Array, cells: CalibrationCorrespondences, camera: Camera) -> Array:
        """Return the capped squared errors (M, n) of cells of one part at poses `X_CP` (M, 4, 4)."""
        p = cells.p_P @ np.swapaxes(X_CP[:, :3, :3], -1, -2) + X_CP[:, None, :3, 3]
        z = np.maximum(p[..., 2], NEAREST_M)
        du = p[..., 0] / z * camera.fx + (camera.cx - cells.uv_px[:, 0])
        dv = p[..., 1] / z * camera.fy + (camera.cy - cells.uv_px[:, 1])
        spread_m = np.hypot(_SLACK_M, cells.sigma_m * _LINK_FACTOR)
        sigma = _SLACK_PX * camera.unit_px + camera.fx / z * spread_m
        log_sigma = _DEPTH_SIGMA + spread_m / z
        square = (du**2 + dv**2) / sigma**2 + (np.log(z / (cells.depth_per_px * camera.fx)) / log_sigma) ** 2
        return np.asarray(np.where(p[..., 2] > NEAREST_M, np.minimum(square, _CAP), _CAP))

    def _prior(self, X_CB: Array, q: Array) -> Array:
        """Return the cost (M,) of unusual postures and of cameras that are not upright."""
        roll = np.arctan2(X_CB[:, 0, 2], -X_CB[:, 1, 2])
        tilt = np.minimum((roll * np.hypot(X_CB[:, 0, 2], X_CB[:, 1, 2]) / _ROLL_SIGMA_RAD) ** 2, 9.0)
        return np.asarray(_PRIOR_WEIGHT * (tilt + np.minimum(((q - USUAL_Q) / _USUAL_SIGMA) ** 2, 9.0).sum(axis=1)))

    def follow(self, frame: int, X_CH: Array, camera: Camera) -> tuple[Array, float]:
        """Return base pose X_CB (4, 4) and mean cost of the best chain of one frame."""
        links = self._links[frame]
        X = (X_CH @ self._X_H7)[None]
        q = np.zeros((1, N_JOINTS))
        cost = np.zeros(1)
        count = 1e-9
        for joint in range(N_JOINTS - 1, -1, -1):
            cells = links.get(int(ARM[joint]))
            angle, step = self._grids[joint] if cells is not None else self._coarse[joint]
            X_next = (X[:, None] @ step[None]).reshape(-1, 4, 4)
            q_next = np.repeat(q, len(angle), axis=0)
            q_next[:, joint] = np.tile(angle, len(q))
            total = np.repeat(cost, len(angle))
            if cells is not None:
                total = total + self._errors(X_next, cells, camera).mean(axis=1)
                count += 1.0
            total = total + 0.2 * _PRIOR_WEIGHT * np.minimum(
                ((q_next[:, joint] - USUAL_Q[joint]) / _USUAL_SIGMA[joint]) ** 2, 9.0
            )
            best = np.argsort(total, kind="stable")[:_BEAM] if cells is not None else _spread(total, 4 * _BEAM)
            X = X_next[best]
            q = q_next[best]
            cost = total[best]
        cost = cost / count + self._prior(X, q)
        first = int(cost.argmin())
        return X[first], float(cost[first])

    def explain(self, lens: Lens, hands: Sequence[Array | None] | None = None) -> Hypothesis:
        """Return the postures of all frames that a camera explains, by inverse kinematics of their `hands`."""
        q = np.full((self._frames, N_JOINTS), np.nan)
        flipped = np.zeros(self._frames, dtype=bool)
        costs = np.full(self._frames, np.nan)
        for t, X_CH in enumerate(self.hands(lens.intrinsics) if hands is None else hands):
            if X_CH is not None and self._links[t]:
                fit = self._posture(X_CH, t, lens)
                costs[t] = _CAP
                if fit is not None and fit[2] <= _EXPLAINED:
                    q[t], flipped[t], costs[t] = fit
        return Hypothesis(lens=lens, q=q, flipped=flipped, costs=costs)

    def _posture(self, X_CH: Array, frame: int, lens: Lens) -> tuple[Array, bool, float] | None:
        """Return the posture (7,) that explains hand and links of a frame best, whether its hand is flipped, its cost.

        The distance of a small hand is the least certain part of its pose: others than that of `X_CH` are tried.
        """
        X = np.repeat(X_CH[None], len(_DISTANCES), axis=0)
        X[:, :3, 3] *= _DISTANCES[:, None]
        hand = self._gripper[frame]
        links = self._links[frame]
        hand_cost = np.zeros(len(X))
        if hand is not None:
            hand_cost = self._errors(X, _some(hand, 2 * _CELLS), lens.intrinsics).mean(axis=1)
        X_BH = invert(lens.X_CB) @ np.concatenate([X, X @ X_HALF_TURN])
        q = analytic_ik((X_BH @ self._model.X_HF)[:, None], LAST_ANGLES_RAD).reshape(-1, N_JOINTS)
        of_pose = np.repeat(np.arange(len(X_BH)), len(q) // len(X_BH))
        with np.errstate(invalid="ignore"):
            possible = np.flatnonzero(self._model.within_limits(q))
        if not len(possible):
            return None
        q = q[possible]
        flipped = of_pose[possible] >= len(X)
        start = np.tile(hand_cost, 2)[of_pose[possible]] + _FLIP_COST * flipped
        X_CP = lens.X_CB @ self._model.poses(q)
        errors = [self._errors(X_CP[:, part], cells, lens.intrinsics).mean(axis=1) for part, cells in links.items()]
        cost = (np.sum(errors, axis=0) + start) / (len(links) + 1)
        cost = cost + self._prior(np.repeat(lens.X_CB[None], len(q), axis=0), q)
        best = int(cost.argmin())
        return q[best], bool(flipped[best]), float(cost[best])

    def run(self, camera: Camera, focals: Sequence[float]) -> list[Hypothesis]:
        """Return hypotheses for several focal lengths [px], the best first.

        The chains of all frames are compared in some of them, and the best ones in all.
        """
        few = evenly(self._frames, _COMPARED_FRAMES)
        compared = []
        for focal in focals:
            lens_camera = with_focal(camera, focal)
            hands = self.hands(lens_camera)
            some = [X_CH if t in few else None for t, X_CH in enumerate(hands)]
            for t, X_CH in enumerate(hands):
                if X_CH is not None and len(self._links[t]) >= 2:
                    X_CB, _ = self.follow(t, X_CH, lens_camera)
                    lens = Lens(intrinsics=lens_camera, X_CB=X_CB)
                    compared.append((self.explain(lens, some).cost, lens, hands))
        best = sorted(compared, key=lambda entry: entry[0])[:_KEPT]
        return sorted((self.explain(lens, hands) for _, lens, hands in best), key=lambda h: h.cost)


def _some(cells: CalibrationCorrespondences, most: int) -> CalibrationCorrespondences:
    """Return so many cells at most, evenly spread."""
    return cells.take(np.linspace(0, len(cells) - 1, min(len(cells), most)).astype(int))


def _spread(total: Array, most: int) -> NDArray[np.intp]:
    """Return the indices of the best, ties in the order of their spread over the beam."""
    if len(total) <= most:
        return np.arange(len(total))
    order = np.argsort(total, kind="stable")
    if np.ptp(total) < _TIE:
        order = order[np.linspace(0, len(order) - 1, most).astype(int)]
    return np.asarray(order[:most], dtype=np.intp)
