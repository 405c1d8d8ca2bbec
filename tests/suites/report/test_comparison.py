"""Runs compared with direct execution: each episode is executed once, each model is compared with it alone."""

import csv

import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.results.store import SAMPLES
from kinebench_drake.suites.closed_loop.tolerance import ErrorGrade, ToleranceAttempt
from kinebench_drake.suites.report.comparison import ALL_TASKS, DIRECT, ceiling_lines, read_ceiling
from kinebench_drake.suites.report.suite_page import write_comparison
from tests.suites.report.synthetic import write_run

TASKS = {"PullCube-v1": [True, False, True], "StackCube-v1": [False, False, True]}


def execute(episodes, failing=()):
    """Direct execution that fails in some episodes."""
    for episode in episodes:
        success = episode.id not in failing
        yield ToleranceAttempt(
            episode=episode,
            grade=ErrorGrade(error=None, size=0.0),
            success=success,
            progress=float(success),
            reason="" if success else "placed",
        )


def test_each_model_is_compared_only_with_direct_execution(tmp_path):
    a = write_run(tmp_path / "a", TASKS, model="wan")
    b = write_run(tmp_path / "b", {**TASKS, "PullCube-v1": [True, True, True]}, model="cog")
    executed = []

    def once(episodes):
        executed.extend(episode.id for episode in episodes)
        return execute(episodes, failing={"StackCube-v1_s0000"})

    comparison = read_ceiling([a, b], once)
    assert sorted(executed) == sorted(f"{task}_s{seed:04d}" for task in TASKS for seed in range(3))
    assert {(c.first, c.second) for c in comparison.numbers} == {("wan", DIRECT), ("cog", DIRECT)}
    [wan] = [c for c in comparison.numbers if (c.first, c.task, c.metric.name) == ("wan", ALL_TASKS, "success")]
    assert (wan.paired.n, wan.paired.rates, wan.paired.better) == (6, (0.5, 5 / 6), (0, 2))
    lines = list(ceiling_lines(comparison.numbers))
    assert "wan, Suite 0: success in 3 of 6, direct execution in 5, 60.0% of it" in lines


def test_direct_execution_has_no_folder(tmp_path):
    a = write_run(tmp_path / "a", TASKS)
    (a / "report.html").write_text("page")
    page = write_comparison(read_ceiling([a], execute), tmp_path / "out").read_text()
    assert page.count('href="../a/report.html#') == 6
    with (tmp_path / "out" / "episodes.csv").open() as file:
        folders = [(row["model"], row["folder"]) for row in csv.DictReader(file)]
    assert set(folders) == {("wan", "a"), (DIRECT, "")}


def test_a_row_that_does_not_identify_its_episode_is_refused(tmp_path):
    a = write_run(tmp_path / "a", TASKS)
    path = a / SAMPLES
    path.write_text(path.read_text().replace('"pool": "all", ', ""))
    with pytest.raises(UsageError, match=r"PullCube-v1_s0000 does not identify its episode \('pool'\)"):
        read_ceiling([a], execute)


def test_no_model_may_have_the_label_of_direct_execution(tmp_path):
    a = write_run(tmp_path / "a", TASKS, model=DIRECT)
    with pytest.raises(UsageError, match="another name"):
        read_ceiling([a], execute)
