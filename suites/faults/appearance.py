"""Faults of appearance: second gripper, deformation, wrong size."""

import numpy as np

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points
from kinebench_drake.suites.faults.fault import FaultForm, PlantedFault
from kinebench_drake.suites.faults.fault_simulator import RenderFault, Warp
from kinebench_drake.suites.faults.recording import LEAST_VISIBLE, Recording
from kinebench_drake.suites.rollout import RolloutVideo

DUPLICATE_FRAMES = 10
"""Frames with a second gripper."""
DEFORMED_FRAMES = 12
"""Frames with a deformed gripper."""
_LEVER_M = 0.1  # half the gripper's length: a bend of strength s moves points so far from the hand by s/2 of it
_MIDDLE_H = np.array([[0.0, 0.0, 0.05]])
_LEAST_SHOWN = 0.6  # least visible area of the second gripper, relative to that of the first


def plant_duplicate(
    recording: Recording, apart_m: float, rng: np.random.Generator
) -> tuple[RolloutVideo, PlantedFault]:
    """Render a second gripper beside the robot's for some frames, moving in parallel.

    Args:
        recording: recording to alter.
        apart_m: distance of the two [m].
        rng: draws the side.

    Raises:
        InputError: it does not fit into the image.
    """
    start = recording.visible_starts(DUPLICATE_FRAMES)[0]
    frames = range(start, start + DUPLICATE_FRAMES)
    sides = [np.array(d) for d in ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))]
    for side in (sides[i] for i in rng.permutation(len(sides))):
        if not all(_inside(recording, i, apart_m * side) for i in frames):
            continue

        def add_gripper(i: int, offset: Array = apart_m * side) -> None:
            X_BH = recording.video.camera.X_BC @ recording.video.X_CH[i]
            X_HP = make_pose(np.eye(3), X_BH[:3, :3].T @ offset)
            recording.simulator.set_fault(RenderFault(warp=lambda p: p, X_HP=X_HP, replaces=False))

        part = recording.render_again(frames, add_gripper)
        own = recording.video.mask[frames.start : frames.stop]
        changed = (np.abs(part.rgb.astype(np.int16) - recording.video.rgb[frames.start : frames.stop]) > 8).any(axis=-1)
        if part.mask.mean() >= LEAST_VISIBLE / 2 and (changed & ~own).sum() >= _LEAST_SHOWN * own.sum():
            return recording.plant(part, start, AnomalyKind.DUPLICATE, apart_m)
    raise InputError(f"there is no room for a second gripper {apart_m} m from the first; take another seed")


def _inside(recording: Recording, frame: int, offset_B: Array) -> bool:
    """Return whether the centre of a gripper with an offset to the robot's is in the image."""
    camera = recording.video.camera
    X_BH = camera.X_BC @ recording.video.X_CH[frame]
    X_BH[:3, 3] += offset_B
    pixel = camera.project(transform_points(invert(camera.X_BC) @ X_BH, _MIDDLE_H)[0])
    margin = 0.08 * camera.width
    return bool((pixel > margin).all() and (pixel < [camera.width - margin, camera.height - margin]).all())


def plant_deformation(
    recording: Recording, strength: float, rng: np.random.Generator
) -> tuple[RolloutVideo, PlantedFault]:
    """Render the gripper stretched, squeezed and bent for some frames.

    Args:
        recording: recording to alter.
        strength: relative stretch of the most stretched axis, and slope of the bend at the fingertips.
        rng: draws directions.

    Raises:
        InputError: the gripper is not in view long enough.
    """
    start = recording.visible_starts(DEFORMED_FRAMES)[0]
    warp = deformation(strength, rng)
    part = recording.render_again(
        range(start, start + DEFORMED_FRAMES),
        lambda _: recording.simulator.set_fault(RenderFault(warp=warp, X_HP=np.eye(4), replaces=True)),
    )
    return recording.plant(part, start, AnomalyKind.DEFORMATION, strength)


def deformation(strength: float, rng: np.random.Generator) -> Warp:
    """Return a volume-preserving change of shape: stretches of zero sum along random axes, and a bend."""
    R = rotation_exp(rng.normal(size=3))
    stretch = rng.normal(size=3)
    stretch -= stretch.mean()
    stretch /= np.abs(stretch).max()
    A = R @ np.diag(1.0 + strength * stretch) @ R.T
    angle = rng.uniform(0.0, 2 * np.pi)
    bend = strength * np.array([np.cos(angle), np.sin(angle), 0.0]) / (2 * _LEVER_M)

    def warp(p_H: Array) -> Array:
        return np.asarray(p_H @ A.T + bend * p_H[:, 2:] ** 2)

    return warp


def plant_scale(
    recording: Recording, size: float, form: FaultForm, rng: np.random.Generator
) -> tuple[RolloutVideo, PlantedFault]:
    """Render hand and fingers too large or too small on an unchanged arm.

    Args:
        recording: recording to alter.
        size: relative change of size.
        form: constant or growing.
        rng: draws larger or smaller.
    """
    sign = 1.0 if rng.random() < 0.5 else -1.0
    n = len(recording)
    share = np.ones(n) if form is FaultForm.CONSTANT else np.linspace(0.0, 1.0, n)

    def scale_gripper(i: int) -> None:
        factor = 1.0 + sign * size * share[i]
        recording.simulator.set_fault(RenderFault(warp=lambda p: factor * p, X_HP=np.eye(4), replaces=True))

    start = int(share[0] == 0.0)
    part = recording.render_again(range(start, n), scale_gripper)
    return recording.plant(part, start, AnomalyKind.SCALE, size, form)
