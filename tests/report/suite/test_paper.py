"""The paper's tables and figures: orientation, pairing, what is missing, and the commands that make it."""

import json
import re
import shlex

import numpy as np
import pytest

from benchmarks.__main__ import main as benchmarks
from kinebench_drake.cli import cli, main
from kinebench_drake.errors import UsageError
from kinebench_drake.report.number import ALL_TASKS
from kinebench_drake.report.suite.extraction import read_measurements
from kinebench_drake.report.suite.paper import ROWS, make_sections, read_paper_data, tabulate_table1
from kinebench_drake.report.suite.pooling import pool_episodes, read_suite_runs
from kinebench_drake.report.suite.suite_page import PAPER_INDEX, PAPER_MISSING, missing_text, write_paper_report
from kinebench_drake.report.suite.transfer import study_drops, tabulate_drops
from kinebench_drake.report.table import table_latex
from kinebench_drake.results.row import Status
from kinebench_drake.stats import PairedShares
from kinebench_drake.suites.catalog import load_suite
from tests.report.pages import BROWSER, WIDTH, Page, probe
from tests.report.suite.synthetic import change, failed, outcome, write_run
from training.__main__ import main as training

TASKS = ("CloseBox-v1", "OpenBoxHard-v1", "StackCube-v1")
SPREAD = {"percentiles": [5, 25, 50, 75, 95]}


def episodes_of(*paths):
    return pool_episodes(read_suite_runs(paths))


def interval(value, width=0.2):
    return {"value": value, "low": value * (1 - width), "high": min(value * (1 + width), 1.0 if value <= 1 else 99.0)}


def study_json(name, conditions):
    """File of `python -m benchmarks perturb` or `depth-ablation`: group and error [mm] by condition."""
    rows, spreads = {}, {}
    for condition, (group, error) in conditions.items():
        spread = [error * f for f in (0.2, 0.6, 1.0, 1.6, 3.0)]
        rows[condition] = {
            "tracked_when_seen": interval(0.9),
            **{f"position_{end}_mm": interval(error * f) for end, f in (("median", 1.0), ("p95", 3.0))},
            **{f"rotation_{end}_deg": interval(error * f / 3) for end, f in (("median", 1.0), ("p95", 3.0))},
        }
        degrees = [v / 3 for v in spread]
        spreads[condition] = {"group": group, "frames": 98, **SPREAD, "position_mm": spread, "rotation_deg": degrees}
    return {"study": name, "title": "t", "videos": ["a", "b"], "conditions": rows, "distributions": spreads}


def baseline_json(tasks):
    def group(name, pooled):
        sizes = {"baseline": 80.0, "baseline where tracked": 75.0, "grounding": 3.0}
        return {
            **{"group": name, "trained": False, "pooled": pooled, "videos": 2, "tracked_fraction": 0.97},
            "errors": {
                method: {
                    f"{quantity}_{end}": [size * f, size * f * 0.8, size * f * 1.2]
                    for quantity in ("position", "rotation", "finger")
                    for end, f in (("median", 1.0), ("p95", 4.0))
                }
                for method, size in sizes.items()
            },
            "video_medians": {
                method: {q: [size * 0.9, None if pooled else size * 1.1] for q in ("position", "rotation", "finger")}
                for method, size in sizes.items()
            },
        }

    return [*(group(task, False) for task in tasks), group("unseen tasks", True)]


@pytest.fixture
def measurements(tmp_path):
    """Files of all studies of the grounding."""
    depth = study_json(
        "depth-ablation",
        {"true depth": ("true depth", 0.3), "our estimate": ("our estimate", 2.6), "scale 10%": ("scale", 6.0)},
    )
    ramp = [[None, 0.01, 0.02], [0.02, 0.01, 0.03]]
    maps = {
        side: {"axes": axes, "bounds_mm": [-60, 60, -30, 130], "mean": ramp[::turn]}
        for side, axes, turn in (("front", "yz", 1), ("side", "xz", -1))
    }
    depth["relative_depth_error"] = {"median": 0.012, "p95": 0.05, "maps": maps}
    perturbed = {"as it is": ("", 2.0), "noise 10": ("noise", 3.0), "noise 30": ("noise", 9.0)}
    perturbed |= {f"{name}, learned": ("learned", 30 * error) for name, (_, error) in perturbed.items()}
    robustness = study_json("robustness", perturbed)
    (tmp_path / "comparison").mkdir()
    files = {
        tmp_path / "comparison" / "baseline.json": baseline_json(["CloseFaucet-v1", "OpenBoxEasy-v2"]),
        tmp_path / "depth.json": depth,
        tmp_path / "robustness.json": robustness,
    }
    for path, content in files.items():
        path.write_text(json.dumps(content))
    return [tmp_path / "comparison", tmp_path / "depth.json", tmp_path / "robustness.json"]


def names_of(sections):
    return [part.name for _, parts in sections for part in parts if hasattr(part, "name")]


def commands_of(sections):
    return [line.strip() for line in missing_text(sections).splitlines() if line.startswith("    ")]


def hits(n, total=10, **changes):
    return [outcome(k < n, sparc=-2.0 - 0.1 * k, cost=6.0 + 0.3 * k, **changes) for k in range(total)]


@pytest.fixture
def complete(tmp_path):
    """Runs of three models on all parts of the paper, and of a scaling study."""
    root, folders = tmp_path / "runs", []
    derived = {t.task: t.of for t in load_suite(1).transfers}
    unseen = ("CloseLaptopHard-v1", "OpenBoxEasy-v2")
    trained = sorted({of for task in unseen for of in derived[task]})
    for m, model in enumerate(("wan", "cogvideo", "lora")):
        for suite, split, tasks in (
            *((0, "test", TASKS), (2, "seen", TASKS), (2, "unseen", TASKS)),
            *((1, "seen", trained), (1, "unseen", unseen)),
        ):
            harder = 2 * (split == "unseen")
            outcomes = {t: hits(max(9 - 2 * m - k - harder, 0)) for k, t in enumerate(tasks)}
            outcomes = {
                t: [{**o, "metrics": {**o["metrics"], "sparc": o["metrics"]["sparc"] - 0.4 * m - 0.1 * harder,
                                      "manipulability_cost_mean": o["metrics"]["manipulability_cost_mean"] + m}}
                    for o in own]
                for t, own in outcomes.items()
            }  # fmt: skip
            outcomes[tasks[0]][9] = failed(Status.UNMEASURABLE)
            folders.append(write_run(root / f"{model}{suite}{split}", outcomes, model=model, suite=suite, split=split))
    for data, steps in ((100, 1500), (100, 4500), (100, 7500), (100, 15000), (10, 7500), (25, 7500), (50, 7500)):
        outcomes = {task: hits(min(9, 3 + k + steps // 3000)) for k, task in enumerate(TASKS)}
        tags = {"data": str(data), "steps": str(steps)}
        folders.append(write_run(root / f"s{data}_{steps}", outcomes, model="small", suite=3, tags=tags))
    return folders


def test_with_all_data_only_tasks_that_a_model_did_not_run_are_missing(complete, measurements, tmp_path):
    page = write_paper_report([*complete, *measurements], tmp_path / "paper")
    text, names = page.read_text(), {path.name for path in page.parent.iterdir()}
    assert page.name == PAPER_INDEX
    others = "needs the tasks of the suite that a model did not run; SPEC is the model's own"
    lines = [line for line in (page.parent / PAPER_MISSING).read_text().splitlines() if "needs" in line]
    assert len(lines) == 4  # each row of Table 1 but suite 3
    assert all(others in line for line in lines)
    parsed = Page(text)
    assert parsed.open == []
    assert len(parsed.ids) == len(set(parsed.ids))
    assert not re.search(r"https?://|@import", text)
    assert str(tmp_path) not in text
    assert all(link[1:] in parsed.ids for link in parsed.links if link.startswith("#"))
    figures = (
        *("figure4a_trajectories", "figure4b_perturbations", "figure5a_depth_quality", "figure5b_depth_error"),
        *("figure6_sparc_success", "figure7_manipulability", "manipulability_success", "scaling_curves"),
        *("seen_unseen_suite1", "seen_unseen_suite2"),
    )
    tables = (
        *("table1_success", "table1_executable", "extraction", "seen_unseen", "scaling"),
        *("sparc_correlation", "manipulability_cost_correlation"),
    )
    assert names == {
        *(f"{name}.{kind}" for name in figures for kind in ("png", "svg")),
        *(f"{name}.{kind}" for name in tables for kind in ("csv", "tex")),
        *("episodes.csv", PAPER_INDEX, PAPER_MISSING),
    }


def test_table_1_has_suites_as_rows_and_scaling_runs_as_its_last_columns(complete):
    folders = read_suite_runs(complete)
    table, executable = tabulate_table1(folders, pool_episodes(folders))
    assert [row[0] for row in table.rows] == [*ROWS.values(), "Suite 1 (seen)"]
    assert [c.label for c in table.columns[3:6]] == ["wan", "cogvideo", "lora"]
    assert [c.group for c in table.columns[3:]] == ["Main model comparison"] * 3 + ["Scaling configurations"] * 7
    assert table.rows[0][1:3] == ("3 of 20", "30")
    assert table.rows[1][1:3] == ("2 of 7", "20")
    assert [row[0] for row in executable.rows] == [row[0] for row in table.rows]
    cells = {(row[0], c.label): v for row in table.rows for c, v in zip(table.columns, row, strict=True)}
    assert cells["Suite 0", "wan"].mean == pytest.approx((9 / 9 + 8 / 10 + 7 / 10) / 3)
    assert (cells["Suite 0", "wan"].n, cells["Suite 0", "wan"].total) == (29, 30)
    assert cells["Suite 0", "wan"].bound == pytest.approx((9 / 10 + 8 / 10 + 7 / 10) / 3)
    assert cells["Suite 3", "wan"] is None
    assert cells["Suite 0", "small (data=100, steps=1500)"] is None
    assert {table.columns[k].label for i, k in table.bold if table.rows[i][0] == "Suite 2 (unseen)"} == {"wan"}
    latex = table_latex(table)
    heads = next(line for line in latex.splitlines() if "multicolumn" in line)
    assert heads.split("&") == [
        *("    ", " ", "  ", r" \multicolumn{3}{c}{Main model comparison} "),
        r" \multicolumn{7}{c}{Scaling configurations} \\",
    ]
    assert r"\cmidrule(lr){4-6} \cmidrule(lr){7-13}" in latex
    assert "29 of 30, bound 80.0\\%" in latex
    assert latex.count(r"\resizebox{\textwidth}{!}{%") == 1


def test_unmeasurable_episodes_never_make_a_model_the_best(tmp_path):
    """All successes of the few measured episodes, and the rest unmeasurable: the bound decides."""
    lucky = write_run(tmp_path / "a", {"T": [True] * 2 + [failed(Status.UNMEASURABLE)] * 8}, model="lucky")
    steady = write_run(tmp_path / "b", {"T": [True] * 6 + [False] * 4}, model="steady")
    folders = read_suite_runs([lucky, steady])
    table, _ = tabulate_table1(folders, pool_episodes(folders))
    assert {table.columns[k].label for _, k in table.bold} == {"steady"}


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
    """In drops and in Table 1: as often as its samples succeed, and no more sure for having several equal ones."""
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
    folders = read_suite_runs([runs["seen", 2]])
    (row,) = (r for r in tabulate_table1(folders, pool_episodes(folders))[0].rows if r[0] == "Suite 2 (seen)")
    assert (row[2], row[3].mean, row[3].total) == ("8", 5 / 8, 16)


def test_untrained_tasks_are_compared_with_the_trained_tasks_they_derive_from(tmp_path):
    derived = {t.task: t.of for t in load_suite(1).transfers}
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


def test_runs_of_different_settings_have_no_drop(tmp_path):
    trained = write_run(tmp_path / "seen", {"T": [True] * 3}, suite=2, split="seen")
    unseen = write_run(tmp_path / "unseen", {"T": [False] * 3}, suite=2, split="unseen")
    change(unseen, config={"suite": 2, "split": "unseen", "rounds": 1, "control": "pd_joint_pos"})
    data = read_paper_data([trained, unseen])
    sections = make_sections(data)
    assert "seen_unseen" not in names_of(sections)
    assert "Drop of wan on suite 2: needs runs on both splits with the same rounds" in missing_text(sections)
    assert data.warnings == [
        "runs of wan differ in rounds (3 in seen, 1 in unseen): its numbers on them are not comparable"
    ]


PROGRAMS = {"kinebench-drake": cli, "python -m benchmarks": benchmarks, "python -m training": training}


def test_commands_for_missing_data_are_accepted_by_the_program(tmp_path, monkeypatch):
    """Every option is one of the program, and its values are accepted; paths need not exist."""
    import click

    monkeypatch.setattr(click.Path, "convert", lambda self, value, param, ctx: value)
    run = write_run(tmp_path / "one", {"PullCube-v1": [True, False]}, suite=2, split="seen", model="my model")
    bare = write_run(tmp_path / "bare", {"PullCube-v1": [True]}, suite=3)
    config = {"suite": 2, "split": "seen", "rounds": 1, "control": "pd_ee_pose", "pixels_only": True}
    config |= {"samples_per_episode": 4, "condition": "actions"}
    change(run, config={**config, "tasks": ["PullCube-v1"], "episodes_per_task": 2, "negative_prompt": "a 'b'"})
    for inputs in ([run], [run, bare]):
        commands = commands_of(make_sections(read_paper_data(inputs)))
        assert len(commands) > 10
        for command in commands:
            program = next(name for name in PROGRAMS if command.startswith(name))
            group, arguments = PROGRAMS[program], shlex.split(command.removeprefix(program))
            while isinstance(group, click.Group):
                group = group.get_command(click.Context(group), arguments.pop(0))
            group.make_context(group.name, arguments)
    other = next(c for c in commands if "suite run --suite 2" in c and "--split unseen" in c)
    for option in (
        "--tasks PullCube-v1",
        "--episodes 2",
        "--rounds 1",
        "--control pd_ee_pose",
        "--pixels-only",
        "--samples 4",
        "--condition actions",
    ):
        assert option in other
    assert "--model 'my model'" in other
    assert """--negative-prompt 'a '"'"'b'"'"''""" in other


def test_a_world_model_spec_is_named_only_if_its_hash_matches(tmp_path):
    import hashlib

    digest = hashlib.sha256(b"oracle").hexdigest()
    run = write_run(tmp_path / "one", {"PullCube-v1": [True]}, model="oracle", spec=digest)
    for name, spec in (("oracle", "--world-model oracle"), ("random", "--world-model SPEC")):
        change(run, config={"suite": 0, "split": "test", "world_model": name, "world_model_sha256": digest})
        assert any(spec in command for command in commands_of(make_sections(read_paper_data([run]))))


def test_measurement_files_without_runs_make_their_figures(measurements):
    sections = make_sections(read_paper_data(measurements))
    assert {"extraction", "figure4a_trajectories", "figure5b_depth_error"} <= {*names_of(sections)}
    assert "table1_success" not in names_of(sections)
    assert "Table 1, row Suite 0" in missing_text(sections)
    assert "Extraction" not in missing_text(sections)
    partly = missing_text(make_sections(read_paper_data(measurements[1:])))
    assert "inverse dynamics, other rows: needs comparison/ among the arguments" in partly
    (table,) = (part for _, parts in sections for part in parts if getattr(part, "name", None) == "extraction")
    assert [row[0] for row in table.rows] == [
        *("grounding, true depth", "grounding, estimated depth"),
        *("grounding", "learned inverse dynamics"),
    ]
    assert table.rows[2][3].mean == 0.97


@pytest.mark.parametrize("content", ["{", "[]x", '{"title": 1}', '[{"group": "T"}]', '{"distributions": {}}'])
def test_other_files_are_refused_in_one_line(tmp_path, content, capsys):
    file = tmp_path / "file.json"
    file.write_text(content)
    with pytest.raises(SystemExit) as stop:
        main(["suite", "report", "--paper", str(file), "--out", str(tmp_path / "paper")])
    assert stop.value.code == 2
    assert "cannot be read; expected a file of" in (message := capsys.readouterr().err)
    assert message.count("\n") == 1


def test_two_files_of_one_study_are_refused(measurements, tmp_path):
    with pytest.raises(UsageError, match="second file"):
        read_measurements([measurements[1], measurements[1]])


def test_the_same_arguments_give_the_same_bytes(complete, tmp_path):
    contents = []
    for _ in range(2):
        page = write_paper_report([complete[0]], tmp_path / "paper")
        contents.append({path.name: path.read_bytes() for path in page.parent.iterdir()})
    assert contents[0] == contents[1]


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
def test_the_page_fits_its_window(complete, measurements, tmp_path):
    script = """<script>addEventListener("load", () => {
      const room = document.documentElement.clientWidth;
      const wide = [...document.querySelectorAll("main > *")].filter(p => p.getBoundingClientRect().right > room);
      const state = {errors: window.troubles, overflow: document.documentElement.scrollWidth - room, wide: wide.length};
      document.documentElement.setAttribute("data-state", JSON.stringify(state));
    });</script>"""
    page = write_paper_report([complete[0], *measurements], tmp_path / "paper")
    for width in (WIDTH, 1400):
        state = probe(page, script, tmp_path / "profile", width)
        assert (state["errors"], state["overflow"], state["wide"]) == ([], 0, 0), width
