"""Runs beside direct execution: each episode executed once, each model held against it."""

import csv

import pytest
from kinebench_drake.report.suite.ceiling import DIRECT, read_ceiling, share_lines
from kinebench_drake.report.suite.writing import write_comparison
from tests.suite_report.synthetic import write_run

from kinebench_drake.closed_loop.tolerance import ErrorGrade, ToleranceAttempt
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import ItemResult
from kinebench_drake.executors.progress import NullObserver
from kinebench_drake.report.suite.ceiling import DIRECT, read_ceiling, share_lines
from kinebench_drake.report.suite.comparison import ALL
from kinebench_drake.results.store import SAMPLES

TASKS = {"PullCube-v1": [True, False, True], "StackCube-v1": [False, False, True]}


class Recorder(NullObserver):
    """Keeps the number of executions and of progress lines."""

    def __init__(self):
        self.total, self.lines = 0, []

    def start(self, total, completed):
        self.total = total

    def advance(self, line, *, ok=True):
        self.lines.append(line)


class Rehearsed:
    """An engine in which direct execution fails in some episodes."""

    def __init__(self, failing=()):
        self.failing, self.asked = failing, []

    def run(self, make_worker, items):
        for episode in items:
            self.asked.append(episode.id)
            good = episode.id not in self.failing
            grade = ErrorGrade(error=None, size=0.0)
            told = "" if good else "placed"
            attempt = ToleranceAttempt(episode=episode, grade=grade, success=good, progress=float(good), reason=told)
            yield ItemResult(item=episode, result=[attempt])


def test_each_model_is_held_against_direct_execution_alone(tmp_path):
    a = write_run(tmp_path / "a", TASKS, model="wan")
    b = write_run(tmp_path / "b", {**TASKS, "PullCube-v1": [True, True, True]}, model="cog")
    engine, observer = Rehearsed(failing={"StackCube-v1_s0000"}), Recorder()
    found = read_ceiling([a, b], engine, observer)
    assert sorted(engine.asked) == sorted(f"{task}_s{seed:04d}" for task in TASKS for seed in range(3))
    assert observer.total == len(observer.lines) == 6
    assert "StackCube-v1_s0000: placed" in observer.lines
    assert {(c.first, c.second) for c in found.compared} == {("wan", DIRECT), ("cog", DIRECT)}
    [wan] = [c for c in found.compared if c.first == "wan" and c.task == ALL]
    assert (wan.paired.both, wan.paired.first_only, wan.paired.second_only, wan.paired.neither) == (3, 0, 2, 1)
    assert "wan, Suite 0: success in 3 of 6, direct execution in 5, 60.0% of it" in list(share_lines(found.compared))


def test_direct_execution_has_no_folder_of_the_model_s(tmp_path):
    a = write_run(tmp_path / "a", TASKS)
    (a / "report.html").write_text("page")
    found = read_ceiling([a], Rehearsed(), NullObserver())
    page = write_comparison(found, tmp_path / "out").read_text()
    assert page.count('href="../a/report.html#') == 6
    with (tmp_path / "out" / "episodes.csv").open() as file:
        folders = [(row["model"], row["folder"]) for row in csv.DictReader(file)]
    assert set(folders) == {("wan", "a"), (DIRECT, "")}


def test_a_row_that_does_not_tell_its_episode_is_told(tmp_path):
    a = write_run(tmp_path / "a", TASKS)
    path = a / SAMPLES
    path.write_text(path.read_text().replace('"pool": "all", ', ""))
    with pytest.raises(UsageError, match=r"PullCube-v1_s0000 does not tell its episode \('pool'\)"):
        read_ceiling([a], Rehearsed(), NullObserver())


def test_no_model_may_be_called_like_it(tmp_path):
    a = write_run(tmp_path / "a", TASKS, model=DIRECT)
    with pytest.raises(UsageError, match="another name"):
        read_ceiling([a], Rehearsed(), NullObserver())
