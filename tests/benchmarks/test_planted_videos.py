"""Videos with planted faults: contents and reproducibility of the files."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.planted_videos import choose_episodes, parse_seeds
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.composition import Pool


def test_seeds_are_parsed_from_numbers_and_ranges() -> None:
    assert parse_seeds("7") == [7]
    assert parse_seeds("0:3,9") == [0, 1, 2, 9]
    for wrong in ("", "a", "3:1", "-2", "1:b"):
        with pytest.raises(UsageError, match="seeds"):
            parse_seeds(wrong)


def test_episodes_of_a_split_are_those_of_the_suite() -> None:
    draws = choose_episodes("StackCube-v1,PullCube-v1", "0", 2, "unseen", 2, 3)
    assert {d.pool for d in draws} == {Pool.UNSEEN}
    assert sorted((d.task, d.seed) for d in draws) == [(t, s) for t in ("PullCube-v1", "StackCube-v1") for s in (3, 4)]
    assert {d.pool for d in choose_episodes(None, "0", None, "test", 1, 0)} == {Pool.ALL}


@pytest.mark.parametrize(
    "arguments", [["--tasks", "Nothing-v1"], ["--seeds", "x"], ["--kinds", "melt"], ["--suite", "2", "--split", "x"]]
)
def test_invalid_options_are_usage_errors_and_write_nothing(tmp_path: Path, arguments: list[str]) -> None:
    assert CliRunner().invoke(main, ["planted-videos", "--out", str(tmp_path / "out"), *arguments]).exit_code == 2
    assert not (tmp_path / "out").exists()


def test_writing_the_same_frames_gives_the_same_bytes(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 255, (5, 33, 65, 3), dtype=np.uint8)
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, frames, 17)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]


@pytest.mark.sapien
def test_the_same_arguments_give_the_same_bytes(tmp_path: Path) -> None:
    def made(name: str) -> dict[str, bytes]:
        out = tmp_path / name
        arguments = ["planted-videos", "--out", str(out), "--tasks", "PullCube-v1", "--seeds", "3"]
        result = CliRunner().invoke(main, [*arguments, "--with-depth", "--kinds", "freeze", "--sizes", "5"])
        assert result.exit_code == 0, result.output
        return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}

    first = made("a")
    second = made("b")
    assert first == second
    out = tmp_path / "a"
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    assert [line["id"] for line in lines] == ["PullCube-v1_s0003_freeze_5f"]
    assert load_camera(out / "camera.json").camera.width == 384
    faults = json.loads((out / "truth" / "faults.json").read_text())
    assert set(faults) == {"PullCube-v1_s0003_freeze_5f"}
    with np.load(out / "truth" / "PullCube-v1_s0003_freeze_5f.npz") as truth:
        assert truth["base_from_tcp"].shape == truth["camera_from_hand"].shape == (49, 4, 4)
        assert truth["q"].shape == (49, 7)
        assert truth["t_s"][-1] == pytest.approx(9.6)
        mask = np.unpackbits(truth["mask"], axis=-1, count=384).astype(bool)
        assert mask.shape == truth["depth_mm"].shape == (49, 384, 384)
        assert (truth["depth_mm"][mask] > 100).all()
