"""Plant one fault each into the clips of `mujoco_clips.py`: what no robot shows, in another simulator's look.

    MUJOCO_GL=osmesa env/bin/python -m benchmarks.mujoco_faults CLIPS OUT --seed 100 --kinds vanish,deformation

CLIPS is the output of `mujoco_clips.py --seed SEED`. Writes OUT/NAME_KIND.mp4 and OUT/manifest.jsonl with the camera,
and the planted `fault` as kind, first and last frame.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.mujoco_clips import HAND_TO_TCP_M, PERIOD_S, SCENES, Arm, Film, write_video

GONE_FRAMES = 5
FROZEN_FRAMES = 6
SECOND_FRAMES = 10
DEFORMED_FRAMES = 12
JUMP_M = 0.1
BESIDE_M = 0.17
STRETCH = 0.25
"""Sizes of a jump, of the distance of a second gripper and of a relative stretch."""
_SIDES_C = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0))
_BORDER = 0.1
"""Width of the border, as a share of the image, in which no second gripper begins."""
_LEAST_STEP_M = 0.01
"""Least step of the TCP in a frame, before and through a freeze [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clip:
    """A clip without a fault."""

    arm: Arm
    film: Film
    q: NDArray[Any]
    """(T, 7) postures [rad]."""
    gap: NDArray[Any]
    """(T,) gaps between the fingers [m]."""
    p: NDArray[Any]
    """(T, 3) TCP in the base frame [m]."""
    visible: NDArray[Any]
    """(T,) pixels of the gripper."""
    camera: dict[str, Any]
    """Object of camera.json."""

    def shows(self, frame: int, offset: NDArray[Any]) -> bool:
        """Return whether the TCP moved by `offset` (3,) [m], in the base frame, is well inside the image."""
        X_CB = np.linalg.inv(np.array(self.camera["base_from_camera"]))
        p_C = X_CB[:3, :3] @ (self.p[frame] + offset) + X_CB[:3, 3]
        share = np.array([self.camera["fx"], self.camera["fy"]]) * p_C[:2] / p_C[2]
        share = share / [self.camera["width"], self.camera["height"]] + 0.5
        return bool((np.abs(share - 0.5) < 0.5 - _BORDER).all())

    def image(self, frame: int) -> NDArray[Any]:
        """Return the image (H, W, 3) of a frame, with whatever the film was told to change."""
        self.arm.set(self.q[frame], self.gap[frame])
        return self.film.image()

    def start(self, frames: int) -> int | None:
        """Return the first of `frames` frames with the gripper in view, where it moves fastest; None if there are none.

        It leaves four frames before and after.
        """
        least = 0.5 * float(np.median(self.visible[self.visible > 0]))
        starts = [
            i for i in range(4, len(self.q) - frames - 3) if (self.visible[i - 1 : i + frames + 1] >= least).all()
        ]
        path = {i: np.linalg.norm(np.diff(self.p[i - 1 : i + frames + 1], axis=0), axis=1).sum() for i in starts}
        return max(starts, key=path.__getitem__) if starts else None


Planted = tuple[list[NDArray[Any]], int, int] | None
"""Images, first and last frame of the fault; None where a clip has no place for it."""


def _altered(clip: Clip, start: int, frames: int) -> Planted:
    """Return the clip with frames from `start` on rendered with the film's change."""
    change, clip.film.change = clip.film.change, None
    images = [clip.image(i) for i in range(len(clip.q))]
    clip.film.change = change
    for i in range(start, start + frames):
        images[i] = clip.image(i)
    clip.film.change = None
    return images, start, start + frames - 1


def _vanish(clip: Clip, rng: np.random.Generator) -> Planted:
    """Hide hand and fingers."""
    if (start := clip.start(GONE_FRAMES)) is None:
        return None

    def hide(scene: Any, gripper: list[int]) -> None:
        for g in gripper:
            scene.geoms[g].rgba[3] = 0.0

    clip.film.change = hide
    return _altered(clip, start, GONE_FRAMES)


def _duplicate(clip: Clip, rng: np.random.Generator) -> Planted:
    """Add a second gripper beside the first, across the line of sight, moving in parallel."""
    if (start := clip.start(SECOND_FRAMES)) is None:
        return None
    R_BC = np.array(clip.camera["base_from_camera"])[:3, :3]
    sides = [BESIDE_M * R_BC @ side for side in rng.permutation(np.array(_SIDES_C))]
    beside = [p for p in sides if all(clip.shows(i, p) for i in range(start, start + SECOND_FRAMES))]
    if not beside:
        return None
    offset = clip.arm.X_WB[:3, :3] @ beside[0]

    def add(scene: Any, gripper: list[int]) -> None:
        for g in gripper:
            new = scene.geoms[scene.ngeom]
            old = scene.geoms[g]
            mujoco.mjv_initGeom(
                new, old.type, old.size.copy(), old.pos + offset, old.mat.ravel().astype(np.float64), old.rgba.copy()
            )
            new.dataid = old.dataid
            new.matid = old.matid
            new.objid = -1
            new.segid = -1
            new.texcoord = old.texcoord
            new.emission = old.emission
            new.specular = old.specular
            new.shininess = old.shininess
            new.reflectance = old.reflectance
            scene.ngeom += 1

    clip.film.change = add
    return _altered(clip, start, SECOND_FRAMES)


def _deformation(clip: Clip, rng: np.random.Generator) -> Planted:
    """Stretch and squeeze hand and fingers for some frames, at constant volume.

    The stretch keeps the axis of the hand, so that it is the same for both fingers, which share a mesh.
    """
    if (start := clip.start(DEFORMED_FRAMES)) is None:
        return None
    angle = rng.uniform(0.0, np.pi)
    stretch = rng.normal(size=3)
    stretch -= stretch.mean()
    stretch *= STRETCH / np.abs(stretch).max()
    R = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    with clip.film.warped(R @ np.diag(1.0 + stretch) @ R.T):
        return _altered(clip, start, DEFORMED_FRAMES)


def _teleport(clip: Clip, rng: np.random.Generator) -> Planted:
    """Displace the gripper from one frame on."""
    n = len(clip.q)
    arm = clip.arm
    for start in sorted(range(8, n - 8), key=lambda i: abs(i - n // 2)):
        for _ in range(4):
            direction = rng.normal(size=3)
            arm.set(clip.q[start], clip.gap[start])
            X = arm.X_BH
            X[:3, 3] += JUMP_M * direction / np.linalg.norm(direction)
            reached = arm.solve(X, clip.q[start])
            if reached is None:
                continue
            q = clip.q.copy()
            q[start:] += reached - clip.q[start]
            if ((q < arm.limits[:, 0]) | (q > arm.limits[:, 1])).any():
                continue
            arm.set(q[start], clip.gap[start])
            if clip.film.gripper_px() >= 0.5 * clip.visible[start]:
                moved = replace(clip, q=q)
                return [moved.image(i) for i in range(n)], start, start
    return None


def _freeze(clip: Clip, rng: np.random.Generator) -> Planted:
    """Repeat a frame in motion, after which the gripper jumps to its true pose."""
    step = np.linalg.norm(np.diff(clip.p, axis=0), axis=1)
    through = {
        i: min(step[i - 2], np.linalg.norm(clip.p[i + FROZEN_FRAMES] - clip.p[i - 1]) / (FROZEN_FRAMES + 1))
        for i in range(4, len(clip.q) - FROZEN_FRAMES - 3)
        if (clip.visible[i - 2 : i + FROZEN_FRAMES + 2] > 0).all()
    }
    start = max(through, key=through.__getitem__, default=None)
    if start is None or through[start] < _LEAST_STEP_M:
        return None
    images = [clip.image(i) for i in range(len(clip.q))]
    images[start : start + FROZEN_FRAMES] = [images[start - 1]] * FROZEN_FRAMES
    return images, start, start + FROZEN_FRAMES - 1


PLANTERS: dict[str, Callable[[Clip, np.random.Generator], Planted]] = {
    "vanish": _vanish,
    "duplicate_gripper": _duplicate,
    "teleport": _teleport,
    "freeze": _freeze,
    "deformation": _deformation,
}


def read_clips(folder: Path, seed: int) -> Iterator[tuple[str, dict[str, Any], Clip]]:
    """Yield name, camera and clip of each line of the manifest; `seed` is that of the clips."""
    for number, line in enumerate((folder / "manifest.jsonl").read_text().splitlines()):
        item = json.loads(line)
        name = Path(item["video"]).stem
        truth = np.load(folder / f"{name}.gt.npz")
        arm = Arm(SCENES[number % len(SCENES)], seed + number)
        yield (
            name,
            item["camera"],
            Clip(
                arm=arm,
                film=Film(arm, item["camera"]),
                q=truth["q"],
                gap=truth["finger_width_m"],
                p=truth["base_from_hand"][:, :3, 3] + HAND_TO_TCP_M * truth["base_from_hand"][:, :3, 2],
                visible=truth["visible"],
                camera=item["camera"],
            ),
        )


def main() -> None:
    """Render each clip with each kind of fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clips", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=100, help="that of the clips")
    parser.add_argument("--kinds", default=",".join(PLANTERS), help="kinds of faults, comma-separated")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for number, (name, camera, clip) in enumerate(read_clips(options.clips, options.seed)):
        for kind in options.kinds.split(","):
            video = f"{name}_{kind}.mp4"
            if (options.out / video).exists():
                continue
            planted = PLANTERS[kind](clip, np.random.default_rng([options.seed, number, list(PLANTERS).index(kind)]))
            if planted is None:
                print(video, "no place", flush=True)
                continue
            images, start, end = planted
            write_video(options.out / video, images)
            line = {
                "video": video, "frame_period_s": PERIOD_S, "camera": camera,
                "fault": {"kind": kind, "frame_start": start, "frame_end": end},
            }  # fmt: skip
            with (options.out / "manifest.jsonl").open("a") as manifest:
                manifest.write(json.dumps(line) + "\n")
            print(video, start, end, flush=True)
        clip.film.close()


if __name__ == "__main__":
    main()
