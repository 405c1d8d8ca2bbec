import json
import shutil

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from kinebench_drake.io.npz import pack_arrays


def write(folder, row, *, times=(0.0, 0.2), results=None):
    (folder / "tracks").mkdir(parents=True)
    (folder / "samples.jsonl").write_text(json.dumps(row) + "\n")
    (folder / "results.json").write_text(json.dumps(results or {"code_sha256": "a", "n": 1}))
    (folder / "tracks/a.npz").write_bytes(pack_arrays({"t_s": np.array(times)}))
    (folder / "timings.jsonl").write_text("{}\n")
    return folder


ROW = {"id": "a", "reason": "too short", "content_hash": "1", "metrics": {"sparc": -1.5}, "null_reasons": {"ldlj": "x"}}


@pytest.fixture
def before(tmp_path):
    return write(tmp_path / "before", ROW)


def compare(before, after):
    result = CliRunner().invoke(main, ["equivalence", str(before), str(after)])
    return result.exit_code, result.output.splitlines()


def test_a_copy_of_an_output_folder_is_equivalent(before, tmp_path):
    status, lines = compare(before, shutil.copytree(before, tmp_path / "after"))
    assert (status, lines) == (0, ["3 files equal, 1 not compared, 0 differences"])


def test_differences_in_code_hashes_and_wording_are_ignored(before, tmp_path):
    row = {**ROW, "reason": "other words", "content_hash": "2", "null_reasons": {"ldlj": "y"}}
    after = write(tmp_path / "after", row, results={"code_sha256": "b", "n": 1})
    (after / "timings.jsonl").write_text('{"id": "a"}\n')
    assert compare(before, after)[0] == 0


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"reason": None}, "line 1: reason"),
        ({"metrics": {"sparc": -1.5000001}}, "line 1: metrics.sparc: -1.5 and -1.5000001"),
        ({"metrics": {"sparc": None}}, "metrics.sparc"),
        ({"metrics": {"sparc": -1.5, "ldlj": 0}}, "metrics: keys ldlj"),
        ({"null_reasons": {"sparc": "x"}}, "null_reasons"),
        ({"id": "b"}, "line 1: id"),
    ],
)
def test_a_different_row_is_named(before, tmp_path, changes, part):
    status, lines = compare(before, write(tmp_path / "after", {**ROW, **changes}))
    assert status == 1
    assert part in lines[0]


def test_different_arrays_types_and_missing_files_are_named(before, tmp_path):
    after = write(tmp_path / "after", ROW, times=(0.0, 0.2 + 1e-16 * 4), results={"code_sha256": "a", "n": 1.0})
    (after / "extra.csv").write_text("")
    status, lines = compare(before, after)
    assert status == 1
    assert lines[:-1] == [
        f"extra.csv: missing in {before}",
        "results.json: n: 1 and 1.0",
        "tracks/a.npz: arrays differ: t_s",
    ]


def test_an_empty_folder_is_reported_as_no_output(tmp_path):
    (tmp_path / "a").mkdir()
    status, lines = compare(tmp_path / "a", tmp_path / "a")
    assert status == 1
    assert "holds no file" in lines[-1]
