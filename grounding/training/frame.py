"""A rendered training frame, and the folders of them.

A data set is a folder of shards, each a scene's worth of frames stored as plain `.npy` files that training maps into
memory: `rgb` (N, S, S, 3) uint8, `depth` (N, S, S) uint16 [0.1 mm] of the gripper's pixels (0 elsewhere), `part`
(N, S, S) uint8 (`Part`), and `truth.npz` with `K` (N, 3, 3), `camera_from_hand` (N, 4, 4), `finger_m` (N,).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.part import GRIPPER

DEPTH_UNIT_M = 1e-4
"""Unit of stored depth [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One rendered frame with its truth."""

    rgb: NDArray[np.uint8]
    """(S, S, 3)."""
    depth: NDArray[np.uint16]
    """(S, S) depth of gripper pixels along the camera's z [0.1 mm], 0 elsewhere."""
    part: NDArray[np.uint8]
    """(S, S) values of `Part`."""
    K: Array
    """(3, 3) intrinsics [px]."""
    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float
    """Opening of each finger, 0..0.04 [m]."""

    @property
    def gripper(self) -> NDArray[np.bool_]:
        """(S, S) pixels that show hand or fingers."""
        return np.isin(self.part, GRIPPER)


def shard_folder(folder: Path, seed: int) -> Path:
    """Where the scene of a seed is stored."""
    return folder / f"{seed:06d}"


def is_complete(shard: Path) -> bool:
    """Whether a shard was written to its end."""
    return (shard / "truth.npz").is_file()


def save_shard(frames: Sequence[Frame], shard: Path) -> None:
    """Write a scene's frames; the truth last, as it marks the shard complete."""
    shard.mkdir(parents=True, exist_ok=True)
    for name in ("rgb", "depth", "part"):
        np.save(shard / f"{name}.npy", np.stack([getattr(f, name) for f in frames]))
    np.savez(
        shard / "truth.npz",
        K=np.stack([f.K for f in frames]),
        camera_from_hand=np.stack([f.X_CH for f in frames]),
        finger_m=np.array([f.finger_m for f in frames]),
    )
