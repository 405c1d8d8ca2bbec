"""Confidence of a frame: the probability that its pose is within 10 mm and 5 degrees of the truth.

Two steps, both logistic regressions fitted by `kinebench-drake perception calibrate`: what the frame shows by itself,
and what the frames around say of it.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.frame_pose import FramePose

GOOD_M, GOOD_RAD = 0.010, float(np.deg2rad(5.0))
"""The confidence is the probability of errors below both."""
CALIBRATION = Path(__file__).parents[1] / "models" / "perception" / "confidence.json"
FRAME_FEATURES = (
    *("log_sigma", "log_residual", "log_cells", "overlap", "log_level"),
    *("log_position_sigma", "arm_agrees", "log_arm_consistency"),
)
"""What a frame by itself is judged by: the network's own uncertainty, how well its coordinates agree with one rigid
pose, how much of the gripper is seen, how well the rendered gripper covers it, how far depth and apparent size
disagree, how well the position is determined, whether the arm goes with the hand, and how closely."""
TRACK_FEATURES = ("frame_logit", "log_distance", "log_angle", "alone")
"""What it is judged by among others: the frame by itself, how far off it is from what its neighbours say, and whether
there are too few of them to say anything."""
_CERTAIN = 1e-3  # confidences of single frames are kept this far from 0 and 1


def frame_features(pose: FramePose) -> Array:
    """The features (8,) of a frame by itself, each of order one."""
    arm = pose.arm if pose.arm is not None and pose.arm.agrees else None
    return np.array(
        [
            np.log(max(pose.fit.sigma_m, 1e-4) / 0.005),
            np.log(max(pose.fit.residual, 1e-2)),
            np.log(max(pose.fit.points, 1) / 400.0),
            4.0 * (pose.overlap - 0.8),
            50.0 * abs(np.log(pose.fit.depth_factor)),
            np.log(max(float(np.trace(pose.covariance[3:, 3:])) ** 0.5, 1e-4) / 0.005),
            float(arm is not None),
            np.log(max(arm.consistency_px, 0.1) / 2.5) if arm is not None else 0.0,
        ]
    )


def track_features(confidence: ArrayLike, distance_m: ArrayLike, angle_rad: ArrayLike) -> Array:
    """The features (T, 4) of frames among others.

    Args:
        confidence: (T,) of each by itself.
        distance_m: (T,) of its position from what its neighbours say [m]; NaN where they say nothing.
        angle_rad: (T,) likewise of its rotation [rad].
    """
    by_itself = logit(np.clip(confidence, _CERTAIN, 1.0 - _CERTAIN))
    alone = ~np.isfinite(distance_m)
    distance = np.log(np.maximum(np.where(alone, 0.01, distance_m), 1e-3) / 0.01)
    angle = np.log(np.maximum(np.where(alone, 0.05, angle_rad), 5e-3) / 0.05)
    return np.stack([by_itself, distance, angle, alone.astype(np.float64)], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Logistic:
    """A logistic regression."""

    intercept: float
    weights: Array
    """(n,) by feature."""

    def probability(self, features: ArrayLike) -> Array:
        """Probabilities (...,) of `features` (..., n)."""
        return np.asarray(expit(self.intercept + np.asarray(features, dtype=np.float64) @ self.weights))


@dataclass(frozen=True, slots=True, kw_only=True)
class Confidence:
    """Both steps."""

    frame: Logistic
    """Of a frame by itself, in the order of FRAME_FEATURES."""
    track: Logistic
    """Of a frame among others, in the order of TRACK_FEATURES."""

    @classmethod
    def load(cls, path: Path = CALIBRATION) -> "Confidence":
        """Read the shipped calibration.

        Raises:
            SetupError: the file is missing or is not a calibration of these features.
        """
        try:
            data = json.loads(path.read_text())
            return cls(frame=_read(data["frame"], FRAME_FEATURES), track=_read(data["track"], TRACK_FEATURES))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SetupError(f"{path.name}: no usable calibration ({error}); run `perception calibrate`") from None

    def save(self, path: Path) -> None:
        """Write the calibration."""
        steps = (("frame", self.frame, FRAME_FEATURES), ("track", self.track, TRACK_FEATURES))
        data = {
            name: {"features": names, "intercept": step.intercept, "weights": step.weights.tolist()}
            for name, step, names in steps
        }
        path.write_text(json.dumps(data, indent=1) + "\n")


def _read(data: dict[str, object], features: tuple[str, ...]) -> Logistic:
    weights = np.array(data["weights"], dtype=np.float64)
    if data["features"] != list(features) or weights.shape != (len(features),):
        raise ValueError(f"has {weights.size} weights for the features {data['features']}")
    return Logistic(intercept=float(str(data["intercept"])), weights=weights)
