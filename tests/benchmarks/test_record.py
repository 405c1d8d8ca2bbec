from dataclasses import replace

import pytest

from benchmarks import record
from benchmarks.record import PAGES, BenchmarkRecord, compare_records, write_pages
from kinebench_drake.errors import InputError


@pytest.fixture
def result():
    return BenchmarkRecord.of("ik", {"a, ms": 2.0, "b, ms": 3.0, "c, ms": 1.0}, "## Speed\n\n2 ms")


def test_results_survive_storage_and_damaged_files_are_refused(result, tmp_path):
    assert BenchmarkRecord.read("ik", tmp_path) is None
    path = result.write(tmp_path)
    assert BenchmarkRecord.read("ik", tmp_path) == result
    path.write_text('{"name": "ik"}')
    with pytest.raises(InputError, match=r"ik\.json: is no result"):
        BenchmarkRecord.read("ik", tmp_path)


def test_comparison_lists_only_figures_that_became_worse(result):
    now = replace(result, figures={"a, ms": 3.0, "b, ms": 1.0, "c, ms": 1.05, "d, ms": 9.0})
    first, *lines = compare_records(result, now)
    assert first.startswith("1 of 3 figures")
    assert lines[2:] == ["| a, ms | 2 | 3 | 1.50 |"]
    other = replace(now, machine={"cpu": "another"})
    assert [line.split(" ")[0] for line in compare_records(result, other)] == ["not"]


def test_sections_of_the_results_are_written_into_the_pages(result, tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n## Speed\n\nold\n\n## Other\n\nkept\n")
    monkeypatch.setattr(record, "PAGES", dict.fromkeys(PAGES, page))
    result.write(tmp_path)
    lines = list(write_pages(tmp_path))
    assert page.read_text() == f"# Page\n\n## Speed\n\n2 ms\n\nRevision {result.revision}.\n\n## Other\n\nkept\n"
    by_name = dict(zip(PAGES, lines, strict=True))
    assert by_name.pop(result.name).endswith(f"measured at {result.revision}")
    assert by_name == {name: f"{name}: no result" for name in by_name}
