"""Rows as a table of pyarrow: a row a sample, the worst first, a type a column."""

import pyarrow
import pytest

from kinebench_drake import read_results
from kinebench_drake.errors import UsageError
from kinebench_drake.results.store import ResultStore
from tests.report.pages import row


def test_a_table_has_every_sample_the_worst_first(tmp_path):
    speed = {"kind": "velocity", "frame_start": 2, "frame_end": 4, "joint": "j2", "value": 2.0, "limit": 1.0}
    with ResultStore(tmp_path) as store:
        for k, broken in enumerate([(), (), (speed, speed)]):
            metrics = {"sparc": -1.0 - k, "motionless": k == 0, "unknown": None}
            store.append(row(f"s{k}", feasible=not broken, violations=broken, metrics=metrics, task="$x"), 0.1)
        store.finish({"kind": "score"})
    table = read_results(tmp_path)
    assert table.column("id").to_pylist() == ["s2", "s0", "s1"]
    assert table.column("violations").to_pylist() == ["velocity", "", ""]
    assert table.column("sparc").to_pylist() == [-3.0, -1.0, -2.0]
    types = {name: table.schema.field(name).type for name in ("task", "feasible", "sparc", "motionless", "unknown")}
    boolean = pyarrow.bool_()
    assert [*types.values()] == [pyarrow.string(), boolean, pyarrow.float64(), boolean, boolean]


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(UsageError, match="expected the output folder of a run"):
        read_results(tmp_path)
