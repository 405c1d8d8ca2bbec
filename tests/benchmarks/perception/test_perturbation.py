"""Laws of the perturbations."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from benchmarks.perception.perturbation.catalogue import (
    Perturbation,
    PerturbationKind,
    code_latent,
    directions,
    ladder,
    line_kernel,
    perturb,
)
from benchmarks.perception.perturbation.gripper import displacement, smooth_noise

Square = tuple[np.ndarray, np.ndarray]


@pytest.mark.parametrize("kind", PerturbationKind)
def test_perturbation_keeps_shape_repeats_by_seed_and_is_the_identity_at_strength_0(
    kind: PerturbationKind, square: Square
) -> None:
    frames, masks = square
    before = frames.copy()
    step = ladder(kind)[1]
    one, left = perturb(step, frames, masks, 0, "a")
    assert (one.shape, one.dtype, left.shape) == (frames.shape, np.uint8, masks.shape)
    np.testing.assert_array_equal(one, perturb(step, frames, masks, 0, "a")[0])
    assert (one != frames).any()
    np.testing.assert_array_equal(frames, before)
    nothing, all_left = perturb(Perturbation(kind=kind, strength=0.0), frames, masks, 0, "a")
    np.testing.assert_array_equal(nothing, frames)
    np.testing.assert_array_equal(all_left, masks)


@pytest.mark.parametrize("kind", [PerturbationKind.DEFORMATION, PerturbationKind.OCCLUSION, PerturbationKind.NOISE])
def test_two_clips_get_different_perturbations(kind: PerturbationKind, square: Square) -> None:
    step = ladder(kind)[1]
    assert (perturb(step, *square, 0, "a")[0] != perturb(step, *square, 0, "b")[0]).any()


@pytest.mark.parametrize("kind", [k for k in PerturbationKind if k is not PerturbationKind.OCCLUSION])
def test_greater_strength_changes_pixels_more(kind: PerturbationKind, square: Square) -> None:
    frames, masks = square
    changes = [np.abs(perturb(p, frames, masks, 0, "a")[0].astype(float) - frames)[masks].mean() for p in ladder(kind)]
    assert all(a < b for a, b in pairwise(changes))


def test_occlusion_hides_its_nominal_share_of_the_mask(square: Square) -> None:
    frames, masks = square
    for step in ladder(PerturbationKind.OCCLUSION):
        seen, left = perturb(step, frames, masks, 0, "a")
        hidden = 1 - left.sum(axis=(1, 2)) / masks.sum(axis=(1, 2))
        assert np.abs(hidden - step.strength).max() <= 0.03
        assert not (left & ~masks).any()
        painted = (seen != frames).any(axis=-1)
        assert painted[masks & ~left].mean() > 0.98
        beside = binary_dilation(masks & ~left, np.ones((1, 5, 5)))  # the shapes' edges are soft
        assert not painted[left & ~beside].any()


def test_consecutive_occlusions_overlap_by_half(square: Square) -> None:
    frames, masks = square
    still = np.repeat(masks[:1], len(masks), axis=0)
    _, left = perturb(Perturbation(kind=PerturbationKind.OCCLUSION, strength=0.3), frames, still, 0, "a")
    hidden = still & ~left
    overlap = [(a & b).sum() / (a | b).sum() for a, b in pairwise(hidden)]
    assert min(overlap) > 0.5


def test_deformation_has_its_nominal_rms_displacement_and_no_rigid_motion(square: Square) -> None:
    mask = square[1][3]
    nodes = smooth_noise(np.random.default_rng(1), 1, 8, (5, 5, 2))[0]
    v, u = np.nonzero(mask)
    middle = np.array([u.mean(), v.mean()])
    shift = displacement(mask, nodes, middle, 3.0)
    inside = shift[mask]
    x = u - middle[0]
    y = v - middle[1]
    assert np.sqrt((inside**2).sum(axis=1).mean()) == pytest.approx(3.0, rel=1e-6)
    np.testing.assert_allclose(inside.mean(axis=0), 0.0, atol=1e-9)
    assert (x * inside[:, 1] - y * inside[:, 0]).mean() == pytest.approx(0.0, abs=1e-8)  # turn
    assert (x * inside[:, 0] + y * inside[:, 1]).mean() == pytest.approx(0.0, abs=1e-8)  # size
    assert np.abs(shift[:, :2]).max() == 0.0  # far away


def test_motion_blur_lies_along_the_direction_of_motion() -> None:
    kernel = line_kernel(9.0, np.pi / 2)
    assert kernel.sum() == pytest.approx(1.0)
    half = kernel.shape[0] // 2
    assert kernel[:, half].sum() == pytest.approx(1.0)
    assert (kernel[:, half] > 0.05).sum() == 9
    assert line_kernel(0.0, 1.0).max() == 1.0
    path = np.array([[0.0, 0], [0, 0], [0, 2], [0, 4], [0, 4], [0, 4]])
    np.testing.assert_allclose(directions(path, 0.3), [0.3] + [np.pi / 2] * 4 + [np.pi / 2])


def test_noise_has_its_nominal_standard_deviation() -> None:
    grey = np.full((3, 64, 64, 3), 128, np.uint8)
    noisy, _ = perturb(
        Perturbation(kind=PerturbationKind.NOISE, strength=20.0), grey, np.ones((3, 64, 64), bool), 0, "a"
    )
    assert (noisy.astype(float) - 128).std() == pytest.approx(20.0, rel=0.03)


def test_reduced_contrast_keeps_the_mean_image(square: Square) -> None:
    frames, masks = square
    faded, _ = perturb(Perturbation(kind=PerturbationKind.CONTRAST, strength=0.6), frames, masks, 0, "a")
    np.testing.assert_allclose(faded.mean(axis=(0, 1, 2)), frames.mean(axis=(0, 1, 2)), atol=0.3)
    assert faded.std() == pytest.approx(0.4 * frames.std(), rel=0.02)


def test_ghosting_blends_in_earlier_frames() -> None:
    frames = np.zeros((4, 8, 8, 3), np.uint8)
    frames[1] = 200
    ghosts, _ = perturb(
        Perturbation(kind=PerturbationKind.GHOSTING, strength=0.4), frames, np.ones((4, 8, 8), bool), 0, "a"
    )
    np.testing.assert_array_equal(ghosts[:, 0, 0, 0], [0, 120, 40, 40])


def test_latent_coding_preserves_a_smooth_image_for_any_number_of_frames() -> None:
    x = np.linspace(60, 180, 40).astype(np.uint8)
    ramp = np.broadcast_to(x[None, None, :, None], (5, 36, 40, 3)).copy()
    coded, _ = code_latent(ramp, np.ones((5, 36, 40), bool), np.random.default_rng(0), 48.0)
    assert coded.shape == ramp.shape
    assert np.abs(coded.astype(int) - ramp).max() <= 3
