"""Perturbations by name, with the strengths at which they are measured, and those of whole frames.

The kinds are those of the paper's section 4.2 (gripper deformation, three levels of occlusion, contrast, motion blur,
noise), which gives no numbers, and the effects of video coding and of frame blending. Of the three strengths of a kind
the first is typical of a good video model, the second must be tolerated by the pipeline, and the third is beyond that;
occlusion must be tolerated at all three.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from benchmarks.perception.perturbation.gripper import Masks, centroids, deform, occlude, to_bytes
from kinebench_drake.geometry import Array
from kinebench_drake.io.container import write_video
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video

_FPS = 17.0
_TIME = 4
_SIDE = 8
"""Frames and pixels per latent of the VAEs of Wan and CogVideoX."""
_SHIFTS = ((0, 0), (4, 4))
_STILL_PX = 0.5
"""Motion from the previous to the next frame below which the gripper rests [px]."""
_SAMPLES_PX = 8
"""Samples per pixel of the line of a motion blur."""


def code_h264(frames: Frames, masks: Masks, rng: np.random.Generator, crf: float) -> tuple[Frames, Masks]:
    """Encode and decode with x264 at a constant rate factor, 1 to 51; 0 changes nothing."""
    if crf <= 0:
        return frames, masks
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        write_video(path, frames, _FPS, crf=round(crf))
        coded = read_video(path).frames
    height, width = frames.shape[1:3]
    return np.ascontiguousarray(coded[:, :height, :width]), masks


def code_latent(frames: Frames, masks: Masks, rng: np.random.Generator, ratio: float) -> tuple[Frames, Masks]:
    """Compress by `ratio`, as the autoencoder of a video model does; 0 changes nothing.

    A substitute that needs no weights: of the 768 cosine transform coefficients of each block of 4 frames x 8 x 8
    pixels x 3 channels (luma and, weighted by half, chroma) only the largest are kept. This best approximation in an
    orthonormal basis, like the autoencoder, keeps strong edges and drops fine texture and fast small motion. The
    average over two grids of blocks removes the seams (cycle spinning, Coifman and Donoho 1995). The VAE of Wan 2.1
    maps such a block to 16 numbers, a ratio of 48. As there, the first frame has a block of its own.
    """
    if ratio <= 0:
        return frames, masks
    keep = max(1, round(_TIME * _SIDE * _SIDE * 3 / ratio))
    lead = -len(frames) % _TIME
    array = np.asarray(frames)
    padded = np.concatenate([np.repeat(array[:1], lead, axis=0), array])
    out = [_code_group(padded[start : start + _TIME], keep) for start in range(0, len(padded), _TIME)]
    return np.concatenate(out)[lead:], masks


def _code_group(frames: NDArray[np.uint8], keep: int) -> NDArray[np.uint8]:
    """Return four frames (4, H, W, 3) after coding."""
    _, height, width, _ = frames.shape
    colour = np.stack([cv2.cvtColor(f, cv2.COLOR_RGB2YCrCb) for f in frames]).astype(np.float32)
    colour[..., 1:] *= 0.5
    total = np.zeros_like(colour)
    for dy, dx in _SHIFTS:
        pad = ((0, 0), (dy, -(height + dy) % _SIDE), (dx, -(width + dx) % _SIDE), (0, 0))
        coded = _code_blocks(np.pad(colour, pad, mode="edge"), keep)
        total += coded[:, dy : dy + height, dx : dx + width]
    total /= len(_SHIFTS)
    total[..., 1:] *= 2.0
    return np.stack([cv2.cvtColor(f, cv2.COLOR_YCrCb2RGB) for f in to_bytes(total)])


def _code_blocks(colour: NDArray[np.float32], keep: int) -> NDArray[np.float32]:
    """Return frames (4, H, W, 3), H and W multiples of 8, from the `keep` largest coefficients of each block."""
    t, height, width, c = colour.shape
    rows = height // _SIDE
    columns = width // _SIDE
    blocks = colour.reshape(t, rows, _SIDE, columns, _SIDE, c).transpose(1, 3, 0, 2, 4, 5)
    coefficients = dctn(blocks, axes=(2, 3, 4), norm="ortho").reshape(rows, columns, -1)
    size = np.abs(coefficients)
    least = np.partition(size, -keep, axis=-1)[..., -keep, None]
    kept = np.where(size >= least, coefficients, 0.0).reshape(blocks.shape)
    back = idctn(kept, axes=(2, 3, 4), norm="ortho")
    return np.asarray(back.transpose(2, 0, 3, 1, 4, 5).reshape(colour.shape), dtype=np.float32)


def fade(frames: Frames, masks: Masks, rng: np.random.Generator, loss: float) -> tuple[Frames, Masks]:
    """Reduce the contrast by `loss` (0..1): every level moves that far towards the mean of the whole video."""
    mean = np.mean(np.asarray(frames), axis=(0, 1, 2))
    return to_bytes(frames + loss * (mean - frames)), masks


def add_noise(frames: Frames, masks: Masks, rng: np.random.Generator, sigma: float) -> tuple[Frames, Masks]:
    """Add Gaussian noise of standard deviation `sigma` [levels of 255], independent by pixel, channel and frame."""
    out = np.empty_like(frames)
    for i, frame in enumerate(frames):
        out[i] = to_bytes(frame + sigma * rng.standard_normal(frame.shape, dtype=np.float32))
    return out, masks


def blur_motion(frames: Frames, masks: Masks, rng: np.random.Generator, length_px: float) -> tuple[Frames, Masks]:
    """Blur each image over `length_px` along the motion of the gripper.

    For a resting gripper the direction is that of its last motion; random before any motion.
    """
    out = np.empty_like(frames)
    for i, angle in enumerate(directions(centroids(masks), float(rng.uniform(0, np.pi)))):
        out[i] = cv2.filter2D(frames[i], -1, line_kernel(length_px, angle), borderType=cv2.BORDER_REPLICATE)
    return out, masks


def directions(points: Array, start: float) -> Array:
    """Return the direction (T,) [rad] of the motion of `points` (T, 2); `start` before any motion."""
    n = len(points)
    angle = start
    angles = []
    for i in range(n):
        step = points[min(i + 1, n - 1)] - points[max(i - 1, 0)]
        if np.hypot(*step) > _STILL_PX:
            angle = float(np.arctan2(step[1], step[0]))
        angles.append(angle)
    return np.array(angles)


def line_kernel(length_px: float, angle: float) -> NDArray[np.float32]:
    """Return a kernel of sum 1 that blurs along a centred line of a length [px] and direction [rad]."""
    half = int(np.ceil(length_px / 2)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    count = max(1, round(_SAMPLES_PX * length_px))
    s = ((np.arange(count) + 0.5) / count - 0.5) * length_px
    x = half + s * np.cos(angle)
    y = half + s * np.sin(angle)
    u = np.floor(x).astype(int)
    v = np.floor(y).astype(int)
    for du, wu in ((0, 1 - (x - u)), (1, x - u)):
        for dv, wv in ((0, 1 - (y - v)), (1, y - v)):
            np.add.at(kernel, (v + dv, u + du), wu * wv)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def ghost(frames: Frames, masks: Masks, rng: np.random.Generator, weight: float) -> tuple[Frames, Masks]:
    """Blend each frame with the two previous ones, which together have the weight `weight` (0..1)."""
    past = [frames[np.maximum(np.arange(len(frames)) - lag, 0)].astype(np.float32) for lag in (1, 2)]
    return to_bytes((1 - weight) * np.asarray(frames) + weight * (past[0] + past[1]) / 2), masks


class PerturbationKind(Enum):
    """Kinds of perturbations."""

    DEFORMATION = "deformation"
    OCCLUSION = "occlusion"
    CONTRAST = "contrast"
    MOTION_BLUR = "motion-blur"
    NOISE = "noise"
    H264 = "h264"
    LATENT = "latent"
    GHOSTING = "ghosting"


@dataclass(frozen=True, slots=True, kw_only=True)
class Perturbation:
    """Kind and strength of a perturbation."""

    kind: PerturbationKind
    strength: float
    """Strength in the unit of the kind; 0 changes nothing."""

    @property
    def label(self) -> str:
        """Kind and strength as in tables."""
        return _ENTRIES[self.kind].label.format(self.strength)

    @property
    def is_required(self) -> bool:
        """True if the grounding is required to tolerate it."""
        return self.strength in _ENTRIES[self.kind].required


@dataclass(frozen=True, slots=True)
class _Entry:
    function: Callable[[Frames, Masks, np.random.Generator, float], tuple[Frames, Masks]]
    label: str
    strengths: tuple[float, ...]
    required: tuple[float, ...]


_ENTRIES: Mapping[PerturbationKind, _Entry] = {
    PerturbationKind.DEFORMATION: _Entry(deform, "deformation {:g} px", (2.0, 4.0, 8.0), (4.0,)),
    PerturbationKind.OCCLUSION: _Entry(occlude, "occlusion {:.0%}", (0.15, 0.30, 0.50), (0.15, 0.30, 0.50)),
    PerturbationKind.CONTRAST: _Entry(fade, "contrast -{:.0%}", (0.4, 0.6, 0.8), (0.6,)),
    PerturbationKind.MOTION_BLUR: _Entry(blur_motion, "motion blur {:g} px", (5.0, 10.0, 20.0), (10.0,)),
    PerturbationKind.NOISE: _Entry(add_noise, "noise {:g}/255", (10.0, 20.0, 40.0), (20.0,)),
    PerturbationKind.H264: _Entry(code_h264, "H.264 crf {:g}", (28.0, 35.0, 42.0), (35.0,)),
    PerturbationKind.LATENT: _Entry(code_latent, "latent 1:{:g}", (24.0, 48.0, 96.0), (48.0,)),
    PerturbationKind.GHOSTING: _Entry(ghost, "ghosting {:.0%}", (0.2, 0.35, 0.5), (0.35,)),
}


def ladder(kind: PerturbationKind) -> tuple[Perturbation, ...]:
    """Return a kind at its strengths, in increasing order."""
    return tuple(Perturbation(kind=kind, strength=s) for s in _ENTRIES[kind].strengths)


def perturb(perturbation: Perturbation, frames: Frames, masks: Masks, seed: int, id: str) -> tuple[Frames, Masks]:
    """Return the perturbed frames (T, H, W, 3) and masks (T, H, W) of the clip `id`.

    The pattern depends on clip, kind and seed, not on the strength.
    """
    rng = np.random.default_rng([seed, *perturbation.kind.value.encode(), *id.encode()])
    return _ENTRIES[perturbation.kind].function(frames, masks, rng, perturbation.strength)
