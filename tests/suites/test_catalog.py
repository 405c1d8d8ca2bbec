"""Suites: tasks, splits, seeds and pools of assets."""

from collections import Counter

import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.catalog import NUMBERS, Suite, load_suite
from kinebench_drake.suites.composition import KINDS, Episode, Pool, asset_ids, pool_ids
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.scene.look import SORTS, look_ids


def suites() -> list[Suite]:
    return [load_suite(number) for number in NUMBERS]


def drawn(episode: Episode) -> set[str]:
    return {*episode.assets.values(), episode.table, episode.background, episode.light}


@pytest.mark.parametrize("suite", suites(), ids=lambda suite: f"suite {suite.number}")
def test_suites_name_existing_tasks_without_repetition(suite: Suite) -> None:
    for name in suite.splits:
        tasks = suite.tasks_of(name)
        assert set(tasks) <= set(TASKS)
        assert max(Counter(tasks).values()) == 1


@pytest.mark.parametrize("suite", suites(), ids=lambda suite: f"suite {suite.number}")
def test_training_and_evaluation_share_no_seed(suite: Suite) -> None:
    first, end = suite.splits["train"].seeds
    for name, split in suite.splits.items():
        if name != "train":
            assert split.seeds[1] <= first or split.seeds[0] >= end
    assert suite.evaluated in suite.splits
    assert suite.evaluated != "train"


def test_suite_0_draws_all_tasks_alike_for_training_and_test() -> None:
    suite = load_suite(0)
    assert set(suite.tasks_of("train")) == set(suite.tasks_of("test")) == set(TASKS)
    assert suite.splits["train"].pool is suite.splits["test"].pool is Pool.ALL


def test_suite_1_evaluates_seven_tasks_outside_the_ten_trained_ones() -> None:
    suite = load_suite(1)
    trained = suite.tasks_of("train")
    unseen = suite.tasks_of("unseen")
    assert (len(trained), len(unseen)) == (10, 7)
    assert not set(trained) & set(unseen)
    assert {"CloseBox-v1", "OpenBoxEasy-v1", "CloseLaptopEasy-v1"} <= set(trained)
    assert {"OpenBoxEasy-v2", "CloseLaptopHard-v1"} <= set(unseen)
    assert list(suite.transfers) == list(unseen)
    assert all(origins and {*origins} <= {*trained} for origins in suite.transfers.values())


def test_suite_2_splits_assets_and_looks_into_disjoint_halves() -> None:
    for ids in (
        *({pool: pool_ids(asset_ids(kind), pool) for pool in Pool} for kind in KINDS),
        *({pool: pool_ids(look_ids(sort), pool) for pool in Pool} for sort in SORTS),
    ):
        assert not set(ids[Pool.SEEN]) & set(ids[Pool.UNSEEN])
        assert sorted((*ids[Pool.SEEN], *ids[Pool.UNSEEN])) == sorted(ids[Pool.ALL])
        assert len(ids[Pool.SEEN]) == len(ids[Pool.UNSEEN])


def test_episodes_of_suite_2_use_only_assets_of_their_half() -> None:
    suite = load_suite(2)
    tasks = ("PullCube-v1", "StackCube-v1")
    shown = {name: [drawn(s.episode()) for s in suite.specs(name, 8, tasks=tasks)] for name in suite.splits}
    assert not set().union(*shown["train"], *shown["seen"]) & set().union(*shown["unseen"])


def test_suite_3_has_the_episodes_of_suite_0() -> None:
    suite = load_suite(3)
    zero = load_suite(0)
    assert suite.splits == zero.splits
    assert suite.tasks == zero.tasks


def test_a_longer_list_of_episodes_begins_with_the_shorter_one() -> None:
    suite = load_suite(0)
    tasks = ("StackCube-v1",)
    more = suite.specs("test", 5, tasks=tasks)
    assert suite.specs("test", 2, tasks=tasks) == more[:2]
    assert suite.specs("test", 2, tasks=tasks, offset=3) == more[3:]
    assert [episode.seed for episode in more] == list(range(5))


def test_the_split_test_is_an_alias_of_the_evaluated_split() -> None:
    assert [load_suite(number).split_name("test") for number in NUMBERS] == ["test", "unseen", "unseen", "test"]
    assert load_suite(1).split_name(None) == "unseen"


def test_unknown_splits_tasks_seeds_and_suites_are_usage_errors() -> None:
    suite = load_suite(1)
    with pytest.raises(UsageError, match="it has train, seen, unseen"):
        suite.split_name("validation")
    with pytest.raises(UsageError, match="OpenBoxEasy-v2"):
        suite.tasks_of("unseen", ["StackCube-v1"])
    with pytest.raises(UsageError, match="no task 'Stack'"):
        suite.tasks_of("unseen", ["Stack"])
    with pytest.raises(UsageError, match="1000000 seeds"):
        suite.specs("unseen", 2, offset=999_999)
    with pytest.raises(UsageError, match="0, 1, 2, 3"):
        load_suite(4)
