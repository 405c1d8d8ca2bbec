"""Videos of a model, stored beside the other videos of a run."""

from pathlib import Path

import pytest

from kinebench_drake.closed_loop.loop import _place_beside


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out" / "videos").mkdir(parents=True)
    return tmp_path / "out" / "videos" / "PullCube-v1_s0000_r0"


def frames(folder: Path, count: int) -> Path:
    """A folder of frames."""
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"{number}.png").write_bytes(b"%d" % count)
    return folder


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_copy_holds_what_the_source_holds_now(tmp_path: Path, out: Path) -> None:
    _place_beside(frames(tmp_path / "five", 5), out)
    assert _place_beside(frames(tmp_path / "three", 3), out) == out
    assert names(out) == ["0.png", "1.png", "2.png"]


def test_a_copy_is_the_only_film_of_its_round(tmp_path: Path, out: Path) -> None:
    _place_beside(frames(tmp_path / "five", 5), out)
    for suffix in (".mp4", ".gif"):
        (tmp_path / f"film{suffix}").write_bytes(suffix.encode())
        copy = _place_beside(tmp_path / f"film{suffix}", out)
        assert names(out.parent) == [copy.name] == [f"{out.name}{suffix}"]


def test_a_model_s_own_folder_is_left(out: Path) -> None:
    beside = frames(out.parent / "PullCube-v1_s0000", 2)
    assert _place_beside(beside, out) == beside
    within = frames(out / "work", 3)
    assert _place_beside(within, out) == out
    assert names(within) == ["0.png", "1.png", "2.png"]
    assert names(out) == [*names(within), "work"]
