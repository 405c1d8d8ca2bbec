"""Rendered training frames and their storage in shards.

A data set is a folder of shards, one per scene, each of plain `.npy` files that training maps into memory: `rgb`
(N, S, S, 3) uint8, `depth` (N, S, S) uint16 [0.1 mm] of robot pixels (0 elsewhere), `part` (N, S, S) uint8
(`RobotPart`), and `truth.npz` with `K` (N, 3, 3), `camera_from_hand` (N, 4, 4), `camera_from_links` (N, 8, 4, 4),
`finger_m` (N,).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp
from kinebench_drake.models.panda.description import ARM, GRIPPER, HAND_LINK, LINK_OF, RobotPart

DEPTH_UNIT_M = 1e-4
"""Unit of stored depth [m]."""
RENDERED_DEPTH_BIAS_M = 0.0005
"""Mean truncation error of SAPIEN's depth in whole millimetres [m]."""
FILES = ("rgb.npy", "depth.npy", "part.npy", "truth.npz")
"""Files of a shard."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedFrame:
    """Rendered frame with ground truth."""

    rgb: NDArray[np.uint8]
    """(S, S, 3) image."""
    depth: NDArray[np.uint16]
    """(S, S) depth of robot pixels along the camera's z axis [0.1 mm], 0 elsewhere."""
    part: NDArray[np.uint8]
    """(S, S) values of `RobotPart`."""
    K: Array
    """(3, 3) intrinsics [px]."""
    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    X_CL: Array
    """(8, 4, 4) poses of panda_link0 to panda_link7 in the camera frame [m]."""
    finger_m: float
    """Opening of each finger, 0..0.04 [m]."""

    @property
    def gripper(self) -> NDArray[np.bool_]:
        """(S, S) pixels of hand and fingers."""
        return np.isin(self.part, GRIPPER)

    @classmethod
    def from_image(
        cls,
        rgb: NDArray[np.uint8],
        depth_m: NDArray[np.floating[Any]],
        part: NDArray[np.uint8],
        camera: Camera,
        X_BL: Mapping[str, Array],
        finger_m: float,
    ) -> "RenderedFrame":
        """Return the frame of an image, with links at poses `X_BL` ((4, 4) by name, in the robot base frame) [m]."""
        X_CB = invert(camera.X_BC)
        return cls(
            rgb=rgb,
            depth=np.where(part > 0, np.round(depth_m / DEPTH_UNIT_M), 0).astype(np.uint16),
            part=part,
            K=camera.K,
            X_CH=X_CB @ X_BL[HAND_LINK],
            X_CL=X_CB @ np.stack([X_BL[LINK_OF[link]] for link in ARM]),
            finger_m=finger_m,
        )


def label_parts(ids: NDArray[np.integer[Any]], part_of_id: Mapping[int, RobotPart]) -> NDArray[np.uint8]:
    """Return values of `RobotPart` (S, S) for the segmentation ids (S, S) of a renderer."""
    part = np.zeros(ids.shape, np.uint8)
    for entity, value in part_of_id.items():
        part[ids == entity] = value
    return part


def save_shard(frames: Sequence[RenderedFrame], shard: Path) -> None:
    """Write the frames of a scene; `truth.npz` last, which marks the shard as complete."""
    shard.mkdir(parents=True, exist_ok=True)
    for name in ("rgb", "depth", "part"):
        np.save(shard / f"{name}.npy", np.stack([getattr(f, name) for f in frames]))
    np.savez(
        shard / "truth.npz",
        K=np.stack([f.K for f in frames]),
        camera_from_hand=np.stack([f.X_CH for f in frames]),
        camera_from_links=np.stack([f.X_CL for f in frames]),
        finger_m=np.array([f.finger_m for f in frames]),
    )


_SHIFT_M = 0.06
_TURN_RAD = np.deg2rad(6.0)
_FOV_RAD = np.deg2rad((45.0, 75.0))
_VARIED_FOV = 0.6
"""Share of cameras with a random field of view."""


def varied_camera(rng: np.random.Generator, size: int) -> Camera:
    """Return the benchmark camera moved by up to 6 cm and 6 degrees per axis, field of view 45 to 75 degrees.

    Its images are `size` pixels wide and high.
    """
    benchmark = benchmark_camera()
    shift = make_pose(rotation_exp(rng.uniform(-_TURN_RAD, _TURN_RAD, 3)), rng.uniform(-_SHIFT_M, _SHIFT_M, 3))
    focal = benchmark.fx * size / benchmark.width
    if rng.random() < _VARIED_FOV:
        focal = float(size / 2 / np.tan(rng.uniform(*_FOV_RAD) / 2))
    centre = size / 2
    return Camera(width=size, height=size, fx=focal, fy=focal, cx=centre, cy=centre, X_BC=benchmark.X_BC @ shift)
