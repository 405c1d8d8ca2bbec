"""Loss of success from seen to unseen: pairing, bounds, and which runs are compared."""

import numpy as np
import pytest

from kinebench_drake.report.number import ALL_TASKS
from kinebench_drake.stats import PairedShares
from kinebench_drake.suites.catalog import load_suite
from kinebench_drake.suites.report.pooling import pool_episodes, read_suite_runs
from kinebench_drake.suites.report.suite_page import write_suite_report
from kinebench_drake.suites.report.transfer import study_drops, tabulate_drops
from tests.suites.report.synthetic import change, failed, write_run


def episodes_of(*paths):
    return pool_episodes(read_suite_runs(paths))


def test_drops_pair_episodes_of_one_task_and_seed(tmp_path):
    trained = write_run(tmp_path / "seen", {"T": [True] * 8 + [False] * 2, "U": [True] * 4}, suite=2, split="seen")
    unseen = write_run(tmp_path / "unseen", {"T": [True] * 3 + [False] * 7}, suite=2, split="unseen", first_seed=2)
    every, task = study_drops(episodes_of(trained, unseen), {})
    assert (every.task, task.task, task.paired) == (ALL_TASKS, "T", True)
    hits = np.array([1.0, 1, 1, 1, 1, 1, 0, 0]), np.array([1.0, 1, 1, 0, 0, 0, 0, 0])  # seeds 2 to 9
    expected = PairedShares(first=hits[0], second=hits[1])
    assert task.drop.mean == pytest.approx(expected.difference)
    assert (task.drop.low, task.drop.high) == pytest.approx(expected.interval())
    assert task.p == pytest.approx(expected.p_value)
    assert (task.drop.n, task.drop.total) == (8, 8)


def test_a_missing_outcome_never_lowers_the_bound_of_a_drop(tmp_path):
    outcomes = {"seen": [True, True, False, True], "unseen": [True, False, False, True]}

    def drop(split, index):
        runs = []
        for name, own in outcomes.items():
            own = [failed() if (name, k) == (split, index) else value for k, value in enumerate(own)]
            runs.append(write_run(tmp_path / f"{split}{index}" / name, {"T": own}, suite=2, split=name))
        return study_drops(episodes_of(*runs), {})[0].drop

    whole = drop("none", 0)
    assert whole.bound == pytest.approx(whole.mean)
    for split in outcomes:
        for index in range(4):
            lost = drop(split, index)
            assert (lost.n, lost.total) == (3, 4)
            assert lost.bound >= whole.bound - 1e-12


def test_samples_of_an_episode_count_as_one_pair(tmp_path):
    """As often as its samples succeed, and no more sure for having several equal ones."""
    mixed = [[True, False]] * 4 + [[False, False]] * 4
    runs = {
        (split, k): write_run(tmp_path / f"{split}{k}", {"T": own}, suite=2, split=split)
        for split, outcomes in (("seen", [True] * 5 + [False] * 3), ("unseen", [False] * 8))
        for k, own in ((1, outcomes), (2, [[value] * 2 for value in outcomes]))
    }
    once, twice = (study_drops(episodes_of(runs["seen", k], runs["unseen", k]), {}) for k in (1, 2))
    assert once == twice
    other = write_run(tmp_path / "mixed", {"T": mixed}, suite=2, split="unseen")
    every, task = study_drops(episodes_of(runs["seen", 2], other), {})
    assert (task.drop.n, task.drop.total) == (8, 8)
    assert task.drop.mean == pytest.approx(5 / 8 - 2 / 8)
    assert task.drop.low < task.drop.mean < task.drop.high
    assert every.drop == task.drop


def test_untrained_tasks_are_compared_with_the_trained_tasks_they_derive_from(tmp_path):
    derived = load_suite(1).transfers
    outcomes = {"CloseLaptopEasy-v1": [True] * 4, "PullCube-v1": [False] * 4}
    trained = write_run(tmp_path / "seen", outcomes, suite=1, split="seen")
    other = {"CloseLaptopHard-v1": [True, False, False, False]}
    unseen = write_run(tmp_path / "unseen", other, suite=1, split="unseen")
    (drop,) = study_drops(episodes_of(trained, unseen), derived)
    assert (drop.seen_tasks, drop.paired, drop.p) == (("CloseLaptopEasy-v1",), False, None)
    assert drop.drop.mean == pytest.approx(0.75)
    row = tabulate_drops([drop]).rows[0]
    assert row[:4] == ("Suite 1", "wan", "CloseLaptopHard-v1", "CloseLaptopEasy-v1")
    assert row[9] == "independent"


def test_the_report_of_runs_on_both_splits_has_their_drop_unless_their_settings_differ(tmp_path):
    trained = write_run(tmp_path / "seen", {"T": [True] * 3}, suite=2, split="seen")
    unseen = write_run(tmp_path / "unseen", {"T": [False] * 3}, suite=2, split="unseen")
    page = write_suite_report([trained, unseen], tmp_path / "report")
    assert {"seen_unseen.csv", "seen_unseen_suite2.svg"} <= {path.name for path in page.parent.iterdir()}
    change(unseen, config={"suite": 2, "split": "unseen", "rounds": 1, "control": "pd_joint_pos"})
    page = write_suite_report([trained, unseen], tmp_path / "other")
    assert not list(page.parent.glob("seen_unseen*"))
    assert "Drop of wan on suite 2: runs on both splits with the same rounds" in page.read_text()
