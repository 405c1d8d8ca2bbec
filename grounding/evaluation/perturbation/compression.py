"""What coding loses: H.264 as it is, and a stand-in for the latent bottleneck of video models."""

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from kinebench_drake.grounding.evaluation.perturbation.seen import Frames, Masks, Seen, to_bytes
from kinebench_drake.grounding.video import read_video
from kinebench_drake.mp4 import write_video

_FPS = 17.0
_TIME, _SIDE = 4, 8  # frames and pixels that a latent of Wan's and CogVideoX's VAEs stands for
_SHIFTS = ((0, 0), (4, 4))


def code_h264(frames: Frames, masks: Masks, rng: np.random.Generator, crf: float) -> Seen:
    """Code and decode with x264 at a constant rate factor, 1 to 51; 0 leaves the frames as they are."""
    if crf <= 0:
        return Seen(frames=frames, masks=masks)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        write_video(path, frames, _FPS, crf=round(crf))
        coded = read_video(path).frames
    height, width = frames.shape[1:3]
    return Seen(frames=np.ascontiguousarray(coded[:, :height, :width]), masks=masks)


def code_latent(frames: Frames, masks: Masks, rng: np.random.Generator, ratio: float) -> Seen:
    """Keep one of `ratio` numbers, as a video model's autoencoder does; 0 leaves the frames as they are.

    A stand-in that needs no weights: each block of 4 frames x 8 x 8 pixels x 3 channels (luma and, worth half, chroma)
    becomes the 768 coefficients of its cosine transform, of which only the greatest are kept: best approximation in an
    orthonormal basis, which like the autoencoder keeps strong edges and drops fine texture and quick small motion.
    Averaged over two grids of blocks, which takes the seams away (cycle spinning, Coifman and Donoho 1995). The VAE of
    Wan 2.1 turns such a block into 16 numbers, a ratio of 48. The first frame opens a block of its own, as there.
    """
    if ratio <= 0:
        return Seen(frames=frames, masks=masks)
    keep = max(1, round(_TIME * _SIDE * _SIDE * 3 / ratio))
    lead = -len(frames) % _TIME
    padded = np.concatenate([np.repeat(frames[:1], lead, axis=0), frames])
    out = [_code_group(padded[start : start + _TIME], keep) for start in range(0, len(padded), _TIME)]
    return Seen(frames=np.concatenate(out)[lead:], masks=masks)


def _code_group(frames: Frames, keep: int) -> Frames:
    """Four frames (4, H, W, 3) after coding."""
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
    """Frames (4, H, W, 3), H and W multiples of 8, from the `keep` greatest coefficients of each block."""
    t, height, width, c = colour.shape
    rows, columns = height // _SIDE, width // _SIDE
    blocks = colour.reshape(t, rows, _SIDE, columns, _SIDE, c).transpose(1, 3, 0, 2, 4, 5)
    coefficients = dctn(blocks, axes=(2, 3, 4), norm="ortho").reshape(rows, columns, -1)
    size = np.abs(coefficients)
    least = np.partition(size, -keep, axis=-1)[..., -keep, None]
    kept = np.where(size >= least, coefficients, 0.0).reshape(blocks.shape)
    back = idctn(kept, axes=(2, 3, 4), norm="ortho")
    return np.asarray(back.transpose(2, 0, 3, 1, 4, 5).reshape(colour.shape), dtype=np.float32)
