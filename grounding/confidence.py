"""Confidence of a frame: the probability that its pose is within 10 mm and 5 degrees of the truth."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import expit

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.tracker import FramePose

CALIBRATION = Path(__file__).parents[1] / "models" / "perception" / "confidence.json"
FEATURES = (
    *("log_sigma", "log_residual", "log_cells", "overlap", "log_level"),
    *("log_position_sigma", "arm_agrees", "log_arm_consistency"),
)
"""What the confidence rests on: the network's own uncertainty, how well its coordinates agree with one rigid pose, how
much of the gripper is seen, how well the rendered gripper covers it, how far depth and apparent size disagree, how well
the position is determined, whether the arm goes with the hand, and how closely."""


def features(pose: FramePose) -> Array:
    """The features (8,) of a frame, each of order one."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Confidence:
    """Logistic regression on `features`, fitted to held-out frames by `kinebench-drake perception calibrate`."""

    intercept: float
    weights: Array
    """(8,) in the order of FEATURES."""

    def probability(self, pose: FramePose) -> float:
        """Probability that the pose is within 10 mm and 5 degrees."""
        return self.probability_of(features(pose))

    def probability_of(self, values: Array) -> float:
        """The same from `features` (8,)."""
        return float(expit(self.intercept + self.weights @ values))

    @classmethod
    def load(cls, path: Path = CALIBRATION) -> "Confidence":
        """Read the shipped calibration.

        Raises:
            SetupError: the file is missing or is not a calibration of these features.
        """
        try:
            data = json.loads(path.read_text())
            if tuple(data["features"]) != FEATURES:
                raise ValueError(f"has features {data['features']}")
            weights = np.array(data["weights"], dtype=np.float64)
            if weights.shape != (len(FEATURES),):
                raise ValueError(f"has {weights.size} weights")
            return cls(intercept=float(data["intercept"]), weights=weights)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SetupError(f"{path.name}: no usable calibration ({error}); run `perception calibrate`") from None

    def save(self, path: Path) -> None:
        """Write the calibration."""
        data = {"features": FEATURES, "intercept": self.intercept, "weights": self.weights.tolist()}
        path.write_text(json.dumps(data, indent=1) + "\n")
