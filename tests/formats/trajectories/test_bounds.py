"""Bounds of trajectories in tables, whatever their format."""

import time

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from kinebench_drake.errors import InputError
from kinebench_drake.io import parquet as module
from kinebench_drake.io.parquet import read_table
from kinebench_drake.results.row import Status
from kinebench_drake.runs.audit import AuditConfig, audit_trajectories

JOINTS = "t_s," + ",".join(f"q{k}_rad" for k in range(1, 8))


@pytest.fixture
def reason(tmp_path):
    """Return why a csv table cannot be audited."""

    def audited(text):
        (tmp_path / "a.csv").write_text(text, encoding="utf-8")
        config = AuditConfig(source=tmp_path / "a.csv", out=tmp_path / "out", overwrite=True, replays=None)
        [row] = audit_trajectories(config).rows
        assert row.status is Status.ERROR
        return row.reason

    return audited


def test_a_table_of_a_million_columns_is_refused_at_once(reason):
    start = time.monotonic()
    assert "at most 1000 are accepted" in reason("," * 10**6 + "\n")
    assert time.monotonic() - start < 60  # a comparison of all names with all others takes hours


@pytest.mark.parametrize("number", ["1_0", "\u0661", "0x1"])
def test_numbers_are_written_with_the_digits_0_to_9(reason, number):
    assert "expected a number" in reason(f"{JOINTS}\n" + "".join(f"{k},{number}" + ",0" * 6 + "\n" for k in range(3)))


def test_a_parquet_table_is_refused_before_it_takes_more_than_its_budget(tmp_path, monkeypatch):
    n = 10_000
    table = pyarrow.table({"episode_index": np.repeat([0, 1], n // 2), "x": np.zeros(n), "y": np.zeros(n)})
    parquet.write_table(table, tmp_path / "a.parquet", row_group_size=1000)
    assert read_table(tmp_path / "a.parquet", ["x"]).num_rows == n
    assert read_table(tmp_path / "a.parquet", ["x"], ["z"], ("episode_index", 1)).num_rows == n // 2
    monkeypatch.setattr(module, "MOST_BYTES", 5000)
    assert read_table(tmp_path / "a.parquet", ["x"], where=("episode_index", 7)).num_rows == 0
    with pytest.raises(InputError, match=r"a\.parquet: its rows take more than"):
        read_table(tmp_path / "a.parquet", ["x"])
