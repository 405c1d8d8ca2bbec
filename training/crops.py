"""Random training crops of rendered frames, with labels and degradation."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array, invert, make_pose, transform_points
from kinebench_drake.grounding.tracking.view import (
    CLOSE_SIZE,
    GRIPPER_CENTRE_H,
    GRIPPER_RADIUS_M,
    WIDE_SIZE,
    WRIST_CENTRE_H,
    WRIST_RADIUS_M,
    Crop,
)
from kinebench_drake.models.panda.description import ARM, GRIPPER, OPENING_SIGN, RobotPart
from kinebench_drake.models.perception.network import COORDINATE_SCALE_M, DEPTH_CENTRE, STRIDE
from training.augment import degrade, occlude, replace_background
from training.frame import DEPTH_UNIT_M, RenderedFrame

CLOSE_EVERY = 2
"""Interval of the steps on close crops of the gripper; the others use wide ones, which show frames or arms."""
_MIN_TARGET_PX = 60
_DOUBLED = 0.12
"""Share of wide crops with a second gripper."""
_OCCLUDED = 0.4
"""Share of crops with occluders."""
_CLEAN = 0.3
"""Share of crops that are not degraded."""
_OTHER_BACKGROUND = 0.2
"""Share of crops whose background is replaced."""
_ELSEWHERE = 0.1
"""Share of wide crops of any part of the frame."""
_WIDE_GRIPPER_PX = (13.0, 115.0)
"""Range of the diameter of the gripper's bounding sphere in wide crops [px]."""
_LARGEST_WIDE = 1.3
"""Size of the largest wide crop over that of the frame."""
_NARROW = 0.4
"""Share of draws that take the narrower of two grippers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CropTarget:
    """What crops show: a bounding sphere, and the parts inside."""

    centre_H: Array
    """(3,) centre in panda_hand [m]."""
    radius_m: float
    parts: tuple[RobotPart, ...]


GRIPPER_TARGET = CropTarget(centre_H=GRIPPER_CENTRE_H, radius_m=GRIPPER_RADIUS_M, parts=GRIPPER)
WRIST_TARGET = CropTarget(centre_H=WRIST_CENTRE_H, radius_m=WRIST_RADIUS_M, parts=ARM[-3:])
"""The last links, for the network of the arm alone."""


def frame_camera(frame: RenderedFrame) -> Camera:
    """Return the camera of a frame."""
    height, width = frame.part.shape
    K = frame.K
    X_BC = invert(frame.X_CL[0])
    return Camera(width=width, height=height, fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2], X_BC=X_BC)


def close_crop(frame: RenderedFrame, rng: np.random.Generator, target: CropTarget = GRIPPER_TARGET) -> Crop:
    """Return a random crop around a target, mostly as close as in tracking, sometimes wider."""
    centre = transform_points(frame.X_CH, target.centre_H[None])[0]
    distance = float(np.linalg.norm(centre))
    low, high = (0.95, 1.7) if rng.random() < 0.8 else (1.7, 4.0)
    margin = np.exp(rng.uniform(np.log(low), np.log(high)))
    half_tangent = margin * target.radius_m / distance
    shift = rng.normal(0, 0.18, 3) * half_tangent * distance
    return Crop.towards(centre + shift, half_tangent, CLOSE_SIZE, roll=float(rng.normal(0, np.deg2rad(12))))


def wide_crop(frame: RenderedFrame, rng: np.random.Generator, target: CropTarget = GRIPPER_TARGET) -> Crop:
    """Return a random crop that shows a target small, anywhere in it, as in detection and around the arm."""
    camera = frame_camera(frame)
    centre_C = transform_points(frame.X_CH, target.centre_H[None])[0]
    apparent = GRIPPER_RADIUS_M / float(np.linalg.norm(centre_C))
    half_tangent = apparent * WIDE_SIZE / np.exp(rng.uniform(*np.log(_WIDE_GRIPPER_PX)))
    half_tangent = min(half_tangent, _LARGEST_WIDE * camera.width / 2 / camera.fx)
    half_px = half_tangent * camera.fx
    centre_px = camera.project(centre_C) + rng.uniform(-0.85, 0.85, 2) * half_px
    if centre_C[2] <= 0 or rng.random() < _ELSEWHERE:
        centre_px = rng.uniform(0, camera.width, 2)
    margin = min(0.8 * half_px, camera.width / 2)
    u, v = np.clip(centre_px, margin, camera.width - margin)
    direction = [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0]
    return Crop.towards(direction, half_tangent, WIDE_SIZE, roll=float(rng.normal(0, np.deg2rad(8))))


def label(frame: RenderedFrame, crop: Crop) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
    """Return part, CAD coordinates in the frame of the part, and log depth on the output grid, in network units."""
    camera = frame_camera(frame)
    part = np.asarray(crop.warp(frame.part, camera, STRIDE, nearest=True), dtype=np.uint8)
    depth_C = np.asarray(crop.warp(frame.depth, camera, STRIDE, nearest=True), dtype=np.float64) * DEPTH_UNIT_M
    rays_V = crop.rays(STRIDE)
    rays_C = rays_V @ crop.R_CV.T
    z_V = depth_C / rays_C[..., 2]  # the depth map is along the real camera's axis
    X_PV = invert(_part_poses(frame)) @ crop.X_CV
    p_P = np.einsum("hwij,hwj->hwi", X_PV[part, :3, :3], rays_V * z_V[..., None]) + X_PV[part, :3, 3]
    log_depth = np.log(np.maximum(z_V, 1e-3) * crop.size / crop.focal / DEPTH_CENTRE)
    return part, (p_P / COORDINATE_SCALE_M).astype(np.float32), log_depth.astype(np.float32)


def _part_poses(frame: RenderedFrame) -> Array:
    """Return the poses (PARTS, 4, 4) of the frames of CAD coordinates in the camera frame, by `RobotPart`."""
    X_CP = np.tile(np.eye(4), (len(RobotPart), 1, 1))
    for part in GRIPPER:
        X_CP[part] = frame.X_CH @ make_pose(np.eye(3), [0.0, OPENING_SIGN[part] * frame.finger_m, 0.0])
    X_CP[list(ARM)] = frame.X_CL
    return X_CP


class Shards:
    """Rendered frames of data folders, memory-mapped."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """Open all complete shards below `folders`.

        Raises:
            UsageError: a folder holds none.
        """
        self.folders = tuple(folders)
        self._arrays: list[dict[str, NDArray[np.generic]]] = []
        self._index: list[tuple[int, int]] = []
        for folder in folders:
            paths = sorted(p.parent for p in folder.glob("*/truth.npz"))
            if not paths:
                raise UsageError(f"{folder.name}: no rendered shards (*/truth.npz) found; render some first")
            for path in paths:
                arrays = {n: np.load(path / f"{n}.npy", mmap_mode="r") for n in ("rgb", "depth", "part")}
                with np.load(path / "truth.npz", allow_pickle=False) as truth:
                    arrays |= {n: truth[n] for n in truth.files}
                self._index += [(len(self._arrays), i) for i in range(len(arrays["finger_m"]))]
                self._arrays.append(arrays)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._index)

    def __getitem__(self, index: int) -> RenderedFrame:
        """Return frame `index`."""
        shard, i = self._index[index]
        a = self._arrays[shard]
        return RenderedFrame(
            rgb=np.asarray(a["rgb"][i], dtype=np.uint8),
            depth=np.asarray(a["depth"][i], dtype=np.uint16),
            part=np.asarray(a["part"][i], dtype=np.uint8),
            K=np.asarray(a["K"][i], dtype=np.float64),
            X_CH=np.asarray(a["camera_from_hand"][i], dtype=np.float64),
            X_CL=np.asarray(a["camera_from_links"][i], dtype=np.float64),
            finger_m=float(a["finger_m"][i]),
        )


def _double(image: NDArray[np.uint8], labels: Sequence[NDArray[np.generic]], rng: np.random.Generator) -> None:
    """Copy the gripper in `image` (S, S, 3) and in `labels` (h, w, ...), parts first, to another place."""
    part = labels[0]
    n = len(part)
    scale = len(image) // len(part)
    v, u = np.nonzero(np.isin(part, GRIPPER))
    if not len(v):
        return
    dv, du = rng.integers(-n // 2, n // 2, 2)
    inside = (v + dv >= 0) & (v + dv < n) & (u + du >= 0) & (u + du < n)
    v = v[inside]
    u = u[inside]
    for label_map in labels:
        label_map[v + dv, u + du] = label_map[v, u].copy()
    i, j = np.meshgrid(np.arange(scale), np.arange(scale), indexing="ij")
    rows = v[:, None] * scale + i.ravel()
    columns = u[:, None] * scale + j.ravel()
    image[rows + dv * scale, columns + du * scale] = image[rows, columns].copy()


class Crops(Dataset[dict[str, Tensor]]):
    """Random degraded crops by item (step, slot): the same seed and item give the same crop, in any order of access.

    All crops of a step have one size: every `CLOSE_EVERY`-th step uses close crops, the others wide ones.
    """

    def __init__(self, shards: Shards, seed: int, target: CropTarget = GRIPPER_TARGET) -> None:
        self._shards = shards
        self._seed = seed
        self._target = target

    def __getitem__(self, item: tuple[int, int]) -> dict[str, Tensor]:
        """Return the crop of (step, slot) with its labels, h = w = S / STRIDE.

        `image` (3, S, S) uint8, `part` (h, w) values of `RobotPart`, `coordinates` (3, h, w) CAD coordinates and
        `log_depth` (h, w) in network units.
        """
        rng = np.random.default_rng([self._seed, *item])
        wide = is_wide(item[0])
        for _ in range(20):
            frame = self._draw(rng)
            crop = (wide_crop if wide else close_crop)(frame, rng, self._target)
            part, coordinates, log_depth = label(frame, crop)
            if np.isin(part, self._target.parts).sum() >= _MIN_TARGET_PX / STRIDE**2 or rng.random() < 0.1:
                break
        image = np.array(crop.warp(frame.rgb, frame_camera(frame)), dtype=np.uint8)
        if rng.random() < _OTHER_BACKGROUND:
            robot = crop.warp((frame.part > 0).astype(np.float32), frame_camera(frame))
            image = replace_background(image, robot, rng)
        if wide and rng.random() < _DOUBLED:
            _double(image, (part, coordinates, log_depth), rng)
        if rng.random() < _OCCLUDED:
            occlude(image, part, self._draw(rng).rgb, rng)
        if rng.random() >= _CLEAN:
            image = degrade(image, rng)
        return {
            "image": torch.from_numpy(image).permute(2, 0, 1),
            "part": torch.from_numpy(part).long(),
            "coordinates": torch.from_numpy(coordinates).permute(2, 0, 1),
            "log_depth": torch.from_numpy(log_depth),
        }

    def _draw(self, rng: np.random.Generator) -> RenderedFrame:
        """Return a random frame; narrow views of the gripper, which are harder, are more frequent."""
        frames = [self._shards[int(rng.integers(len(self._shards)))] for _ in range(1 + (rng.random() < _NARROW))]
        return max(frames, key=_narrowness)


def _narrowness(frame: RenderedFrame) -> float:
    """Return the cosine of the angle between the fingers' axis and the line of sight, 0..1."""
    p = frame.X_CH[:3, 3]
    return float(np.nan_to_num(abs(frame.X_CH[:3, 1] @ p) / np.linalg.norm(p)))


def is_wide(step: int) -> bool:
    """Return whether a step uses wide crops."""
    return step % CLOSE_EVERY != 0


class Steps(Sampler[list[tuple[int, int]]]):
    """Batches of items of `Crops`, one per training step; a batch of wide crops is smaller, as these are larger."""

    def __init__(self, steps: range, batch_size: int) -> None:
        self._steps = steps
        self._batch_size = batch_size

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        """Yield the items of each step."""
        fewer = max(2, self._batch_size * CLOSE_SIZE**2 // WIDE_SIZE**2)
        for step in self._steps:
            yield [(step, slot) for slot in range(fewer if is_wide(step) else self._batch_size)]
