"""Leaderboards: success is corrected by the oracle's, models are ranked by lower bounds."""

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.leaderboard import write_leaderboard
from kinebench_drake.results.bundle import write_bundle
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from kinebench_drake.runs.benchmark_registry import load_benchmark
from kinebench_drake.stats import PairedShares
from tests.report.pages import BROWSER, EVIL, Page, probe, row
from tests.report.test_browser import PICTURE
from tests.results.test_bundle import METADATA

PROBE = """
<script>
addEventListener("load", () => {
  const wide = [...document.querySelectorAll("main > *")].filter(
    part => part.getBoundingClientRect().right > document.documentElement.clientWidth).length;
  const broken = [...document.images].filter(image => !image.naturalWidth).length;
  document.documentElement.setAttribute("data-state", JSON.stringify({errors: window.troubles, wide, broken}));
});
</script>
"""


@pytest.fixture
def bundle(tmp_path):
    """Writes the bundle of a run of one model."""

    def write(name, rows, *, tags=None, **config):
        kind = "suite" if "suite" in config else "score"
        with ResultStore(tmp_path / name) as store:
            for one in rows:
                store.append(one, 0.1)
                write_atomically(tmp_path / name / "thumbnails" / f"{one.id}.jpg", PICTURE)
            data = {**METADATA, "kind": kind, "samples_found": 10, "config": config, "tags": tags or {}}
            store.finish(data)
        write_bundle(tmp_path / name, tmp_path / f"{name}.zip")
        return tmp_path / f"{name}.zip"

    return write


@pytest.fixture
def suite(bundle):
    """Writes the bundle of a suite run from the successes of its episodes; None is an error."""

    def write(model, successes, **options):
        rows = []
        for seed, success in enumerate(successes):
            status = Status.ERROR if success is None else Status.OK
            extra = {"seed": seed, "pool": "test", "variant": "plain"}
            extra |= {} if success is None else {"success": success, "progress": float(success), "verdict": None}
            verdict = [True, None, False][seed % 3]
            rows.append(row(f"T_s{seed}", status, model=model, extra=extra, executable=verdict))
        return bundle(model, rows, suite=0, split="test", world_model=model, **options)

    return write


def make_leaderboard(bundles, out):
    return write_leaderboard(bundles, out, load_benchmark().rank)


def cells(out, model):
    """Cells of a model in leaderboard.csv, by their heading."""
    heads, *lines = [line.split(",") for line in (out / "leaderboard.csv").read_text().splitlines()]
    return next(dict(zip(heads, line, strict=True)) for line in lines if model in line)


def test_success_is_corrected_by_that_of_the_oracle_in_the_shared_episodes(suite, tmp_path):
    oracle = suite("oracle", [True, True, True, True, False, True])
    wan = suite("wan", [True, False, None, True, False])
    page = make_leaderboard([wan, oracle], tmp_path / "board")
    own = cells(tmp_path / "board", "wan")
    assert float(own["success"]) == 0.4
    assert float(own["ceiling"]) == 0.8
    assert float(own["corrected"]) == pytest.approx(0.5)
    assert 0.0 <= float(own["corrected_low"]) < 0.5 < float(own["corrected_high"])
    assert (float(own["executable"]), float(own["executable_most"])) == (0.4, 0.8)
    assert (float(own["coverage"]), own["samples"], own["planned"]) == (0.8, "5", "10")
    assert cells(tmp_path / "board", "oracle")["corrected"] == ""
    assert (tmp_path / "board" / "numbers.csv").read_text().count("Success ↑") == 1
    text = page.read_text()
    assert Page(text).open == []
    assert text.index('<td class="w" data-key="oracle"') < text.index('<td class="w" data-key="wan"')


def test_a_board_without_an_oracle_says_so(suite, tmp_path):
    page = make_leaderboard([suite("wan", [True, False])], tmp_path / "board")
    assert "suite run --world-model oracle" in page.read_text()
    assert "two models that share a sample" in page.read_text()
    assert "corrected" not in (tmp_path / "board" / "leaderboard.csv").read_text()


def test_the_ratio_of_paired_shares_is_one_of_equal_ones_and_has_no_value_over_nothing():
    hits = np.array([1.0, 0.0, 1.0])
    assert PairedShares(first=hits, second=hits).ratio().value == 1.0
    assert np.isnan(PairedShares(first=hits, second=0.0 * hits).ratio().value)
    many = np.tile([1.0, 0.0, 1.0, 1.0], 25)
    ratio = PairedShares(first=many * np.tile([1.0, 1.0], 50), second=np.ones(100)).ratio()
    # Of a ceiling of 1 it is the share itself, whose standard error is sqrt(p (1 - p) / n).
    assert (ratio.high - ratio.low) / 2 / 1.96 == pytest.approx(np.sqrt(0.75 * 0.25 / 100), rel=0.1)


def test_the_same_bundles_give_the_same_bytes(suite, tmp_path):
    bundles = [suite("wan", [True, False]), suite("cog", [False, False])]
    for name in ("one", "two"):
        make_leaderboard(bundles, tmp_path / name)
    one, two = ({p.name: p.read_bytes() for p in (tmp_path / n).rglob("*") if p.is_file()} for n in ("one", "two"))
    assert one == two


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
def test_the_page_of_hostile_labels_works_in_a_browser_on_a_phone(bundle, tmp_path):
    rows = [row(f"clip{k}", executable=k > 1, feasible=k > 0, model=EVIL, task=EVIL) for k in range(5)]
    page = make_leaderboard([bundle("one", rows, source=EVIL)], tmp_path / "board")
    assert Page(page.read_text()).scripts == 1
    assert probe(page, PROBE, tmp_path / "profile") == {"errors": [], "wide": 0, "broken": 0}


def test_bundles_of_different_kinds_or_of_one_name_are_refused(suite, bundle, tmp_path):
    one = suite("wan", [True])
    other = bundle("clips", [row("a", executable=True)])
    with pytest.raises(UsageError, match="one leaderboard has one kind"):
        make_leaderboard([one, other], tmp_path / "board")
    with pytest.raises(UsageError, match="two bundles have this name"):
        make_leaderboard([one, one], tmp_path / "board")
    assert not (tmp_path / "board").exists()
