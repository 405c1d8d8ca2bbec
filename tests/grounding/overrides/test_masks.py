"""Masks are read unchanged from every format; other arrays are refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import InputError
from kinebench_drake.grounding.overrides.files import array_files, read_masks

Masks = NDArray[np.bool_]
MASKS: Masks = np.random.default_rng(0).random((11, 6, 10)) < 0.4


def pngs(folder: Path, images: NDArray[np.uint8]) -> Path:
    folder.mkdir()
    for number, image in enumerate(images):
        Image.fromarray(image).save(folder / f"mask_{number}.png")  # 10 after 9, though before it by the alphabet
    return folder


def grey(path: Path) -> Path:
    return pngs(path / "v", np.where(MASKS, 7, 0).astype(np.uint8))


def coloured(path: Path) -> Path:
    alpha = np.full((*MASKS.shape, 1), 255)
    blue = np.stack([np.zeros_like(MASKS), np.zeros_like(MASKS), MASKS], axis=-1) * 200
    return pngs(path / "v", np.concatenate([blue, alpha], axis=-1).astype(np.uint8))


def npy(path: Path) -> Path:
    np.save(path / "v.npy", MASKS.astype(np.float32))
    return path / "v.npy"


def npz(path: Path) -> Path:
    np.savez(path / "v.npz", masks=3 * MASKS.astype(np.int64))
    return path / "v.npz"


def truth(path: Path) -> Path:
    packed = np.packbits(MASKS, axis=-1)
    poses = np.zeros((11, 4, 4))
    np.savez(path / "v.npz", mask=packed, depth_mm=np.zeros(MASKS.shape, np.uint16), camera_from_hand=poses)
    return path / "v.npz"


@pytest.mark.parametrize("write", [grey, coloured, npy, npz, truth])
def test_masks_of_every_format_are_read_as_written(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    entry = write(tmp_path)
    np.testing.assert_array_equal(read_masks(entry), MASKS)
    assert len(array_files(entry)) == (11 if entry.is_dir() else 1)


def test_files_that_contain_no_mask_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "soft.npy", np.full((2, 4, 4), 0.3))
    np.savez(tmp_path / "other.npz", frames=MASKS)
    np.save(tmp_path / "turned_round.npy", np.ones((2, 40, 40)) - np.eye(40))
    (tmp_path / "torn.npz").write_bytes(b"PK\x03\x04")
    (tmp_path / "empty").mkdir()
    uneven = pngs(tmp_path / "uneven", np.zeros((2, 4, 4), np.uint8))
    Image.fromarray(np.zeros((5, 4), np.uint8)).save(uneven / "mask_2.png")
    expected = {
        "soft.npy": "besides 0 and 1",
        "turned_round.npy": "inverted masks",
        "other.npz": "holds frames; expected mask or masks",
        "torn.npz": "zip archive",
        "empty": "holds no png",
        "uneven": r"mask_2\.png.*first image",
    }
    for name, message in expected.items():
        with pytest.raises(InputError, match=message):
            read_masks(tmp_path / name)
