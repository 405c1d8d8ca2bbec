"""A film of what happened on a stage, with its ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.models.panda.robot import HAND_LINK, TCP_LINK
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.simulator import Simulator, Snapshot


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutVideo:
    """A filmed performance with its ground truth."""

    camera: Camera
    """The camera that filmed it."""
    rgb: NDArray[np.uint8]
    """(T, H, W, 3) frames."""
    t_s: Array
    """(T,) task time [s]."""
    q: Array
    """(T, 7) arm joint angles [rad]; NaN where the gripper is not drawn, as in the poses."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""
    X_CH: Array
    """(T, 4, 4) panda_hand in the camera frame [m]."""
    X_BG: Array
    """(T, 4, 4) panda_hand_tcp in the robot base frame [m]."""
    depth_mm: NDArray[np.uint16]
    """(T, H, W) distance along the camera's z in whole millimetres, towards zero; 0 where nothing is."""
    mask: NDArray[np.bool_]
    """(T, H, W) pixels of the gripper (hand and fingers)."""
    robot: NDArray[np.bool_]
    """(T, H, W) pixels of the robot, the gripper among them."""

    def save_truth(self, path: Path, *, with_images: bool) -> None:
        """Write the ground truth as npz, the same bytes every time; `with_images`: depth and packed masks as well.

        Masks are packed along the width: `np.unpackbits(mask, axis=-1, count=width)`.
        """
        arrays: dict[str, Any] = {
            "t_s": self.t_s,
            "base_from_tcp": self.X_BG,
            "camera_from_hand": self.X_CH,
            "q": self.q,
            "finger_width_m": self.finger_width_m,
        }
        if with_images:
            arrays |= {"depth_mm": self.depth_mm, "mask": np.packbits(self.mask, axis=-1)}
        np.savez_compressed(path, **arrays)


def film(stage: Simulator, snapshots: Sequence[Snapshot], *, first_frame: int = 0) -> RolloutVideo:
    """Render snapshots with the stage's camera; the stage must have been reset to the same scene.

    Args:
        stage: the scene they were taken in.
        snapshots: what to show, one a frame.
        first_frame: index of the first of them in the whole video (it sets `t_s`).
    """
    pictures, X_BH, X_BG = [], [], []
    for snapshot in snapshots:
        stage.show(snapshot)
        pictures.append(stage.picture())
        X_BH.append(stage.link_pose(HAND_LINK))
        X_BG.append(stage.link_pose(TCP_LINK))
    return RolloutVideo(
        camera=stage.camera,
        rgb=np.stack([p.rgb for p in pictures]),
        t_s=FRAME_PERIOD_S * np.arange(first_frame, first_frame + len(snapshots), dtype=np.float64),
        q=np.stack([s.q for s in snapshots]),
        finger_width_m=np.array([s.fingers_m.sum() for s in snapshots]),
        X_CH=invert(stage.camera.X_BC) @ np.stack(X_BH),
        X_BG=np.stack(X_BG),
        depth_mm=np.stack([p.depth_mm for p in pictures]),
        mask=np.stack([p.mask for p in pictures]),
        robot=np.stack([p.robot for p in pictures]),
    )
