"""Reports of suite runs as files: complete, escaped, repeatable; and refused inputs."""

import csv
import io
import re

import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.report import page_parts
from kinebench_drake.report.table import Column, Table, escape_latex, table_csv, table_latex, table_lines
from kinebench_drake.results.aggregate import Estimate
from kinebench_drake.suites.report.comparison import read_comparison
from kinebench_drake.suites.report.pooling import pool_episodes, read_suite_runs, spec_warnings
from kinebench_drake.suites.report.suite_page import write_page, write_suite_report
from tests.report.pages import BROWSER, WIDTH, Page, probe
from tests.suites.report.synthetic import EVIL, change, outcome, write_run

SIDEWAYS = """
<script>
addEventListener("load", () => {
  const all = query => [...document.querySelectorAll(query)], room = document.documentElement.clientWidth;
  const boxes = all(".scroll"), wide = boxes.filter(box => box.scrollWidth > box.clientWidth + 1);
  const faded = () => wide.filter(box => box.matches(".more-right")).length;
  const state = {errors: window.troubles, boxes: boxes.length, wide: wide.length, fadedAtStart: faded()};
  state.hints = all(".hint:not([hidden]) + style + .scroll").length;
  for (const box of wide) { box.scrollLeft = box.scrollWidth; box.dispatchEvent(new Event("scroll")); }
  state.fadedAtEnd = faded();
  const table = document.getElementById("table-summary"), model = table.tHead.rows[0].cells[1];
  const left = model.getBoundingClientRect().left - table.closest(".scroll").getBoundingClientRect().left;
  state.pinned = left >= 0 && left < 120;
  state.captions = all("figcaption, .note").filter(part => part.getBoundingClientRect().right > room).length;
  state.drawings = all("figure svg").filter(drawing => !drawing.closest(".scroll")).length;
  state.overflow = document.documentElement.scrollWidth - room;
  document.documentElement.setAttribute("data-state", JSON.stringify(state));
});
</script>
"""


@pytest.fixture
def table():
    value = Estimate(mean=0.1234567890123, low=0.1, high=0.2, n=7, total=9)
    return Table(
        name="t_1",
        title="A & B",
        note="50 % _of_ it",
        columns=(
            Column(key="who", label="Who"),
            Column(key="n", label="N"),
            Column(key="rate", label="Rate", pattern="{:.1%}", estimated=True),
        ),
        rows=((EVIL, 3, value), ('a,"b"', None, None)),
        bold=frozenset({(0, 2)}),
    )


def test_csv_has_numbers_at_full_precision(table):
    first, second = csv.DictReader(io.StringIO(table_csv(table)))
    assert first == {
        **{"who": EVIL, "n": "3", "rate": "0.1234567890123", "rate_low": "0.1", "rate_high": "0.2", "rate_n": "7"},
        "rate_bound": "",
    }
    assert second == {
        "who": 'a,"b"',
        **dict.fromkeys(("n", "rate", "rate_low", "rate_high", "rate_n", "rate_bound"), ""),
    }


def test_latex_is_escaped_and_every_row_has_all_columns(table):
    text = table_latex(table)
    body = text[text.index(r"\midrule") : text.index(r"\bottomrule")].splitlines()[1:]
    rows = [line for line in body if line.strip()]
    assert all(len(re.findall(r"(?<!\\)&", row)) == 2 and row.endswith(r"\\") for row in rows)
    assert r"\textbf{12.3\%} {\scriptsize (10.0\% to 20.0\%)}" in rows[0]
    assert r"\begin{tabular}{lrr}" in text
    assert escape_latex("a_b\\c{$}") == r"a\_b\textbackslash{}c\{\$\}"
    depth = 0
    for brace in re.findall(r"(?<!\\)[{}]", text):
        depth += 1 if brace == "{" else -1
        assert depth >= 0
    assert depth == 0


def test_printed_columns_are_aligned(table):
    printed = list(table_lines(table))
    assert printed[0].startswith("Who")
    assert printed[1].endswith("12.3% [10.0% to 20.0%]")


def test_a_row_with_too_few_cells_is_refused(table):
    with pytest.raises(ValueError, match="1 cells under 3 columns"):
        Table(name="t", title="", note="", columns=table.columns, rows=(("x",),))


def test_a_suite_report_is_self_contained_with_all_tables_and_figures(runs, tmp_path):
    out = tmp_path / "runs" / "report"
    text = write_suite_report(runs, out).read_text()
    page = Page(text)
    assert page.open == []
    assert page.scripts == 1
    assert len(page.ids) == len(set(page.ids))
    assert not re.search(r"https?://|@import", text)
    assert str(tmp_path) not in text
    assert EVIL not in text
    assert "&lt;script&gt;" in text
    outside = [link for link in page.links if not link.startswith("#")]
    assert outside[0].startswith("../good0/")
    assert "../good0/rollouts/CloseBox-v1_s0000.mp4" in outside
    assert "../good0/report.html#CloseBox-v1_s0000" in outside
    assert all((out / link.split("#")[0]).is_file() for link in outside)
    assert {link[1:] for link in page.links if link.startswith("#")} <= {*page.ids}
    names = {path.name for path in out.iterdir()}
    figures = ("success_suite0", "success_suite2_unseen", "success_suite3", "verdicts", "sparc_success")
    for figure in (*figures, "manipulability", "scaling_curves"):
        assert {f"{figure}.png", f"{figure}.svg"} <= names
    for name in ("suites", "summary", "kinematics", "sparc_correlation", "scaling"):
        assert {f"{name}.csv", f"{name}.tex"} <= names
    assert {"tasks.csv", "episodes.csv"} <= names
    assert "Not shown" not in text
    assert "A dash: no measured episode." in text
    light, dark = (set(re.findall(r"(--\w+):", b)) for b in re.findall(r":root \{(.*?)\}", text, re.DOTALL)[:2])
    assert light == dark
    assert {v[4:-1] for v in re.findall(r"var\(--\w+\)", text)} <= {
        *light,
        "--v",
    }  # the colour of a verdict, by its class
    with (out / "episodes.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 300


def test_the_paper_has_the_tables_by_suite_and_model_alone(runs, tmp_path):
    write_suite_report(runs, tmp_path / "runs" / "paper", paper=True)
    names = {path.name for path in (tmp_path / "runs" / "paper").iterdir()}
    assert {"suites.csv", "kinematics.csv", "sparc_success.png", "manipulability.png", "scaling.csv"} <= names
    assert not {"tasks.csv", "summary.csv", "verdicts.png", "success_suite0.png"} & names


def test_a_shortened_episode_list_has_all_models_with_failures_first(runs, tmp_path, monkeypatch):
    monkeypatch.setattr(page_parts, "LISTED", 100)
    folders = read_suite_runs(runs)
    text = write_page("t", folders, pool_episodes(folders), tmp_path, parts=()).read_text()
    outcomes = re.findall(r'<td class="o-(\w+)"', text)
    assert len(outcomes) == 100
    assert outcomes == sorted(outcomes, key=lambda o: o == "success")
    listed = text[text.index('id="list"') :]
    assert all(f'data-key="{model}"' in listed for model in ("good", "fair", "poor", "small (data=10, steps=1500)"))
    assert "100 of 300 are listed" in text


def test_sections_without_data_are_listed_with_what_they_need(tmp_path):
    run = write_run(tmp_path / "a" / "b" / "one", {"T": [True, False]}, suite=3, tags={"data": "10"})
    (run / "report.html").write_text("page")
    file = write_suite_report([run], tmp_path / "report")
    text = file.read_text()
    names = {path.name for path in file.parent.iterdir()}
    missing = text[text.index("Not shown") : text.index('id="episodes"')]
    assert "Rank correlation" in missing
    assert "--tag steps=N" in missing
    assert "scaling.csv" not in names
    before = {path.name: path.read_bytes() for path in file.parent.iterdir()}
    write_suite_report([run], tmp_path / "report")
    assert {path.name: path.read_bytes() for path in file.parent.iterdir()} == before


@pytest.mark.parametrize("crowd", [2, 12])
def test_dollar_signs_in_names_are_not_parsed_as_mathematics(tmp_path, crowd):
    names = [rf"lr$\a${n}" for n in range(crowd)]
    tasks = {rf"T$\b${k}": [outcome(True, cost=6.0 + k), outcome(False, sparc=-3.0)] for k in range(2)}
    runs = [write_run(tmp_path / f"{k}", tasks, model=name) for k, name in enumerate(names)]
    assert write_suite_report(runs, tmp_path / "report").is_file()
    assert read_comparison(runs[:2]).write(tmp_path / "comparison").is_file()


@pytest.mark.filterwarnings("error")
def test_figures_have_room_for_long_names(tmp_path):
    """Without room for its labels matplotlib would warn, and cut them."""
    names = [f"command:python /srv/models/a-rather-long-name/serve.py checkpoint=step_{k:07d}" for k in range(3)]
    tasks = {"CloseLaptopEasy-v1": [True, False], "StoreFruitsBox-v1": [outcome(True, sparc=-3.0), False]}
    runs = [write_run(tmp_path / f"{k}", tasks, model=name) for k, name in enumerate(names)]
    assert write_suite_report(runs, tmp_path / "report").is_file()
    assert read_comparison(runs).write(tmp_path / "comparison").is_file()


def test_runs_outside_the_parent_folder_are_not_linked(tmp_path):
    run = write_run(tmp_path / "far" / "one", {"T": [True]})
    (run / "report.html").write_text("page")
    text = write_comparison_page(tmp_path, run)
    assert "href" not in text.replace('href="#', "")


def write_comparison_page(tmp_path, run):
    other = write_run(tmp_path / "far" / "two", {"T": [False]}, model="two")
    return read_comparison([run, other]).write(tmp_path / "near" / "out").read_text()


def test_a_comparison_is_printed_and_written(runs, tmp_path, program):
    out = tmp_path / "comparison"
    code, printed, _ = program("compare", runs[0], runs[2], "--out", out)
    assert code == 0
    assert printed.startswith("good is better than fair: success 70% (at most 77%) against 40% (at most 47%) of 30 ")
    assert "\nTask " in printed
    assert {p.name for p in out.iterdir()} >= {"report.html", "numbers.csv", "numbers.tex"}
    page = (out / "report.html").read_text()
    assert Page(page).open == []
    assert printed.splitlines()[0] in page
    with (out / "numbers.csv").open() as file:
        whole, *tasks = (row for row in csv.DictReader(file) if row["metric"] == "success")
    assert (whole["task"], whole["shared"], whole["complete"], len(tasks)) == ("all tasks", "30", "28", 3)
    assert float(whole["difference"]) == pytest.approx(9 / 28)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema_version": 2}, "schema_version 1 and .* 2"),
        ({"suite_version": "1.1"}, "suite_version None and .* 1.1"),
        ({"kind": "score"}, "of kind 'score', expected 'suite'"),
        ({"config": {}}, "names no suite"),
        ({"config": {"suite": 1, "split": "test"}}, "share an episode"),
    ],
)
def test_incomparable_folders_are_refused_with_the_difference(tmp_path, changes, message):
    one = write_run(tmp_path / "one", {"T": [True]}, model="one")
    two = write_run(tmp_path / "two", {"T": [True]}, model="two")
    change(two, **changes)
    with pytest.raises(UsageError, match=message) as error:
        read_comparison([one, two])
    assert "\n" not in str(error.value)


def test_unfinished_repeated_or_foreign_folders_are_refused(tmp_path):
    run = write_run(tmp_path / "run", {"T": [True]})
    unfinished = write_run(tmp_path / "unfinished", {"T": [True]})
    (unfinished / "results.json").unlink()
    same = write_run(tmp_path / "other" / "run", {"T": [True]})
    for paths, out, message in (
        ([run], run, "whose own report"),
        ([run, run], tmp_path / "x", "named twice"),
        ([run, same], tmp_path / "x", "--tag"),
        ([unfinished], tmp_path / "x", "again to finish it"),
        ([tmp_path / "none"], tmp_path / "x", "holds no samples.jsonl"),
        ([write_run(tmp_path / "empty", {})], tmp_path / "x", "holds no sample"),
        ([], tmp_path / "x", "no folder named"),
    ):
        with pytest.raises(UsageError, match=message):
            write_suite_report(paths, out)
    with pytest.raises(UsageError, match="nothing to compare"):
        read_comparison([run])


def test_refusal_of_a_folder_is_one_line(tmp_path, refusal):
    assert "holds no samples.jsonl" in refusal("suite", "report", tmp_path, "--out", tmp_path / "x")


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
def test_wide_tables_scroll_and_show_a_hint(runs, tmp_path):
    page = write_suite_report(runs, tmp_path / "report")
    for width, least in ((WIDTH, 10), (1400, 2)):
        state = probe(page, SIDEWAYS, tmp_path / "profile", width)
        assert least <= state["wide"] < state["boxes"]
        assert (state["hints"], state["fadedAtStart"], state["fadedAtEnd"]) == (state["wide"], state["wide"], 0)
        assert state["pinned"]
        assert (state["overflow"], state["captions"], state["drawings"]) == (0, 0, 0)


def test_models_of_one_name_and_different_specs_are_separated_with_a_warning(tmp_path, program):
    """In the tables, on the page and on the terminal; equal specs are pooled, as shards."""
    folders = [
        write_run(tmp_path / name, {"T": [True] * 2}, model="python", first_seed=2 * k, spec=spec)
        for k, (name, spec) in enumerate({"a": "a" * 64, "b": "b" * 64, "shard": "a" * 64}.items())
    ]
    _, _, err = program("suite", "report", *folders, "--out", tmp_path / "report")
    with (tmp_path / "report" / "summary.csv").open() as file:
        counts = {row["model"]: row["episodes"] for row in csv.DictReader(file)}
    assert counts == {"python (spec=aaaaaa)": "4", "python (spec=bbbbbb)": "2"}
    warning = "python is the name of 2 world models (aaaaaa in a, bbbbbb in b), kept apart by their specs; name each"
    assert f"warning: {warning}" in err
    assert warning in (tmp_path / "report" / "report.html").read_text()
    assert "kept apart" not in write_suite_report([folders[0], folders[2]], tmp_path / "shards").read_text()
    again = write_run(tmp_path / "again", {"T": [False] * 2}, model="python", spec="b" * 64)
    _, out, err = program("compare", folders[0], again)
    assert "python is the name of 2 world models" in err
    assert "python (spec=aaaaaa)" in out


def test_specs_with_different_tags_get_no_spec_label(tmp_path):
    folders = [
        write_run(tmp_path / steps, {"T": [True]}, first_seed=k, spec=steps * 16, tags={"steps": steps})
        for k, steps in enumerate(("1500", "3000"))
    ]
    assert [e.model for e in pool_episodes(read_suite_runs(folders))] == ["wan (steps=1500)", "wan (steps=3000)"]
    assert spec_warnings(read_suite_runs(folders)) == []
