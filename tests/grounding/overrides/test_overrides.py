"""Entries of a video are found by its id before its stem, and in the folder truth before others."""

from pathlib import Path

import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.grounding.overrides.overrides import TRACKS, TRUTH, find_entry


def test_entries_are_searched_by_id_before_stem_and_in_truth_first(tmp_path: Path) -> None:
    order = ["truth/id.npz", "id.npz", "id.npy", "id/0.png", "truth/stem.npz", "stem.npz", "stem/0.png"]
    for name in order:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    for name in order:
        file = tmp_path / name
        result = find_entry(tmp_path, ("id", "stem"))
        assert result == (file.parent if file.suffix == ".png" else file)
        file.unlink()
        if file.suffix == ".png":
            file.parent.rmdir()
    with pytest.raises(InputError, match=r"looked for id\.npz, id\.npy, id/ or stem\.npz, .* in it and in its truth/"):
        find_entry(tmp_path, ("id", "stem"))


def test_the_tracks_folder_of_a_run_is_searched_only_on_request(tmp_path: Path) -> None:
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / "v.npz").touch()
    assert find_entry(tmp_path, ("v",), (TRUTH, TRACKS)) == tmp_path / "tracks" / "v.npz"
    with pytest.raises(InputError):
        find_entry(tmp_path, ("v",))
