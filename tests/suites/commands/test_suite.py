"""`kinebench-drake suite`: what it prints, refuses and passes on."""

import json
from functools import partial

import pytest

from kinebench_drake.results.power import PowerDesign
from kinebench_drake.suites import demos as making
from kinebench_drake.suites import export as exporting
from kinebench_drake.suites.catalog import load_suite
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.demo_config import FormatKind, RenderOptions
from kinebench_drake.suites.demos import DemoSummary
from kinebench_drake.suites.families.registry import TASKS


@pytest.fixture
def suite(program):
    """Runs a command of `suite`; returns exit status, standard output and error."""
    return partial(program, "suite")


@pytest.fixture
def orders(monkeypatch):
    """What would have been made; nothing is."""
    taken = []

    def make(order, engine, observer):
        taken.append(order)
        return DemoSummary(demonstrations=3, failures=1, short={"StackCube-v1": 2} if order.episodes == 5 else {})

    def export(order, engine, observer):
        taken.append(order)
        return order.episodes * len(order.tasks)

    monkeypatch.setattr(making, "make_demos", make)
    monkeypatch.setattr(exporting, "export_suite", export)
    return taken


def test_list_prints_one_task_id_per_line(suite):
    code, out, _ = suite("list")
    assert code == 0
    assert out.splitlines() == list(TASKS)
    cards = json.loads(suite("list", "--json")[1])
    assert [card["prompt"] for card in cards] == [compose(name, 0).prompt for name in TASKS]
    assert [card["id"] for card in cards] == list(TASKS)


def test_task_options_accept_ids_with_the_environment_namespace(suite, orders, tmp_path):
    for names in ("StackCube-v1,PullCube-v1", "KineBench/PullCube-v1, KineBench/StackCube-v1"):
        code, out, _ = suite("export", "--suite", 0, "--tasks", names, "--episodes", 2, "--out", tmp_path)
        assert code == 0
        assert "4 episodes of 2 tasks" in out
        assert orders[-1].tasks == ("PullCube-v1", "StackCube-v1")


def test_export_defaults_to_the_evaluation_split_of_the_suite(suite, orders, tmp_path):
    suite("export", "--suite", 2, "--out", tmp_path)
    assert (orders[-1].split, orders[-1].size, orders[-1].episodes) == ("unseen", 384, 10)
    assert orders[-1].tasks == load_suite(2).tasks_of("unseen")


def test_demos_defaults_to_the_training_split_in_mp4_with_training_seeds(suite, orders, tmp_path):
    assert suite("demos", "--task", "StackCube-v1", "--episodes", 3, "--out", tmp_path)[0] == 0
    assert (orders[-1].suite.number, orders[-1].split, orders[-1].kind) == (0, "train", FormatKind.MP4)
    assert orders[-1].options == RenderOptions(size=384, frames=49, fps=17.0)
    assert orders[-1].attempts("StackCube-v1", 1)[0].seed >= 1_000_000


def test_demos_of_a_variant_cover_exactly_the_tasks_with_that_variant(suite, refusal, orders, tmp_path):
    suite("demos", "--variant", "obstacles", "--out", tmp_path)
    assert all("obstacles" in [v.value for v in TASKS[task].card.variants] for task in orders[-1].tasks)
    assert len(orders[-1].tasks) >= 2
    line = refusal("suite", "demos", "--variant", "obstacles", "--task", "CloseBox-v1", "--out", tmp_path)
    assert "CloseBox-v1 has no variant 'obstacles'" in line


def test_demos_exits_with_status_1_when_demonstrations_are_missing(suite, orders, tmp_path):
    code, out, err = suite("demos", "--task", "StackCube-v1", "--episodes", 5, "--out", tmp_path)
    assert code == 1
    assert "the expert failed with 1 other seed" in out
    assert "StackCube-v1: given up with 2 demonstrations missing" in err


def test_fps_of_a_lerobot_dataset_follows_the_number_of_frames(suite, orders, tmp_path):
    for frames, fps in ((49, 5.0), (97, 10.0), (193, 20.0)):
        suite("demos", "--format", "lerobot-v3", "--frames", frames, "--out", tmp_path)
        assert orders[-1].options.fps == fps


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("export", "--suite", 4), "--suite"),
        (("export", "--suite", 0, "--split", "seen"), "it has train, test"),
        (("export", "--suite", 1, "--tasks", "StackCube-v1"), "not in suite 1's split unseen"),
        (("demos", "--task", "Stack"), "no task 'Stack'"),
        (("demos", "--frames", 50), "33, 49"),
        (("demos", "--size", 131), "even"),
        (("demos", "--shard", "3/2"), "I/N"),
        (("demos", "--format", "lerobot-v3", "--fps", 17), "the task's time"),
        (("demos", "--format", "lerobot-v3", "--frames", 25), "--frames 49 (5 a second)"),
        (("demos", "--fps", "nan"), "--fps is nan"),
        (("export", "--suite", 1, "--variant", "obstacles"), "tasks that have it: "),
    ],
)
def test_unknown_suites_splits_tasks_and_frame_counts_are_usage_errors(refusal, orders, tmp_path, arguments, told):
    assert told in refusal("suite", *arguments, "--out", tmp_path)
    assert not orders


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ("check", "--variant", "obstacles", "--tasks", "PullCube-v1"),
            "PullCube-v1 has no variant 'obstacles'; tasks",
        ),
        (("check", "--split", "unseen"), "suite 0 has no split 'unseen'"),
        (("check", "--suite", 1, "--split", "train", "--tasks", "StoreCube-v2"), "not in suite 1's split train"),
    ],
)
def test_unusable_check_options_are_refused_before_any_trial(refusal, arguments, told):
    assert told in refusal("suite", *arguments)


def test_check_runs_the_expert_on_the_episodes_of_the_suite_split(suite, monkeypatch):
    from kinebench_drake.suites.catalog import load_suite

    checked = []
    monkeypatch.setattr(
        "kinebench_drake.suites.expert_check.run_trials",
        lambda executor, episodes: checked.extend(episodes) or (),
    )
    code, _, err = suite("check", "--suite", 2, "--split", "unseen", "--episodes", 2, "--seed", 3)
    assert code == 0, err
    assert [episode.id for episode in checked] == [e.id for e in load_suite(2).specs("unseen", 2, offset=3)]


def test_repeated_task_names_select_one_task():
    from kinebench_drake.suites.catalog import task_names

    assert task_names("PullCube-v1, KineBench/PullCube-v1") == ["PullCube-v1"]


@pytest.mark.sapien
def test_task_names_accept_the_registered_environment_ids():
    from kinebench_drake.suites.catalog import task_names
    from kinebench_drake.suites.scene.environment import environment_id

    assert task_names(",".join(environment_id(task) for task in TASKS)) == list(TASKS)


def test_plan_prints_one_line_of_episode_counts_per_number_of_samples(suite):
    code, out, _ = suite("plan", "--difference", "10", "--samples", "1,4", "--correlation", "0.3")
    assert code == 0
    episodes = [[int(cell) for cell in line.split()] for line in out.splitlines()[2:]]
    assert [line[0] for line in episodes] == [1, 4]
    for samples, paired, paired_clips, unpaired, unpaired_clips in episodes:
        design = PowerDesign(success=0.5, difference=0.1, samples=samples, correlation=0.3)
        assert (paired, unpaired) == (design.paired_episodes(), design.unpaired_episodes())
        assert (paired_clips, unpaired_clips) == (samples * paired, samples * unpaired)
    assert suite("plan", "--difference", "60")[0] == suite("plan", "--difference", "9", "--samples", "0,1")[0] == 2
