"""Bundle adjustment: camera, focal length, postures and finger openings of several frames, by robust least squares.

The link lengths are known and the base is fixed, so the arm is the calibration target (Triggs et al., "Bundle
adjustment, a modern synthesis", 1999). Unknown are the camera's pose and focal length, common to all frames, and seven
joint angles and an opening per frame. The frames' unknowns are eliminated from the normal equations (Schur complement),
so a step costs little more than the evaluation of the residuals.

Contours of one part err together: surfaces darken or shine towards their outlines, and meshes differ from the robot. So
each part has one offset of its contours, common to all frames: sizes count less than places.
"""

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, make_pose, rotation_z
from kinebench_drake.grounding.camera.detections import CalibrationCorrespondences, RobotPoints
from kinebench_drake.grounding.camera.lens import UNKNOWNS, Lens
from kinebench_drake.grounding.camera.surroundings import Surroundings
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.solver import CAUCHY, NEAREST_M
from kinebench_drake.models.panda.cad import MAX_FINGER_M
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.models.robot import N_JOINTS

_A_FRAME = N_JOINTS + 1
_PARTS = len(RobotPart)
_SHARED = UNKNOWNS + _PARTS
"""Number of unknowns that frames have in common: the camera's, and the offsets of contours."""
_POSTURE_SIGMA_RAD = np.array([10.0, *[1.5] * 6])
"""Standard deviations of unknown joint angles about their start [rad]: they keep joints that nothing shows."""
_OPENING_INFORMATION = 25.0
"""Information of an opening that nothing shows [1/m^2]."""
_BEHIND = 1e3
"""Cost of a point behind the camera."""
_LARGEST_STEP_RAD = 0.4
_LARGEST_STEP_M = 0.4
_LARGEST_ZOOM = 0.2
_LARGEST_SHIFT = 0.1
"""Largest step of the principal point over the width of the image."""
_CONVERGED = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations(RobotPoints):
    """N points of the robot observed in T frames."""

    whitening: Array
    """(N, 2, 2) matrices that turn an error [px] into standard deviations; the second row of an edge is 0."""

    @classmethod
    def of_cells(cls, cells: CalibrationCorrespondences, sigma_px: Array) -> "Observations":
        """Return cells with the standard deviations (N,) of their places [px]."""
        own = {f.name: getattr(cells, f.name) for f in fields(RobotPoints)}
        return cls(**own, whitening=np.eye(2) / sigma_px[:, None, None])

    def at_rest(self, p_B: Array) -> "Observations":
        """Return them as points `p_B` (N, 3) of the base's frame [m] that no joint moves."""
        return replace(self, part=np.zeros_like(self.part), p_P=p_B, opening_sign=np.zeros(len(self)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmScene:
    """Unknowns of a bundle adjustment."""

    lens: Lens
    q: Array
    """(T, 7) joint angles [rad]."""
    finger_m: Array
    """(T,) opening of each finger [m]."""
    offset: Array = field(default_factory=lambda: np.zeros(_PARTS))
    """(PARTS,) how far out the images show the contours of each part, in standard deviations of one of their points."""

    def take(self, rows: NDArray[np.intp]) -> "ArmScene":
        """Select frames."""
        return replace(self, q=self.q[rows], finger_m=self.finger_m[rows])

    def turned(self, angle_rad: float) -> "ArmScene":
        """Return the scene with the base turned by minus an angle about joint 1, and joint 1 by it: same links."""
        X_CB = self.lens.X_CB @ make_pose(rotation_z(-angle_rad), np.zeros(3))
        return replace(self, lens=replace(self.lens, X_CB=X_CB), q=self.q + angle_rad * (np.arange(N_JOINTS) == 0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Gaussian prior of lens, postures and offsets of contours."""

    lens: Lens
    """Mean of focal length and principal point."""
    log_focal_sigma: float
    """Standard deviation of the logarithm of the focal length; 0 for a fixed one, infinite for an unknown one."""
    centre_sigma_px: float = 0.0
    """Standard deviation of the principal point [px]; 0 for a fixed one."""
    place_free: bool = True
    """False to keep the place of the camera."""
    joint_sigma_rad: float | None = None
    """Standard deviation of known joint angles [rad]; None if they are unknown."""
    offset_sigma: float = 0.0
    """Standard deviation of the offset of a part's contours, in those of one of their points; 0 for none."""
    surroundings: Surroundings | None = None
    """Lines along the axes of the base."""

    def of_lens(self, lens: Lens) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return information (9,), deviation (9,) of a lens from the mean, and which unknowns are free (9,)."""
        camera = lens.intrinsics
        mean = self.lens.intrinsics
        sigma = np.array([*[np.inf if self.place_free else 0.0] * 6, self.log_focal_sigma, *[self.centre_sigma_px] * 2])
        free = sigma > 0
        deviation = np.array([*[0.0] * 6, np.log(camera.fx / mean.fx), camera.cx - mean.cx, camera.cy - mean.cy])
        return np.where(free, 1.0 / np.where(free, sigma, 1.0) ** 2, 0.0), deviation, free


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleAdjustment:
    """Result of a bundle adjustment."""

    scene: ArmScene
    cost: float
    """Weighted mean of Cauchy's loss."""
    error_px: Array
    """(N,) errors in the directions that are measured [px]."""
    information: Array
    """(9, 9) inverse covariance of the camera, postures and offsets eliminated; 0 for what is fixed."""
    response: Array
    """(T, 7, 9) derivative of the fitted joint angles by the camera."""

    @property
    def covariance(self) -> Array:
        """(9, 9) covariance of the camera's unknowns (see `Lens.displace`); 0 for what is fixed."""
        diagonal = np.diag(self.information)
        free = np.flatnonzero(diagonal > 0)
        root = np.sqrt(diagonal[free])
        scale = np.outer(root, root)
        covariance = np.zeros((UNKNOWNS, UNKNOWNS))
        inverse = np.linalg.pinv(self.information[np.ix_(free, free)] / scale + 1e-9 * np.eye(len(free)))
        covariance[np.ix_(free, free)] = inverse / scale
        return covariance


def adjust(
    observations: Observations,
    start: ArmScene,
    prior: Prior,
    model: ArmModel,
    *,
    q: Array | None = None,
    q_sigma: Array | float | None = None,
    iterations: int = 20,
) -> BundleAdjustment:
    """Minimise Cauchy's loss of all errors by Levenberg-Marquardt.

    Args:
        observations: points observed in T frames.
        start: initial unknowns.
        prior: prior of the unknowns.
        model: link poses of the arm.
        q: (T, 7) mean of the joint angles [rad]; None for the initial ones.
        q_sigma: their standard deviations [rad], of all or each (T, 7); None for those of `prior`.
        iterations: greatest number of steps.
    """
    if q_sigma is None:
        q_sigma = _POSTURE_SIGMA_RAD if prior.joint_sigma_rad is None else prior.joint_sigma_rad
    postures = start.q if q is None else q, np.broadcast_to(np.asarray(q_sigma, dtype=np.float64), start.q.shape)
    scene = start
    damping = 1e-3
    current = _Linearization(observations, scene, prior, *postures, model)
    for _ in range(iterations):
        lens_step, frame_steps = current.step(damping)
        candidate = _update(scene, lens_step, frame_steps, model)
        trial = _Linearization(observations, candidate, prior, *postures, model)
        if trial.cost < current.cost:
            gain = current.cost - trial.cost
            scene = candidate
            current = trial
            damping = max(damping / 5, 1e-7)
            if gain < _CONVERGED * current.cost:
                break
        else:
            damping *= 8
            if damping > 1e4:
                break
    return current.bundle()


def _update(scene: ArmScene, step: Array, frame_steps: Array, model: ArmModel) -> ArmScene:
    shift_px = _LARGEST_SHIFT * scene.lens.intrinsics.width
    bound = np.array([*[_LARGEST_STEP_RAD] * 3, *[_LARGEST_STEP_M] * 3, _LARGEST_ZOOM, shift_px, shift_px])
    lens_step = step[:UNKNOWNS] / max(1.0, float((np.abs(step[:UNKNOWNS]) / bound).max()))
    q = scene.q + np.clip(frame_steps[:, :N_JOINTS], -_LARGEST_STEP_RAD, _LARGEST_STEP_RAD)
    return ArmScene(
        lens=scene.lens.displace(lens_step),
        q=model.clip(q),
        finger_m=np.clip(scene.finger_m + frame_steps[:, N_JOINTS], 0.0, MAX_FINGER_M),
        offset=scene.offset + step[UNKNOWNS:],
    )


class _Linearization:
    """Cost and normal equations at one scene."""

    def __init__(
        self, observations: Observations, scene: ArmScene, prior: Prior, q: Array, q_sigma: Array, model: ArmModel
    ) -> None:
        """Linearize the errors; `q` and `q_sigma` (T, 7) are mean and standard deviations of the joint angles [rad]."""
        o = observations
        lens = scene.lens
        self._scene = scene
        self._o = o
        X_BP, axis, point = model.poses_and_axes(scene.q)
        p_B = o.locate(X_BP, scene.finger_m)
        uv, z = lens.project(p_B)
        of_contour = ~o.whitening[:, 1].any(axis=1)
        self._residual = np.einsum("nij,nj->ni", o.whitening, uv - o.uv_px)
        self._residual[of_contour, 0] += scene.offset[o.part[of_contour]]
        square = (self._residual**2).sum(axis=1)
        behind = z < NEAREST_M
        dq = scene.q - q
        q_information = 1.0 / q_sigma**2
        lens_information, deviation, free = prior.of_lens(lens)
        offset_information = 1.0 / prior.offset_sigma**2 if prior.offset_sigma else 0.0
        loss = CAUCHY**2 * np.log1p(square / CAUCHY**2) + _BEHIND * behind
        self._data_cost = float((o.weight * loss).sum())
        self.cost = (
            self._data_cost
            + float((q_information * dq**2).sum())
            + float((lens_information * deviation**2).sum())
            + offset_information * float((scene.offset**2).sum())
        )
        by_lens, by_C = lens.derivatives(p_B)
        by_B = by_C @ lens.X_CB[:3, :3]
        turning = np.cross(axis[o.frame], p_B[:, None] - point[o.frame]) * model.moves[o.part][..., None]
        opening = o.opening_sign[:, None] * X_BP[o.frame, o.part, :3, 1]
        moving = np.concatenate([turning, opening[:, None]], axis=1)
        by_offset = np.zeros((len(o), 2, _PARTS))
        by_offset[of_contour, 0, o.part[of_contour]] = 1.0
        by_frame = o.whitening @ by_B @ np.swapaxes(moving, 1, 2)
        J = np.concatenate([o.whitening @ by_lens, by_offset, by_frame], axis=2)
        W = o.weight / (1.0 + square / CAUCHY**2) * ~behind
        frames = len(scene.q)
        n = _SHARED + _A_FRAME
        self._H = np.zeros((frames, n, n))
        self._g = np.zeros((frames, n))
        for t in range(frames):
            own = o.frame == t
            flat = J[own].reshape(-1, n)
            weighted = flat * np.repeat(W[own], 2)[:, None]
            self._H[t] = flat.T @ weighted
            self._g[t] = weighted.T @ self._residual[own].ravel()
        k = np.arange(_SHARED, _SHARED + N_JOINTS)
        self._H[:, k, k] += q_information
        self._g[:, k] += q_information * dq
        self._H[:, -1, -1] += _OPENING_INFORMATION
        self._information = np.diag([*lens_information, *[offset_information] * _PARTS])
        self._gradient = np.array([*lens_information * deviation, *offset_information * scene.offset])
        self._free = np.array([*free, *[prior.offset_sigma > 0] * _PARTS])
        if prior.surroundings is not None:
            cost, information, gradient = prior.surroundings.linearize(lens)
            self.cost += cost
            self._information[:UNKNOWNS, :UNKNOWNS] += information
            self._gradient[:UNKNOWNS] += gradient

    def _eliminate(self, damping: float) -> tuple[Array, Array, Array, Array]:
        """Return normal matrix and gradient of what frames have in common, and the frames' back substitution."""
        c = slice(None, _SHARED)
        s = slice(_SHARED, None)
        k = np.arange(_A_FRAME)
        S = self._H[:, s, s].copy()
        S[:, k, k] = S[:, k, k] * (1 + damping) + 1e-9
        back = np.linalg.solve(S, np.concatenate([self._H[:, s, c], self._g[:, s, None]], axis=2))
        H = (self._H[:, c, c] - self._H[:, c, s] @ back[..., :-1]).sum(axis=0) + self._information
        g = (self._g[:, c] - (self._H[:, c, s] @ back[..., -1:])[..., 0]).sum(axis=0) + self._gradient
        return H, g, back[..., :-1], back[..., -1]

    def step(self, damping: float) -> tuple[Array, Array]:
        """Return the steps of camera and offsets (9 + PARTS,) and of the frames (T, 8)."""
        H, g, back, own = self._eliminate(damping)
        k = np.arange(_SHARED)
        H[k, k] += damping * self._H[:, k, k].sum(axis=0) + 1e-9
        free = np.flatnonzero(self._free)
        step = np.zeros(_SHARED)
        step[free] = -np.linalg.solve(H[np.ix_(free, free)], g[free])
        return step, -own - back @ step

    def bundle(self) -> BundleAdjustment:
        """Return the result with its information."""
        H, _, back, _ = self._eliminate(0.0)
        c = slice(None, UNKNOWNS)
        s = slice(UNKNOWNS, None)
        offsets = np.linalg.solve(H[s, s], H[s, c]) if self._free[s].any() else np.zeros((_PARTS, UNKNOWNS))
        information = H[c, c] - H[c, s] @ offsets
        fixed = ~self._free[c]
        information[fixed] = information[:, fixed] = 0.0
        W = self._o.whitening
        per_px = np.sqrt((W**2).sum(axis=(1, 2)) / np.maximum((np.abs(W).sum(axis=2) > 0).sum(axis=1), 1))
        return BundleAdjustment(
            scene=self._scene,
            cost=self._data_cost / max(float(self._o.weight.sum()), 1e-9),
            error_px=np.linalg.norm(self._residual, axis=1) / np.maximum(per_px, 1e-9),
            information=information,
            response=-(back[..., c] - back[..., s] @ offsets)[:, :N_JOINTS],
        )
