"""Displacement of a textured square that moves over a textured ground."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from kinebench_drake.grounding.displacement import measure_displacement

SIDE = 40
FRAMES = 12


def draw(offset_px=0, first=0, hidden=()):
    """Frames with a square that moves by 8 px a frame, from frame `first` on shifted, in some frames hidden."""
    rng = np.random.default_rng(0)
    ground = gaussian_filter(rng.uniform(0, 255, (120, 200, 3)), (2, 2, 0))
    square = 255 * (gaussian_filter(rng.uniform(0, 1, (SIDE, SIDE, 3)), (2, 2, 0)) > 0.5)
    frames = np.repeat(ground[None], FRAMES, axis=0)
    for k in set(range(FRAMES)) - set(hidden):
        left = 20 + 8 * k
        top = 30 + (offset_px if k >= first else 0)
        frames[k, top : top + SIDE, left : left + SIDE] = square
    return frames.astype(np.uint8)


def test_the_displacement_is_that_of_what_moves():
    result = measure_displacement(draw(6, first=5), draw())
    assert result.frames.tolist() == list(range(FRAMES))
    assert result.distance_px[:5] == pytest.approx(0.0, abs=0.1)
    assert result.distance_px[5:] == pytest.approx(6.0, abs=0.5)
    assert 0.0 < result.error_px < 0.3


def test_frames_without_counterpart_are_lost_and_still_clips_are_not_compared():
    result = measure_displacement(draw(hidden=(7, 8)), draw())
    lost = np.isnan(result.distance_px) | (result.distance_px > 3.0)
    assert np.flatnonzero(lost).tolist() == [7, 8]
    still = measure_displacement(draw(), np.repeat(draw()[:1], FRAMES, axis=0))
    assert (len(still.frames), still.error_px) == (0, 0.0)
