"""Rates, balanced means, correlation, scaling and comparison on rows with known results."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from kinebench_drake.report.number import ALL_TASKS
from kinebench_drake.results.row import Status
from kinebench_drake.stats import PairedShares
from kinebench_drake.suites.report.comparison import compare
from kinebench_drake.suites.report.correlation import standardise, study_correlation
from kinebench_drake.suites.report.episode_result import balanced_mean, list_models
from kinebench_drake.suites.report.kinematics import robust_normalize, scale_costs, tabulate_following
from kinebench_drake.suites.report.pooling import pool_episodes, read_suite_runs
from kinebench_drake.suites.report.scaling import (
    ALL_LEVELS,
    TrainingBudget,
    budget_of,
    study_scaling,
    task_difficulties,
    untagged,
)
from kinebench_drake.suites.report.success import tabulate_suites, tabulate_summary, tabulate_tasks, tally
from kinebench_drake.suites.report.suite_page import write_suite_report
from tests.suites.report.synthetic import change, failed, outcome, write_run


def episodes_of(*paths):
    return pool_episodes(read_suite_runs(paths))


def test_unmeasured_episodes_are_counted_and_lower_the_bound_alone(tmp_path):
    run = write_run(tmp_path / "a", {"T": [True, True, False, failed(), failed(Status.UNMEASURABLE)]})
    t = tally(episodes_of(run))
    assert (t.episodes, t.measured, t.errors, t.unmeasurable) == (5, 3, 1, 1)
    assert t.pooled.mean == pytest.approx(2 / 3)
    assert (t.pooled.low, t.pooled.high) == pytest.approx((0.2077, 0.9385), abs=1e-4)  # Wilson, 2 of 3
    assert t.counted.mean == pytest.approx(2 / 5)
    assert t.counted.n == 5
    assert t.verdicts == {"grounding": 0, "generation": 0, "execution": 0, "task": 1, "undecided": 0}


def test_a_row_without_success_is_unmeasurable(tmp_path):
    silent = outcome(False, extra={"progress": 0.5})
    unexplained = outcome(False, extra={"success": False, "progress": 0.0})
    t = tally(episodes_of(write_run(tmp_path / "a", {"T": [silent, unexplained]})))
    assert (t.measured, t.unmeasurable, t.verdicts["undecided"]) == (1, 1, 1)


def test_the_balanced_mean_weights_every_task_equally():
    result = balanced_mean({"A": [1.0] * 30, "B": [0.0, 1.0, None]})
    assert result.mean == pytest.approx(0.75)
    assert (result.n, result.total) == (32, 33)
    assert (result.low, result.high) == (0.5, 1.0)  # B alone varies: 0, 1/2 or 1
    assert balanced_mean({"A": [1.0] * 30, "B": [0.0]}).low is None  # nothing tells how B varies
    assert balanced_mean({"A": [0.5, 0.5]}).low is None
    assert balanced_mean({"A": [None]}).mean is None


def test_intervals_of_the_balanced_mean_cover_the_true_mean_in_95_percent():
    rng = np.random.default_rng(0)
    covered = 0
    for seed in range(200):
        groups = {f"{k}": rng.normal(k, 1.0, 15).tolist() for k in range(4)}
        result = balanced_mean(groups, seed=seed)
        covered += result.low <= 1.5 <= result.high
    assert 0.89 <= covered / 200 <= 0.98


def test_shards_are_pooled_and_tags_or_settings_separate_runs(tmp_path):
    one = write_run(tmp_path / "s1", {"T": [True] * 2})
    two = write_run(tmp_path / "s2", {"T": [False] * 2}, first_seed=2)
    assert list_models(episodes_of(one, two)) == ["wan"]
    change(two, tags={"data": "25"})
    assert list_models(episodes_of(one, two)) == ["wan", "wan (data=25)"]
    change(two, tags={}, config={"suite": 0, "split": "test", "rounds": 5, "control": "pd_joint_pos"})
    assert list_models(episodes_of(one, two)) == ["wan (rounds=3)", "wan (rounds=5)"]
    config = {"suite": 0, "split": "test", "rounds": 3, "control": "pd_joint_pos"}
    change(one, config={**config, "negative_prompt": ""})
    change(two, config={**config, "negative_prompt": "blur"})
    assert list_models(episodes_of(one, two)) == ["wan", "wan (negative_prompt=blur)"]
    for folder, end in ((one, "x"), (two, "y")):
        change(folder, config={**config, "negative_prompt": 200 * "blur, " + end})
    assert len({*list_models(episodes_of(one, two))}) == 2
    assert max(map(len, list_models(episodes_of(one, two)))) < 70
    other = write_run(tmp_path / "u", {"T": [True]}, suite=2, split="unseen", tags={"data": "25"})
    assert list_models(episodes_of(one, other)) == ["wan"]  # two parts need no distinction


def test_two_runs_of_the_same_episodes_are_labelled_by_their_folders(tmp_path):
    one, two = (write_run(tmp_path / name, {"T": [True]}) for name in ("first", "again"))
    assert list_models(episodes_of(one, two)) == ["wan [again]", "wan [first]"]


def test_numbers_in_model_names_are_sorted_by_value(tmp_path):
    runs = [write_run(tmp_path / n, {"T": [True]}, tags={"steps": n}) for n in ("15000", "7500")]
    assert list_models(episodes_of(*runs)) == ["wan (steps=7500)", "wan (steps=15000)"]


def test_superscript_digits_in_model_names_are_sorted_as_letters(tmp_path):
    runs = [write_run(tmp_path / n, {"T": [True]}, model="wan2²", tags={"steps": n}) for n in ("1²", "10", "9")]
    assert list_models(episodes_of(*runs)) == ["wan2² (steps=1²)", "wan2² (steps=9)", "wan2² (steps=10)"]


def test_the_best_model_of_each_suite_is_bold(runs):
    table = tabulate_suites(episodes_of(*runs))
    assert [c.label for c in table.columns] == ["Model", "Suite 0", "Suite 2 (unseen)", "Suite 3", "Executable"]
    best = {(table.rows[i][0], table.columns[k].label) for i, k in table.bold}
    assert best == {
        ("good", "Suite 0"),
        ("good", "Suite 2 (unseen)"),
        ("small (data=100, steps=15000)", "Suite 3"),
    }


def test_models_with_fewer_tasks_are_named_in_the_note_and_never_bold(tmp_path):
    one = write_run(tmp_path / "a", {"T": [True], "U": [False]}, model="all")
    two = write_run(tmp_path / "b", {"T": [True]}, model="half")
    third = write_run(tmp_path / "c", {"T": [False], "U": [False]}, model="none")
    table = tabulate_suites(episodes_of(one, two, third))
    assert "half did 1 of 2 tasks of Suite 0" in table.note
    assert [table.rows[i][0] for i, _ in table.bold] == ["all"]


def test_costs_are_scaled_between_percentiles_of_all_episodes(tmp_path):
    costs = np.linspace(5.0, 15.0, 11)
    run = write_run(tmp_path / "a", {"T": [outcome(True, cost=float(c)) for c in costs]})
    scaled = [e.cost_scaled for e in scale_costs(episodes_of(run))]
    np.testing.assert_allclose(scaled, np.clip((costs - 6.0) / 8.0, 0, 1))  # percentiles 10 and 90 are 6 and 14
    assert scale_costs(episodes_of(run)[:1])[0].cost_scaled is None


def test_the_robust_scale_maps_equal_values_to_one_half_and_keeps_gaps():
    values = np.arange(101.0)
    scaled = robust_normalize(values)
    np.testing.assert_allclose(scaled, np.clip((values - 10) / 80, 0, 1))
    np.testing.assert_allclose(robust_normalize(1e3 - 5 * values), 1 - scaled, atol=1e-12)
    np.testing.assert_array_equal(robust_normalize(np.array([1.0, np.nan, 3.0])), [0.0, np.nan, 1.0])
    np.testing.assert_array_equal(robust_normalize(np.array([2.0, 2.0])), [0.5, 0.5])


def test_success_is_standardised_within_tasks():
    z = standardise(np.array([[0.2, 0.5, np.nan], [0.6, 0.5, 1.0]]))
    np.testing.assert_allclose(z, [[-1, 0, np.nan], [1, 0, 0]])


def grid(tmp_path, sparc, hits):
    """Runs of models (rows) on tasks (columns) with these mean SPARC and successes of ten."""
    paths = []
    for m, (xs, ns) in enumerate(zip(sparc, hits, strict=True)):
        outcomes = {
            f"T{k}": [outcome(i < n, sparc=x) for i in range(10)] for k, (x, n) in enumerate(zip(xs, ns, strict=True))
        }
        paths.append(write_run(tmp_path / f"m{m}", outcomes, model=f"m{m}"))
    return episodes_of(*paths)


def test_rank_correlation_equals_spearmans(tmp_path):
    rng = np.random.default_rng(3)
    sparc = rng.uniform(-4, -1, (5, 6))
    hits = rng.integers(0, 11, (5, 6))
    study = study_correlation(grid(tmp_path, sparc.tolist(), hits.tolist()))
    z = (hits - hits.mean(axis=0)) / hits.std(axis=0)
    expected = spearmanr(sparc.mean(axis=1), z.mean(axis=1)).statistic
    rho, tasks = study.correlate()
    assert rho.mean == pytest.approx(expected)
    assert (rho.n, tasks) == (5, 6)
    assert -1 <= rho.low <= rho.mean <= rho.high <= 1
    assert study.correlate() == (rho, tasks)


def test_task_difficulty_does_not_affect_the_correlation(tmp_path):
    sparc = [[-3.0, -1.0], [-2.5, -0.5], [-2.0, 0.0]]
    rho, _ = study_correlation(grid(tmp_path, sparc, [[8, 1], [9, 2], [10, 3]])).correlate()
    assert (rho.mean, rho.low, rho.high) == (pytest.approx(1.0), None, None)  # all draws are equal: no interval


def test_a_task_without_the_metric_counts_with_the_worst_value(tmp_path):
    """A model does not leave the figure, nor get better, because a metric could not be measured in a whole task."""
    sparc = [[-3.0, -2.0], [-2.5, -1.5], [-2.0, -1.0]]
    whole = study_correlation(grid(tmp_path / "whole", sparc, [[1, 2], [3, 4], [5, 6]]))
    sparc[2][1] = None
    lost = study_correlation(grid(tmp_path / "lost", sparc, [[1, 2], [3, 4], [5, 6]]))
    assert [p.model for p in lost.points] == ["m0", "m1", "m2"]
    assert [p.metric for p in whole.points] == [-2.5, -2.0, -1.5]
    assert [p.metric for p in lost.points] == [-2.5, -2.0, (-2.0 - 3.0) / 2]


def test_two_points_have_no_correlation(tmp_path):
    rho, _ = study_correlation(grid(tmp_path, [[-1.0, -2.0], [-3.0, -2.0]], [[1, 2], [3, 4]])).correlate()
    assert (rho.mean, rho.n) == (None, 2)


def test_models_with_few_tasks_are_left_out_of_the_correlation(tmp_path):
    episodes = grid(tmp_path, [[-3.0] * 3, [-2.0] * 3, [-1.0] * 3], [[1] * 3, [2] * 3, [3] * 3])
    fewer = [e for e in episodes if e.model != "m2" or e.task == "T0"]
    assert [p.model for p in study_correlation(fewer).points] == ["m0", "m1"]


def test_success_is_tabulated_by_training_budget_and_difficulty(runs):
    folders = read_suite_runs(runs)
    (study,) = study_scaling(folders, pool_episodes(folders), task_difficulties())
    assert study.levels == ("easy", "medium", "hard", ALL_LEVELS)
    assert study.budgets == [TrainingBudget(data=d, steps=s) for d in (10, 100) for s in (1500, 15000)]
    assert study.success[TrainingBudget(data=10, steps=1500), "hard"].mean == pytest.approx(0.1)
    assert study.success[TrainingBudget(data=100, steps=15000), ALL_LEVELS].mean == pytest.approx(0.7)
    assert untagged(folders) == []


@pytest.mark.parametrize(
    ("data", "steps", "read"),
    [("25", "7.5k", TrainingBudget(data=25, steps=7500)), ("25", "many", None), ("0", "1", None)],
)
def test_training_budgets_are_read_from_tags(tmp_path, data, steps, read):
    run = write_run(tmp_path / "a", {"T": [True]}, suite=3, tags={"data": data, "steps": steps})
    folders = read_suite_runs([run])
    assert budget_of(folders[0]) == read
    assert [bare.path for bare in untagged(folders)] == ([] if read else [run])


def test_models_are_compared_on_shared_episodes(tmp_path):
    hits = {"one": [True, True, True, False, failed(), True], "two": [True, False, False, False, True]}
    paths = [write_run(tmp_path / m, {"T": h, "U": h}, model=m) for m, h in hits.items()]
    numbers = compare(episodes_of(*paths))
    whole, *tasks = (c for c in numbers if c.metric.name == "success")
    assert (whole.task, [c.task for c in tasks]) == (ALL_TASKS, ["T", "U"])
    assert (whole.shared, tasks[0].shared) == (10, 5)  # the sixth is the first model's alone
    assert (tasks[0].paired.n, tasks[0].paired.better) == (5, (2, 1))
    outcomes = PairedShares(first=np.array([1.0, 1, 1, 0]), second=np.array([1.0, 0, 0, 0]))
    difference = tasks[0].difference
    assert (difference.mean, (difference.low, difference.high), difference.n) == (0.5, outcomes.interval(), 4)
    assert [c.difference.mean for c in numbers if c.metric.name == "progress"] == [pytest.approx(0.5)]
    assert [c.adjusted_p for c in (whole, *tasks)] == [None, 1.0, 1.0]


def test_episodes_of_different_suites_are_not_paired(runs):
    numbers = compare(episodes_of(*runs[:4]))
    whole = [c for c in numbers if c.task == ALL_TASKS and c.metric.name == "success"]
    assert [(c.part, c.first, c.second) for c in whole] == [
        ("Suite 0", "good", "fair"),
        ("Suite 2 (unseen)", "good", "fair"),
    ]


def test_an_episode_is_compared_by_the_mean_of_its_samples(tmp_path):
    """An episode counts once, with the mean of its samples; a model may have fewer of them."""
    a = write_run(tmp_path / "a", {"T": [[True, True], [True, False], [False, failed()]]}, model="one")
    b = write_run(tmp_path / "b", {"T": [[False], [False], [False]]}, model="two")
    [whole] = (c for c in compare(episodes_of(a, b)) if c.metric.name == "success")
    assert (whole.shared, whole.paired.n, whole.paired.samples) == (3, 3, 2)
    assert whole.paired.first.tolist() == [1.0, 0.5, 0.0]
    assert whole.paired.rates == (0.5, 0.0)
    assert whole.paired.p_value == 0.5
    low, high = whole.paired.interval()
    assert low <= whole.paired.difference == 0.5 <= high


def test_tables_of_several_samples_show_pass_at_k(tmp_path):
    runs = [[True, False, False], [False] * 3, [True, True, False]]
    episodes = episodes_of(write_run(tmp_path / "a", {"T": runs}, model="one"))
    t = tally(episodes)
    assert t.success.mean == t.pooled.mean == pytest.approx(1 / 3)
    assert {k: round(share.mean, 3) for k, share in t.passes.items()} == {1: 0.333, 2: 0.556, 3: 0.667}
    assert (t.measured, t.passes[3].n) == (9, 3)
    page = write_suite_report([tmp_path / "a"], tmp_path / "report").read_text()
    assert "9 samples of 1 run" in page
    for tabulate in (tabulate_summary, tabulate_tasks):
        table = tabulate(episodes)
        place = [column.key for column in table.columns].index("pass_at_3")
        assert table.rows[0][place].mean == pytest.approx(2 / 3)
        assert "intervals are over episodes" in table.note
    single = tabulate_summary(episodes_of(write_run(tmp_path / "b", {"T": [True, False]})))
    assert not any(column.key.startswith("pass") for column in single.columns)
    assert "several samples" not in single.note


def test_following_is_tabulated_where_actions_were_requested(tmp_path):
    def obeying(error):
        metrics = {"action_error_m": error, "action_shuffled_m": 0.1, "action_following": 1 - error / 0.1}
        return outcome(True, metrics=metrics)

    a = write_run(tmp_path / "a", {"T": [obeying(0.002), obeying(0.004), failed()]}, model="one")
    b = write_run(tmp_path / "b", {"T": [True]}, model="two")
    table = tabulate_following(episodes_of(a, b))
    assert [row[1] for row in table.rows] == ["one"]
    assert [column.key for column in table.columns[3:5]] == ["action_error_mm", "action_shuffled_mm"]
    error, shuffled = table.rows[0][3:5]
    assert (error.mean, error.n) == (pytest.approx(3.0), 2)  # millimetres
    assert shuffled.mean == pytest.approx(100.0)
    assert tabulate_following(episodes_of(b)) is None
