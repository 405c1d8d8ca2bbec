"""Faults of appearance: a second gripper, deformation, wrong size."""

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points
from kinebench_drake.suites.clip import RolloutVideo
from kinebench_drake.suites.faults.fault import FaultForm, PlantedFault
from kinebench_drake.suites.faults.fault_simulator import RenderFault, Warp
from kinebench_drake.suites.faults.recording import LEAST_VISIBLE, Recording
from kinebench_drake.types import AnomalyKind

DUPLICATE_FRAMES = 10
"""Frames that show a second gripper."""
DEFORMED_FRAMES = 12
"""Frames that show a deformed one."""
_LEVER_M = 0.1  # about half the gripper's length: a bend of strength s moves what is so far from the hand by s/2 of it
_MIDDLE_H = np.array([[0.0, 0.0, 0.05]])
_LEAST_SHOWN = 0.6  # part of the second gripper that must not be hidden, of what the first one shows


def plant_duplicate(take: Recording, apart_m: float, rng: np.random.Generator) -> tuple[RolloutVideo, PlantedFault]:
    """The clip with a second gripper that hovers beside the robot's own for some frames and moves as it does.

    Args:
        take: what to alter.
        apart_m: distance of the two.
        rng: picks the side.

    Raises:
        InputError: there is no room for it in the picture.
    """
    start = take.stretches(DUPLICATE_FRAMES)[0]
    frames = range(start, start + DUPLICATE_FRAMES)
    sides = [np.array(d) for d in ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))]
    for side in (sides[i] for i in rng.permutation(len(sides))):
        if not all(_inside(take, i, apart_m * side) for i in frames):
            continue

        def wear(i: int, offset: Array = apart_m * side) -> None:
            X_BH = take.clip.camera.X_BC @ take.clip.X_CH[i]
            X_HP = make_pose(np.eye(3), X_BH[:3, :3].T @ offset)
            take.stage.wear(RenderFault(warp=lambda p: p, X_HP=X_HP, replaces=False))

        part = take.film_again(frames, wear)
        own = take.clip.mask[frames.start : frames.stop]
        changed = (np.abs(part.rgb.astype(np.int16) - take.clip.rgb[frames.start : frames.stop]) > 8).any(axis=-1)
        if part.mask.mean() >= LEAST_VISIBLE / 2 and (changed & ~own).sum() >= _LEAST_SHOWN * own.sum():
            fault = PlantedFault(kind=AnomalyKind.DUPLICATE, frame_start=start, frame_end=frames.stop - 1, size=apart_m)
            return take.spliced(part, start), fault
    raise InputError(f"there is no room for a second gripper {apart_m} m from the first; take another seed")


def _inside(take: Recording, frame: int, offset_B: Array) -> bool:
    """Whether the middle of a gripper so far from the robot's own is in the picture."""
    camera = take.clip.camera
    X_BH = camera.X_BC @ take.clip.X_CH[frame]
    X_BH[:3, 3] += offset_B
    pixel = camera.project(transform_points(invert(camera.X_BC) @ X_BH, _MIDDLE_H)[0])
    margin = 0.08 * camera.width
    return bool((pixel > margin).all() and (pixel < [camera.width - margin, camera.height - margin]).all())


def plant_deformation(take: Recording, strength: float, rng: np.random.Generator) -> tuple[RolloutVideo, PlantedFault]:
    """The clip with the gripper stretched, squeezed and bent for some frames.

    Args:
        take: what to alter.
        strength: relative stretch of the axis that is stretched most, and the slope that the bend reaches at the
            fingertips.
        rng: picks directions.

    Raises:
        InputError: the gripper is never in view long enough.
    """
    start = take.stretches(DEFORMED_FRAMES)[0]
    warp = deformation(strength, rng)
    part = take.film_again(
        range(start, start + DEFORMED_FRAMES),
        lambda _: take.stage.wear(RenderFault(warp=warp, X_HP=np.eye(4), replaces=True)),
    )
    fault = PlantedFault(
        kind=AnomalyKind.DEFORMATION, frame_start=start, frame_end=start + DEFORMED_FRAMES - 1, size=strength
    )
    return take.spliced(part, start), fault


def deformation(strength: float, rng: np.random.Generator) -> Warp:
    """A change of shape without a change of size: stretches along turned axes that add up to nothing, and a bend."""
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
    take: Recording, size: float, form: FaultForm, rng: np.random.Generator
) -> tuple[RolloutVideo, PlantedFault]:
    """The clip with hand and fingers drawn too large or too small on an arm of the right size.

    Args:
        take: what to alter.
        size: by what part.
        form: constant, or growing to it.
        rng: picks larger or smaller.
    """
    sign = 1.0 if rng.random() < 0.5 else -1.0
    n = len(take)
    share = np.ones(n) if form is FaultForm.CONSTANT else np.linspace(0.0, 1.0, n)

    def wear(i: int) -> None:
        factor = 1.0 + sign * size * share[i]
        take.stage.wear(RenderFault(warp=lambda p: factor * p, X_HP=np.eye(4), replaces=True))

    start = int(share[0] == 0.0)
    part = take.film_again(range(start, n), wear)
    fault = PlantedFault(kind=AnomalyKind.SCALE, frame_start=start, frame_end=n - 1, size=size, form=form)
    return take.spliced(part, start), fault
