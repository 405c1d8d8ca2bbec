"""Contrast and noise."""

import numpy as np

from kinebench_drake.grounding.evaluation.perturbation.seen import Frames, Masks, Seen, to_bytes


def fade(frames: Frames, masks: Masks, rng: np.random.Generator, loss: float) -> Seen:
    """Take `loss` (0..1) of the contrast: every level moves that far towards the mean of the whole video."""
    mean = frames.mean(axis=(0, 1, 2))
    return Seen(frames=to_bytes(frames + loss * (mean - frames)), masks=masks)


def add_noise(frames: Frames, masks: Masks, rng: np.random.Generator, sigma: float) -> Seen:
    """Add Gaussian noise of standard deviation `sigma` [levels of 255], anew in each pixel, channel and frame."""
    out = np.empty_like(frames)
    for i, frame in enumerate(frames):
        out[i] = to_bytes(frame + sigma * rng.standard_normal(frame.shape, dtype=np.float32))
    return Seen(frames=out, masks=masks)
