"""Entries of a video are result by its id before its stem, and truth before the video itself."""

from pathlib import Path

import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.grounding.overrides.overrides import TRACKS, TRUTH, find_entry


def test_the_better_name_and_the_safer_place_go_first(tmp_path: Path) -> None:
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


def test_tracks_of_another_run_are_found_where_they_are_asked_for(tmp_path: Path) -> None:
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / "v.npz").touch()
    assert find_entry(tmp_path, ("v",), (TRUTH, TRACKS)) == tmp_path / "tracks" / "v.npz"
    with pytest.raises(InputError):
        find_entry(tmp_path, ("v",))
