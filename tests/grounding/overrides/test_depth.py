"""Depth is read in metres from every format; exact only if declared or the truth of a demonstration."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import InputError
from kinebench_drake.grounding.overrides.overrides import read_depth

DEPTH_M = np.random.default_rng(0).integers(300, 1200, (4, 6, 10)) / 1000.0
DEPTH_M[1, :2] = 0.0
MM = np.rint(DEPTH_M * 1000).astype(np.uint16)


def test_depth_of_every_format_is_read_in_metres(tmp_path: Path) -> None:
    np.savez(tmp_path / "metres.npz", depth_m=DEPTH_M.astype(np.float32))
    np.savez(tmp_path / "millimetres.npz", depth_mm=MM)
    np.savez(tmp_path / "type.npz", depth=MM)
    np.save(tmp_path / "metres.npy", np.where(DEPTH_M > 0, DEPTH_M, np.nan))
    np.save(tmp_path / "signed.npy", np.where(DEPTH_M > 0, DEPTH_M, -1.0))
    np.save(tmp_path / "millimetres.npy", MM)
    (tmp_path / "pictures").mkdir()
    for number, image in enumerate(MM):
        Image.fromarray(image).save(tmp_path / "pictures" / f"{number:04}.png")
    entries = sorted(tmp_path.iterdir())
    assert len(entries) == 7
    for entry in entries:
        for exact in (False, True):
            depth = read_depth(entry, exact=exact)
            np.testing.assert_allclose(depth.depth_m, DEPTH_M, atol=1e-6, err_msg=entry.name)
            assert depth.exact is exact


def test_true_depth_of_a_demonstration_is_exact_and_corrected_for_truncation_to_millimetres(tmp_path: Path) -> None:
    true_m = np.where(DEPTH_M > 0, DEPTH_M + 0.0005, 0.0)
    cut = np.floor(true_m * 1000 + 1e-9).astype(np.uint16)
    mask = np.packbits(DEPTH_M > 0.5, axis=-1)
    np.savez(tmp_path / "v.npz", depth_mm=cut, mask=mask, camera_from_hand=np.zeros((4, 4, 4)))
    depth = read_depth(tmp_path / "v.npz")
    assert depth.exact
    np.testing.assert_allclose(depth.depth_m, true_m, atol=1e-9)


def test_files_that_contain_no_depth_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "unit.npy", DEPTH_M * 1000)
    np.save(tmp_path / "nothing.npy", np.full((2, 4, 4), np.inf))
    np.save(tmp_path / "truth_values.npy", DEPTH_M > 0)
    np.savez(tmp_path / "other.npz", disparity=DEPTH_M)
    (tmp_path / "dark").mkdir()
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "dark" / "0.png")
    expected = {
        "unit.npy": "another unit",
        "nothing.npy": "no depth is known",
        "truth_values.npy": "bool",
        "other.npz": "holds disparity; expected depth_m or",
        "dark": "16-bit",
    }
    for name, message in expected.items():
        with pytest.raises(InputError, match=message):
            read_depth(tmp_path / name)
