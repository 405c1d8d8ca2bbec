"""Videos with planted faults: contents and reproducibility of the files."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from kinebench_drake.formats.camerafile import load_camera


@pytest.mark.parametrize(
    "arguments", [["--tasks", "Nothing-v1"], ["--sizes", "1,2"], ["--kinds", "melt"], ["--suite", "2", "--split", "x"]]
)
def test_invalid_options_are_usage_errors_and_write_nothing(tmp_path: Path, arguments: list[str]) -> None:
    assert CliRunner().invoke(main, ["planted-videos", "--out", str(tmp_path / "out"), *arguments]).exit_code == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.sapien
def test_the_same_arguments_give_the_same_bytes(tmp_path: Path) -> None:
    def made(name: str) -> dict[str, bytes]:
        out = tmp_path / name
        arguments = ["planted-videos", "--out", str(out), "--tasks", "PullCube-v1", "--suite", "2", "--seed", "3"]
        result = CliRunner().invoke(main, [*arguments, "--kinds", "freeze", "--sizes", "5"])
        assert result.exit_code == 0, result.output
        return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}

    first = made("a")
    second = made("b")
    assert first == second
    out = tmp_path / "a"
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    (id,) = (line["id"] for line in lines)
    assert id.startswith("PullCube-v1_s0003")
    assert id.endswith("freeze_5f")
    assert load_camera(out / "camera.json").camera.width == 384
    faults = json.loads((out / "truth" / "faults.json").read_text())
    assert set(faults) == {id}
    with np.load(out / "truth" / f"{id}.npz") as truth:
        assert truth["base_from_tcp"].shape == truth["camera_from_hand"].shape == (49, 4, 4)
        assert truth["q"].shape == (49, 7)
        assert truth["t_s"][-1] == pytest.approx(9.6)
