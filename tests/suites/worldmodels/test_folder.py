from dataclasses import replace
from pathlib import Path

import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.worldmodels.folder import FolderModel
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError


@pytest.fixture
def videos(tmp_path: Path) -> Path:
    folder = tmp_path / "videos"
    folder.mkdir()
    return folder


def answer(videos: Path, request: Request) -> Path:
    return FolderModel(parse(f"folder:{videos}")).generate(request, videos.parent / "out")


@pytest.mark.parametrize("name", ["StackCube-v1_s0003.mp4", "StackCube-v1_s0003.webm", "StackCube-v1_s0003_r0.mov"])
def test_videos_are_matched_by_id(videos: Path, request_: Request, film: bytes, name: str) -> None:
    (videos / name).write_bytes(film)
    (videos / "StackCube-v1_s0030.mp4").write_bytes(film)
    (videos / "StackCube-v1_s0003.png").write_bytes(b"the first frame of the export")
    assert answer(videos, request_) == videos / name
    assert sorted(path.name for path in videos.parent.iterdir()) == ["videos"]  # nothing is copied


def test_frame_folders_are_matched_by_id(videos: Path, request_: Request) -> None:
    folder = videos / request_.episode
    folder.mkdir()
    with pytest.raises(WorldModelError, match=r"no video of StackCube-v1_s0003; expected StackCube-v1_s0003\.mp4"):
        answer(videos, request_)
    (folder / "0.png").write_bytes(b"")
    assert answer(videos, request_) == folder


def test_several_videos_of_one_episode_are_refused(videos: Path, request_: Request, film: bytes) -> None:
    for suffix in ("mp4", "gif"):
        (videos / f"{request_.episode}.{suffix}").write_bytes(film)
    with pytest.raises(WorldModelError, match=r"several videos .*\.gif, .*\.mp4\)"):
        answer(videos, request_)


def test_videos_outside_the_folder_are_refused(videos: Path, request_: Request, film: bytes) -> None:
    outside = videos.parent / "outside.mp4"
    outside.write_bytes(film)
    (videos / f"{request_.episode}.mp4").symlink_to(outside)
    with pytest.raises(WorldModelError, match="outside the folder"):
        answer(videos, request_)


def test_later_rounds_are_matched_only_by_their_own_names(videos: Path, request_: Request, film: bytes) -> None:
    model = FolderModel(parse(f"folder:{videos}"))
    for name in (f"{request_.episode}.mp4", f"{request_.episode}_r2.gif"):
        (videos / name).write_bytes(film)
    assert answer(videos, request_).name == f"{request_.episode}.mp4"
    with pytest.raises(
        WorldModelError, match=r"no video of StackCube-v1_s0003_r1; expected StackCube-v1_s0003_r1\.mp4"
    ):
        answer(videos, replace(request_, round=1))
    assert answer(videos, replace(request_, round=2)).name == f"{request_.episode}_r2.gif"
    found = [[path.name for path in model.files(request_.episode, request_.task, round)] for round in range(3)]
    assert found == [[f"{request_.episode}.mp4"], [], [f"{request_.episode}_r2.gif"]]


def test_further_samples_are_matched_only_by_their_own_names(videos: Path, request_: Request, film: bytes) -> None:
    model = FolderModel(parse(f"folder:{videos}"))
    for name in (f"{request_.episode}.mp4", f"{request_.episode}_k2.mp4", f"{request_.episode}_k2_r1.mp4"):
        (videos / name).write_bytes(film)
    with pytest.raises(WorldModelError, match=r"expected StackCube-v1_s0003_k1\.mp4"):
        answer(videos, replace(request_, episode=f"{request_.episode}_k1"))
    second = replace(request_, episode=f"{request_.episode}_k2")
    assert answer(videos, second).name == f"{request_.episode}_k2.mp4"
    assert answer(videos, replace(second, round=1)).name == f"{request_.episode}_k2_r1.mp4"
    assert [path.name for path in model.files(request_.episode, request_.task, 0)] == [f"{request_.episode}.mp4"]
    assert model.files(f"{request_.episode}_k1", request_.task, 0) == []


def test_clips_of_an_earlier_run_can_be_replayed(videos: Path, request_: Request, film: bytes) -> None:
    for round in range(2):
        (videos / f"{request_.episode}_r{round}.mp4").write_bytes(film)
        assert answer(videos, replace(request_, round=round)).name == f"{request_.episode}_r{round}.mp4"


def test_a_damaged_video_is_refused(videos: Path, request_: Request) -> None:
    (videos / f"{request_.episode}.mp4").write_bytes(b"<html>")
    with pytest.raises(WorldModelError, match="not a video"):
        answer(videos, request_)


def test_unusable_folders_are_usage_errors(videos: Path) -> None:
    for spec in ("folder:", f"folder:{videos}/none"):
        with pytest.raises(UsageError, match="expected folder:DIR"):
            FolderModel(parse(spec))
