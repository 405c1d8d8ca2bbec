"""Pose of the gripper in one frame, with the fits behind it, and its confidence.

The confidence is the probability that the pose is within 10 mm and 5 degrees of the truth: two logistic regressions for
each domain, fitted by `python -m training calibrate`. One is on features of the frame alone, the other on its result
and the deviation from the neighbouring frames.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.arm_fit import ArmFit
from kinebench_drake.grounding.registration.fit import HandFit
from kinebench_drake.grounding.registration.hand_contour import HandShape
from kinebench_drake.grounding.registration.icp import FusedPose
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.track import Domain

CALIBRATION = Path(__file__).parents[2] / "models" / "perception" / "confidence.json"
_HAND_FEATURES = (
    *("log_sigma", "log_residual", "log_cells", "overlap", "log_level"),
    *("log_position_sigma", "arm_agrees", "log_arm_consistency", "edge_agreement", "icp_fitness", "log_icp_rmse"),
)
_FLANGE_FEATURES = ("log_residual", "log_cells", "flange_agreement", "log_position_sigma", "log_rotation_sigma")
FRAME_FEATURES: Mapping[Domain, tuple[str, ...]] = {
    Domain.FAMILIAR: _HAND_FEATURES,
    Domain.UNFAMILIAR: _HAND_FEATURES,
    Domain.ARM: _FLANGE_FEATURES,
}
"""Features of a single frame by domain.

With a hand: the network's own uncertainty, the residual of its coordinates against one rigid pose, the visible cells,
the overlap with the rendered gripper, the disagreement of depth and apparent size, the standard deviation of the
position, whether the arm is consistent with the hand, and how closely, the share of the contour on edges of the image
where the pose was fitted to them, and how well the depth matches the CAD surface.

Of the arm alone: the residual of the fit, the visible cells of the last link, the share of its contours on edges of the
image, and the standard deviations of position and rotation."""
TRACK_FEATURES = ("frame_logit", "log_distance", "log_angle", "alone")
"""Features of a frame in its track: the log-odds of the frame alone, its deviation from the pose predicted by its
neighbours, and whether there are too few of them for a prediction."""
_CERTAIN = 1e-3
"""Least distance of a single frame's confidence from 0 and 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FramePose:
    """Pose of the gripper in one frame, with the fits that its confidence is computed from."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float = float("nan")
    """Travel of each finger [m]; NaN if no finger was visible."""
    finger_sigma_m: float = float("nan")
    """Standard deviation of the travel [m]."""
    hand: HandFit
    """Fit of the hand alone, without the arm."""
    hand_without_silhouette: HandFit
    """Fit to the cells alone: the silhouette would bias it where the gripper is deformed."""
    arm: ArmFit | None
    """Fit of the arm; None if too little of it is visible."""
    view: GripperView
    """View of the crop around the gripper."""
    overlap: float
    """Intersection over union of the segmented and the rendered gripper; of the arm alone `ArmFit.edge_agreement`."""
    from_prior: bool = False
    """True if the pose was taken from priors."""
    shape: HandShape | None = None
    """Shape of the hand's contour, in unfamiliar videos; None where its arm does not agree or it is not measured."""
    gap_log_likelihood: Array | None = None
    """(G,) log-likelihood of `GAPS_M` by the edges of the image, in unfamiliar videos where the arm agrees."""
    is_between: bool = False
    """True if the hand alone was measured (`StridedTracker`); the rest is that of a frame beside it."""
    icp: FusedPose | None = None
    """Combination of the fit with the registration of the depth; None before it, or if too few points match."""

    @property
    def covariance(self) -> Array:
        """(6, 6) covariance of rotation about the camera's axes [rad] and position [m], from cells and ICP."""
        if self.icp is not None:
            return self.icp.covariance
        return self.arm.covariance if self.arm is not None and self.arm.agrees else self.hand.covariance

    @property
    def arm_agrees(self) -> bool:
        """True if one posture explains both links and hand."""
        return self.arm is not None and self.arm.agrees

    @property
    def own_q(self) -> Array:
        """(7,) joint angles [rad] where hand and arm agree in this very frame; else NaN."""
        return self.arm.q if self.arm is not None and self.arm.agrees and not self.is_between else np.full(7, np.nan)

    def with_arm(self, arm: ArmFit, overlap: float) -> "FramePose":
        """Return the pose with another fit of the arm in place of its own, and its overlap."""
        return replace(
            self,
            X_CH=arm.X_CH,
            finger_m=arm.finger_m,
            finger_sigma_m=arm.finger_sigma_m,
            arm=arm,
            overlap=overlap,
            icp=None,
        )


def frame_features(pose: FramePose, domain: Domain) -> Array:
    """Return the features (n,) of a single frame in the order of `FRAME_FEATURES`, each of order one."""
    return _flange_features(pose) if domain is Domain.ARM else _hand_features(pose)


def _hand_features(pose: FramePose) -> Array:
    icp = None if pose.icp is None else pose.icp.registration
    arm = pose.arm if pose.arm is not None and pose.arm.agrees else None
    return np.array(
        [
            np.log(max(pose.hand.sigma_m, 1e-4) / 0.005),
            np.log(max(pose.hand.residual, 1e-2)),
            np.log(max(pose.hand.points, 1) / 400.0),
            4.0 * (pose.overlap - 0.8),
            50.0 * abs(np.log(pose.hand.depth_factor)),
            np.log(max(float(np.trace(pose.covariance[3:, 3:])) ** 0.5, 1e-4) / 0.005),
            float(arm is not None),
            np.log(max(arm.consistency_px, 0.1) / 2.5) if arm is not None else 0.0,
            4.0 * float(np.nan_to_num(arm.edge_agreement)) if arm is not None else 0.0,
            10.0 * (icp.fitness - 0.9) if icp is not None else -5.0,
            np.log(max(icp.rmse_m, 1e-4) / 0.002) if icp is not None else 0.0,
        ]
    )


def _flange_features(pose: FramePose) -> Array:
    arm = pose.arm
    rotation, position = (float(np.trace(block)) ** 0.5 for block in (pose.covariance[:3, :3], pose.covariance[3:, 3:]))
    return np.array(
        [
            np.log(max(pose.hand.residual, 1e-2)),
            np.log(max(pose.hand.points, 1) / 100.0),
            4.0 * (arm.hand_agreement - 0.5) if arm is not None else -2.0,
            np.log(max(position, 1e-4) / 0.005),
            np.log(max(rotation, 1e-3) / 0.1),
        ]
    )


def track_features(confidence: ArrayLike, distance_m: ArrayLike, angle_rad: ArrayLike) -> Array:
    """Return the features (T, 4) of the frames of a track from the `confidence` (T,) of each by itself.

    Distance (T,) [m] and angle (T,) [rad] are those from the pose predicted by its neighbours; NaN without one.
    """
    frame_logit = logit(np.clip(confidence, _CERTAIN, 1.0 - _CERTAIN))
    alone = ~np.isfinite(distance_m)
    distance = np.log(np.maximum(np.where(alone, 0.01, distance_m), 1e-3) / 0.01)
    angle = np.log(np.maximum(np.where(alone, 0.05, angle_rad), 5e-3) / 0.05)
    return np.stack([frame_logit, distance, angle, alone.astype(np.float64)], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogisticRegression:
    """Logistic regression."""

    intercept: float
    weights: Array
    """(n,) weight of each feature."""

    def probability(self, features: ArrayLike) -> Array:
        """Return the probabilities (...,) for `features` (..., n)."""
        return np.asarray(expit(self.intercept + np.asarray(features, dtype=np.float64) @ self.weights))


@dataclass(frozen=True, slots=True, kw_only=True)
class Confidence:
    """Calibrated confidence of frames of one domain."""

    frame: LogisticRegression
    """Regression on FRAME_FEATURES."""
    track: LogisticRegression
    """Regression on TRACK_FEATURES."""


def frame_confidence(pose: FramePose | None, domain: Domain, confidence: Mapping[Domain, Confidence]) -> float:
    """Return the confidence of a single frame, 0..1: 0 without a pose, 1 for one that was given."""
    if pose is None or pose.from_prior:
        return float(pose is not None)
    return float(confidence[domain].frame.probability(frame_features(pose, domain)))


def load_confidence(path: Path = CALIBRATION) -> Mapping[Domain, Confidence]:
    """Read a calibration, by default the shipped one.

    Raises:
        SetupError: the file is missing or is not a calibration of these features.
    """
    try:
        data = json.loads(path.read_text())
        return {
            domain: Confidence(
                frame=_read(data[domain.value]["frame"], FRAME_FEATURES[domain]),
                track=_read(data[domain.value]["track"], TRACK_FEATURES),
            )
            for domain in Domain
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SetupError(f"{path.name}: no usable calibration ({error}); run `python -m training calibrate`") from None


def save_confidence(confidence: Mapping[Domain, Confidence], path: Path) -> None:
    """Write a calibration."""
    data = {
        domain.value: {
            name: {"features": names, "intercept": step.intercept, "weights": step.weights.tolist()}
            for name, step, names in (("frame", c.frame, FRAME_FEATURES[domain]), ("track", c.track, TRACK_FEATURES))
        }
        for domain, c in confidence.items()
    }
    path.write_text(json.dumps(data, indent=1) + "\n")


def _read(data: dict[str, object], features: tuple[str, ...]) -> LogisticRegression:
    weights = np.array(data["weights"], dtype=np.float64)
    if data["features"] != list(features) or weights.shape != (len(features),):
        raise ValueError(f"has {weights.size} weights for the features {data['features']}")
    return LogisticRegression(intercept=float(str(data["intercept"])), weights=weights)
