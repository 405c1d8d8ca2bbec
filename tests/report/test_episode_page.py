"""The html report of a run in closed loop: success before feasibility, the cause of each failure, videos linked."""

import re

import pytest

from kinebench_drake.report.page import write_report
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from tests.report.pages import EVIL, Page, row
from tests.rows import make_cause


@pytest.fixture
def page(tmp_path):
    """Two tasks: one episode each that succeeds, and one that fails."""
    with ResultStore(tmp_path) as store:
        for task, verdict in (("CloseBox-v1", "task"), ("StackCube-v1", "execution")):
            for seed, failure in enumerate((None, verdict)):
                cause = failure and make_cause(failure, f"off by {EVIL}")
                extra = {"success": failure is None, "progress": 0.5 + 0.5 * (failure is None), "rounds": 1 + 2 * seed}
                extra |= {"verdict": failure, "cause": cause}
                store.append(row(f"{task}_s{seed}", task=task, feasible=True, extra=extra), 0.1)
        store.append(row("StackCube-v1_s2", status=Status.ERROR, task="StackCube-v1"), 0.1)
        config = {"world_model": "wan", "suite": 2, "split": "unseen"}
        (tmp_path / "rollouts").mkdir()
        (tmp_path / "rollouts" / "CloseBox-v1_s1.mp4").touch()
        store.finish({"kind": "suite", "config": config, "tags": {}, "seeds": {"bootstrap": 0}})
    return write_report(tmp_path).read_text()


def test_success_is_the_headline_number(page):
    assert "<h1>wan, suite 2 (unseen)</h1>" in page
    tiles = re.findall(r'class="name">([^<]*)</span><b>([^<]*)', page)
    assert ("Success", "50%") in tiles
    assert ("Rounds", "2.00") in tiles


def test_each_failure_names_its_cause(page):
    badges = re.findall(r'<span class="badge v-(\w+)">([^<]*)', page)
    assert badges[1:3] == [("execution", "failed: execution"), ("task", "failed: task")]
    assert badges.count(("success", "success")) == 2
    assert "off by &lt;script&gt;" in page
    assert EVIL not in page


def test_videos_are_linked_where_they_exist(page):
    links = [link for link in Page(page).links if not link.startswith(("data:", "#"))]
    assert links == ["rollouts/CloseBox-v1_s1.mp4"]


def test_the_task_table_has_a_column_of_success(page):
    table = page[page.index("<h2>By task</h2>") :]
    heads = re.findall(r"<th(?: [^>]*)?>(?:<button[^>]*>)?([^<]*)", table[: table.index("</thead>")])
    assert heads[:6] == ["Task", "Measured", "Verdicts", "Success", "Executable", "Feasible"]
    cells = re.findall(r"<td[^>]*>(?:<button[^>]*>)?([^<]*)", table[table.index("<tbody>") :])
    assert cells[:5] == ["CloseBox-v1", "2 / 2", "", "50%", "–"]
