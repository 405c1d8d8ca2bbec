"""Models of score and audit runs, paired sample by sample: labels, keys, pages, and refusals."""

import csv

import pytest

from kinebench_drake.cli import main
from kinebench_drake.errors import UsageError
from kinebench_drake.io.jsonl import dump
from kinebench_drake.report.run import read_runs
from kinebench_drake.report.sample_comparison import compare_samples, label_samples, pair_models
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import RESULTS, SAMPLES
from tests.report.pages import BROWSER, EVIL, WIDTH, Page, probe
from tests.rows import make_row


def write(out, samples, kind="score", config=None, **results):
    """Write the output folder of a run; `samples` holds fields of rows by id."""
    out.mkdir(parents=True)
    rows = []
    for k, (id, fields) in enumerate(samples.items()):
        fields = {"sparc": -2.0 - 0.1 * k, "feasible": True, **fields}
        extra = {name: fields.pop(name) for name in ("seed", "frame_period_s", "camera_source") if name in fields}
        metrics = {"sparc": fields.pop("sparc"), "tracked_fraction": 1.0, "anomalies": []}
        row = {"video": f"{id}.mp4", "task": None, "model": None, "status": Status.OK, "reason": None, **fields}
        rows.append(make_row(id=id, content_hash="0", metrics=metrics, extra=extra, **row))
    data = {
        "schema_version": 1,
        "kind": kind,
        "samples_found": len(rows),
        "config": config or {},
        "tags": {},
        **results,
    }
    (out / SAMPLES).write_text("".join(dump(row.to_json()) for row in rows))
    (out / RESULTS).write_text(dump(data))
    return out


def compared(*paths):
    return compare_samples(read_runs(paths))


def paired(*paths):
    return pair_models(label_samples(read_runs(paths)))


def labelled(model, prefix="", n=4, **fields):
    """Samples of one model with task and seed, whose ids start with a prefix."""
    return {f"{prefix}{k}": {"model": model, "task": f"T{k % 2}", "seed": k, **fields} for k in range(n)}


def test_models_of_one_run_are_paired_by_task_and_seed(tmp_path):
    [pair] = paired(write(tmp_path / "a", labelled("wan", "a") | labelled("cog", "b", n=3)))
    assert (pair.first, pair.second, pair.key, pair.samples) == ("wan", "cog", "task and seed", (4, 3))
    assert [(a.id, b.id) for a, b in pair.pairs] == [("a0", "b0"), ("a1", "b1"), ("a2", "b2")]


def test_equal_ids_in_two_folders_are_not_paired_where_task_and_seed_say_otherwise(tmp_path):
    """Both folders number their videos, in different orders."""
    b = {str(3 - k): {"model": "cog", "task": f"T{k % 2}", "seed": k} for k in range(4)}
    [pair] = paired(write(tmp_path / "a", labelled("wan")), write(tmp_path / "b", b))
    assert pair.key == "task and seed"
    assert {(a.id, b.id) for a, b in pair.pairs} == {("0", "3"), ("1", "2"), ("2", "1"), ("3", "0")}


def test_samples_without_labels_are_paired_by_id_and_models_named_by_folder(tmp_path):
    a, b = (write(tmp_path / name, {"x": {}, "y": {}, name: {}}) for name in ("a", "b"))
    [pair] = paired(a, b)
    assert (pair.first, pair.second, pair.key, len(pair.pairs)) == ("a", "b", "id", 2)
    c, d = (write(tmp_path / name / "out", {"x": {}}) for name in ("c", "d"))
    [pair] = paired(c, d)
    assert (pair.first, pair.second) == ("c/out", "d/out")


def test_one_run_of_two_models_without_seeds_is_paired_by_file_name(tmp_path):
    samples = {f"{m}-{k}": {"model": m, "video": f"{m}/{k}.mp4"} for m in ("wan", "cog") for k in range(3)}
    [pair] = paired(write(tmp_path / "a", samples))
    assert (pair.key, len(pair.pairs)) == ("file name", 3)


def test_shards_are_pooled_and_other_runs_of_a_model_are_not(tmp_path):
    shards = [write(tmp_path / f"s{k}", {f"{k}{n}": {"model": "wan"} for n in range(2)}) for k in range(2)]
    other = write(tmp_path / "other", {f"{k}{n}": {"model": "cog"} for k in range(2) for n in range(2)})
    [pair] = paired(*shards, other)
    assert (pair.first, pair.second, len(pair.pairs)) == ("wan", "cog", 4)
    again = write(tmp_path / "again", {"00": {"model": "wan"}}, config={"frame_period_s": 0.1})
    labels = {pair.first for pair in paired(shards[0], again)}
    assert labels == {"wan [s0]"}
    tagged = write(tmp_path / "tagged", {"00": {"model": "wan"}}, tags={"lr": "1"})
    assert {(p.first, p.second) for p in paired(shards[0], tagged)} == {("wan [s0]", "wan [tagged]")}


def test_other_differences_of_the_runs_are_warnings(tmp_path):
    one = write(tmp_path / "a", {"x": {"frame_period_s": 0.2, "camera_source": "folder"}}, weights_sha256="1")
    two = write(tmp_path / "b", {"x": {"frame_period_s": 0.1, "camera_source": "benchmark"}}, weights_sha256="2")
    first, second, third = compared(one, two).warnings
    assert "frame periods of a and b differ in 1 of 1 shared sample (such as 0.2 and 0.1)" in first
    assert "camera" in second
    assert "weights_sha256" in third
    assert not compared(one, write(tmp_path / "c", {"x": {"frame_period_s": 0.2}}, weights_sha256="1")).warnings


@pytest.mark.parametrize(
    ("first", "second", "changes", "message"),
    [
        ({"x": {}}, {"y": {}}, {}, "share a sample: ids and file names differ .such as 'x' and 'y'."),
        ({"x": {"task": "A"}}, {"x": {"task": "B"}}, {}, "x has task A in a and B in b: they are different samples"),
        ({"x": {"seed": 1}}, {"x": {"seed": 2}}, {}, "x has seed 1 in a and 2 in b"),
        (
            {"x": {}},
            {"x": {}},
            {"kind": "audit"},
            "videos of `score` in .* and trajectories of `audit` in .* cannot be compared",
        ),
        ({"x": {}}, {"x": {}}, {"schema_version": 2}, "schema_version 1 and .* 2"),
    ],
)
def test_incomparable_runs_are_refused_with_the_reason(tmp_path, first, second, changes, message):
    one = write(tmp_path / "a", first)
    two = write(tmp_path / "b", second, **changes)
    with pytest.raises(UsageError, match=message) as error:
        compared(one, two)
    assert "\n" not in str(error.value)


def test_a_comparison_of_one_model_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"all samples are of one model, wan: .* \$model"):
        compared(write(tmp_path / "a", labelled("wan")))


@pytest.fixture
def folders(tmp_path):
    """Scores of two models, one of which loses samples."""
    bad = {"status": Status.UNMEASURABLE, "reason": EVIL, "feasible": None, "sparc": None}
    wan = {id: fields | (bad if int(id) % 7 == 6 else {}) for id, fields in labelled("wan", n=40).items()}
    cog = {id: fields | {"sparc": -2.5 - 0.1 * int(id)} for id, fields in labelled(EVIL, n=40).items()}
    for path in (write(tmp_path / "runs" / "wan", wan), write(tmp_path / "runs" / "cog", cog)):
        (path / "report.html").write_text("page")
    return tmp_path / "runs" / "wan", tmp_path / "runs" / "cog"


def test_a_comparison_of_scores_is_printed_and_written(folders, tmp_path, capsys):
    out = tmp_path / "runs" / "comparison"
    with pytest.raises(SystemExit) as stop:
        main(["compare", *map(str, folders), "--out", str(out)])
    assert stop.value.code == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "No sample has a verdict that would rank the models"
    assert printed[1] == f"wan - {EVIL}: 40 shared samples (of 40 and 40), paired by task and seed"
    assert any(line.startswith("SPARC ↑") for line in printed)
    text = (out / "report.html").read_text()
    page = Page(text)
    assert page.open == []
    assert page.scripts == 1
    assert EVIL not in text
    assert str(tmp_path) not in text
    assert "../wan/report.html#6" in page.links
    names = {path.name for path in out.iterdir()}
    assert names >= {"numbers.csv", "numbers.tex", "samples.csv"}
    with (out / "numbers.csv").open() as file:
        sparc = next(row for row in csv.DictReader(file) if row["metric"] == "sparc" and row["task"] == "all tasks")
    assert float(sparc["difference"]) == pytest.approx(0.5)
    assert (sparc["complete"], sparc["shared"], sparc["first_better"], sparc["second_better"]) == (
        "35",
        "40",
        "35",
        "5",
    )
    assert float(sparc["bound"]) < 0.5
    with (out / "samples.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 80
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    compared(*folders).write(out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_the_folder_of_a_run_is_not_overwritten(folders):
    with pytest.raises(UsageError, match="whose own report"):
        compared(*folders).write(folders[0])


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
def test_the_page_fits_a_phone(folders, tmp_path):
    script = """<script>addEventListener("load", () => {
      const room = document.documentElement.clientWidth;
      const wide = [...document.querySelectorAll("main > *")].filter(e => e.getBoundingClientRect().right > room);
      const rows = document.querySelectorAll("#list tbody tr").length;
      const state = {errors: window.troubles, wide: wide.length, rows: rows};
      document.documentElement.setAttribute("data-state", JSON.stringify(state));
    });</script>"""
    page = compared(*folders).write(tmp_path / "out")
    assert probe(page, script, tmp_path / "profile", WIDTH) == {"errors": [], "wide": 0, "rows": 80}
