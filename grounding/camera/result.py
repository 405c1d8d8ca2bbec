"""The result of a camera calibration, its uncertainty and its description."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.grounding.camera.correspondences import MIN_CELLS, CalibrationCorrespondences
from kinebench_drake.grounding.camera.fit import UNKNOWNS, LensFit, refine
from kinebench_drake.grounding.camera.solve import LensSolution
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.panda.robot import ARM, GRIPPER, RobotPart

_GROUPS = {"gripper": GRIPPER, "arm": ARM[1:], "base": ARM[:1]}


class CalibrationMethod(Enum):
    """Source of the robot's postures."""

    JOINTS = "joint angles of the frames"
    POSES = "poses of the gripper in the frames"
    POSTURE = "posture of one frame"
    MOTION = "motion without joint angles"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCalibration:
    """Calibrated camera with its uncertainty."""

    camera: Camera
    method: CalibrationMethod
    source: str
    """Source of the postures."""
    frames: NDArray[np.intp]
    """(T,) numbers of the frames used."""
    focal_free: bool
    """True if the focal length was estimated."""
    position_sigma_m: float
    """Standard deviation of the camera position, from the Jacobian: root of the sum over three axes [m]."""
    rotation_sigma_rad: float
    """Standard deviation of the camera rotation [rad]."""
    focal_sigma: float
    """Relative standard deviation of the focal length; 0 if it was fixed."""
    residual_px: float
    """Of a fit to cells the root mean square of the reprojection error, weighted by the certainty of each cell; of one
    to contours the median distance from edges [px]."""
    part_px: dict[str, float]
    """Median error [px] of the cells or contour points of gripper, arm and base."""
    part_cells: dict[str, int]
    """Number of cells or contour points of gripper, arm and base."""
    inlier_share: float
    """Share of the cells within four standard deviations, or of the contour points on edges."""
    spread_m: Array
    """(K,) distances between the camera and those estimated from single frames [m]."""
    spread_rad: Array
    """(K,) angles between the camera and those estimated from single frames [rad]."""
    depth_m: tuple[float, float]
    """Depths of the nearest and farthest visible parts of the robot, 5th and 95th percentile [m]."""
    motion_m: float
    """Greatest distance between hand positions in the frames [m]."""
    agreement: float | None = None
    """Share of the contours of hand and arm on image edges; None if the camera was fitted to cells alone."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""

    @property
    def fitted_to(self) -> str:
        """Measurements of the fit: "cells" or "contours"."""
        return "cells" if self.agreement is None else "contours"

    def to_json(self) -> dict[str, Json]:
        """Serialize all results; the camera as in `camera.json`."""

        def quantiles(values: Array, unit: float) -> Json:
            if not len(values):
                return None
            return {"median": float(np.median(values)) * unit, "95%": float(np.quantile(values, 0.95)) * unit}

        return {
            "camera": self.camera.to_json(),
            "method": self.method.value,
            "source": self.source,
            "frames": self.frames.tolist(),
            "focal_length": "estimated" if self.focal_free else "fixed",
            "sigma": {
                "position_mm": 1e3 * self.position_sigma_m,
                "rotation_deg": float(np.rad2deg(self.rotation_sigma_rad)),
                "focal_percent": 100 * self.focal_sigma,
            },
            "fitted_to": self.fitted_to,
            "residual_px": self.residual_px,
            "part_median_px": {name: px if np.isfinite(px) else None for name, px in self.part_px.items()},
            "part_cells": dict(self.part_cells),
            "inlier_share": self.inlier_share,
            "agreement": self.agreement,
            "frame_position_mm": quantiles(self.spread_m, 1e3),
            "frame_rotation_deg": quantiles(self.spread_rad, 180 / np.pi),
            "depth_m": list(self.depth_m),
            "hand_motion_m": self.motion_m,
            "warnings": list(self.warnings),
        }


def describe(
    solution: LensSolution, *, method: CalibrationMethod, source: str, frames: NDArray[np.intp], focal_free: bool
) -> CameraCalibration:
    """Compute the calibration of a solution.

    Args:
        solution: fitted lens with its data.
        method: source of the postures.
        source: description of the source.
        frames: (T,) numbers of the frames used.
        focal_free: True if the focal length was estimated.
    """
    fit, cells, p_B = solution.fit, solution.cells, solution.p_B
    hands_B = solution.X_BP[:, RobotPart.HAND, :3, 3]
    position, rotation, focal = _sigmas(fit, UNKNOWNS if focal_free else UNKNOWNS - 1)
    error = np.linalg.norm(fit.residual_px, axis=1)
    sure = cells.weight / fit.sigma_px**2
    groups = {name: np.isin(cells.part, parts) for name, parts in _GROUPS.items()}
    _, z = fit.lens.project(p_B)
    spread_m, spread_rad = _spread(fit, cells, p_B)
    near, far = np.quantile(z[fit.inlier], [0.05, 0.95]) if fit.inlier.any() else (np.nan, np.nan)
    apart = np.linalg.norm(hands_B[:, None] - hands_B[None], axis=-1)
    return CameraCalibration(
        camera=fit.lens.to_camera(),
        method=method,
        source=source,
        frames=frames,
        focal_free=focal_free,
        position_sigma_m=position,
        rotation_sigma_rad=rotation,
        focal_sigma=focal,
        residual_px=float(np.sqrt((sure * error**2)[fit.inlier].sum() / max(sure[fit.inlier].sum(), 1e-12))),
        part_px={name: float(np.median(error[of])) if of.any() else float("nan") for name, of in groups.items()},
        part_cells={name: int(of.sum()) for name, of in groups.items()},
        inlier_share=float(fit.inlier.mean()),
        spread_m=spread_m,
        spread_rad=spread_rad,
        depth_m=(float(near), float(far)),
        motion_m=float(np.nanmax(apart)) if len(hands_B) else 0.0,
    )


def describe_estimate(
    estimate: CameraEstimate, model: ArmModel, *, method: CalibrationMethod, source: str, focal_free: bool
) -> CameraCalibration:
    """Return the calibration of a camera that was fitted to contours.

    Args:
        estimate: the camera, with postures.
        model: link poses of the arm.
        method: source of the postures.
        source: description of the source.
        focal_free: True if the focal length was estimated.
    """
    X_BP = model.poses(estimate.scene.q)
    hands_B = X_BP[:, RobotPart.HAND, :3, 3]
    z = (estimate.scene.lens.X_CB @ X_BP)[:, np.unique(estimate.contour_part), 2, 3]
    groups = {name: np.isin(estimate.contour_part, parts) for name, parts in _GROUPS.items()}
    error = estimate.contour_error_px
    near, far = np.quantile(z, [0.05, 0.95])
    return CameraCalibration(
        camera=estimate.camera,
        method=method,
        source=source,
        frames=estimate.rows,
        focal_free=focal_free,
        position_sigma_m=estimate.position_sigma_m,
        rotation_sigma_rad=estimate.rotation_sigma_rad,
        focal_sigma=estimate.focal_sigma,
        residual_px=estimate.residual_px,
        part_px={name: float(np.median(error[of])) if of.any() else float("nan") for name, of in groups.items()},
        part_cells={name: int(of.sum()) for name, of in groups.items()},
        inlier_share=estimate.agreement,
        spread_m=np.zeros(0),
        spread_rad=np.zeros(0),
        depth_m=(float(near), float(far)),
        motion_m=float(np.linalg.norm(hands_B[:, None] - hands_B[None], axis=-1).max()),
        agreement=estimate.agreement,
    )


def _sigmas(fit: LensFit, free: int) -> tuple[float, float, float]:
    """Return standard deviations of camera position [m] and rotation [rad], and of the focal length (relative)."""
    H = fit.information[:free, :free]
    scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
    covariance = np.linalg.pinv(H / np.outer(scale, scale) + 1e-9 * np.eye(free)) / np.outer(scale, scale)
    focal = float(covariance[6, 6]) ** 0.5 if free == UNKNOWNS else 0.0
    return fit.lens.position_sigma_m(covariance[:6, :6]), float(np.trace(covariance[:3, :3])) ** 0.5, focal


def _spread(fit: LensFit, cells: CalibrationCorrespondences, p_B: Array) -> tuple[Array, Array]:
    """Return distances [m] and angles [rad] between the camera and those of single frames, at fixed focal length."""
    X_BC = fit.lens.to_camera().X_BC
    deviations = []
    for frame in np.unique(cells.frame):
        own = cells.frame == frame
        if own.sum() >= MIN_CELLS and len(np.unique(cells.part[own])) > 1:
            alone = refine(cells.take(own), p_B[own], fit.lens, focal_free=False, rounds=1)
            deviations.append(pose_difference(alone.lens.to_camera().X_BC, X_BC))
    distance, angle = np.array(deviations, dtype=np.float64).reshape(-1, 2).T
    return distance, angle


def format_lines(calibration: CameraCalibration) -> list[str]:
    """Format the calibration as lines of text."""
    c, camera = calibration, calibration.camera
    place = ", ".join(f"{1e3 * x:.0f}" for x in camera.X_BC[:3, 3])
    fov = np.rad2deg(2 * np.arctan(camera.width / 2 / camera.fx))
    sure = f" +- {100 * c.focal_sigma:.1f} %" if c.focal_free else ", fixed"
    report = [
        f"from: {c.source}; {len(c.frames)} frames, {sum(c.part_cells.values())} points of the robot's {c.fitted_to} "
        f"(gripper {c.part_cells['gripper']}, arm {c.part_cells['arm']}, base {c.part_cells['base']})",
        f"camera in the base frame: {place} mm, +- {1e3 * c.position_sigma_m:.0f} mm, "
        f"{np.rad2deg(c.rotation_sigma_rad):.2f} degrees",
        f"focal length: {camera.fx:.1f} px{sure} (field of view {fov:.1f} degrees across {camera.width} px)",
        f"residual: {c.residual_px:.2f} px {'rms' if c.agreement is None else 'median'}; medians "
        + ", ".join(f"{name} {px:.1f}" for name, px in c.part_px.items() if np.isfinite(px)),
    ]
    if c.agreement is not None:
        report.append(f"contours of hand and arm on image edges: {c.agreement:.0%}")
    if len(c.spread_m) > 1:
        report.append(
            f"single frames: {1e3 * np.median(c.spread_m):.0f} mm and {np.rad2deg(np.median(c.spread_rad)):.2f} "
            f"degrees from it (median of {len(c.spread_m)}), 95 %: {1e3 * np.quantile(c.spread_m, 0.95):.0f} mm, "
            f"{np.rad2deg(np.quantile(c.spread_rad, 0.95)):.2f} degrees"
        )
    report.append(
        f"depth of the robot: {c.depth_m[0]:.2f} to {c.depth_m[1]:.2f} m; the hand moves {1e3 * c.motion_m:.0f} mm"
    )
    return [*report, *(f"warning: {warning}" for warning in c.warnings)]
