"""Drop lists of rows, and their SARIF."""

import json

import pytest

from kinebench_drake.results.drops import DropReason, list_drops, to_sarif
from kinebench_drake.results.row import SampleRow, Status
from tests.rows import make_row


def _row(id: str, *, lag: int | None = None, tolerance: int = 0, **changes: object) -> SampleRow:
    extra = {"frames": 100, "frame_period_s": 0.05, "fingerprint": id, "idle_ends": [0, 0], "dropped_samples": []}
    if lag is not None:
        extra["action_lag"] = {"frames": lag, "tolerance": tolerance, "correlation": 0.99}
    fields = {"status": Status.OK, "reason": None, "task": None, "model": None, "content_hash": "", "feasible": True}
    row = {key: changes.pop(key) for key in list(changes) if key in (*fields, "violations")}
    video = f"ds/data/file 0.parquet#{id}"
    return make_row(id=id, video=video, **{**fields, **row}, extra={**extra, **changes})


def _found(*rows: SampleRow) -> list[tuple[str, DropReason, tuple[int, int] | None]]:
    return [
        (drop.id, drop.reason, None if drop.frame_start is None else (drop.frame_start, drop.frame_end))
        for drop in list_drops(rows)
    ]


def test_sound_samples_are_not_listed() -> None:
    assert _found(_row("a", lag=1), _row("b", lag=2), _row("c")) == []


def test_each_fault_has_its_reason_and_its_frames() -> None:
    violations = tuple({"kind": kind, "frame_start": k, "frame_end": k + 2} for k, kind in ((7, "jerk"), (3, "torque")))
    assert _found(_row("a", feasible=False, violations=violations)) == [("a", DropReason.INFEASIBLE, (3, 9))]
    assert _found(_row("a", dropped_samples=[4, 30])) == [("a", DropReason.DROPPED_SAMPLES, (4, 30))]
    rests = [("a", DropReason.IDLE_ENDS, (0, 19)), ("a", DropReason.IDLE_ENDS, (60, 99))]
    assert _found(_row("a", idle_ends=[20, 40])) == rests
    assert _found(_row("a", status=Status.ERROR, reason="torn")) == [("a", DropReason.NOT_MEASURED, None)]


def test_of_equal_motions_the_first_stays() -> None:
    rows = [_row(id, fingerprint="same") for id in "abc"]
    assert [drop[0] for drop in _found(*rows)] == ["b", "c"]


@pytest.mark.parametrize(
    ("lag", "tolerance", "listed"),
    [(1, 0, False), (2, 0, False), (3, 0, True), (-1, 0, True), (-1, 1, False), (12, 0, True), (3, 2, False)],
)
def test_a_lag_is_listed_if_it_is_no_robots_or_not_that_of_the_data_set(lag: int, tolerance: int, listed: bool) -> None:
    rows = [_row(str(k), lag=1) for k in range(5)]
    found = _found(*rows, _row("x", lag=lag, tolerance=tolerance))
    assert found == ([("x", DropReason.ACTION_OFFSET, None)] if listed else [])


def test_sarif_has_a_result_for_each_entry_with_a_rule_and_a_relative_uri() -> None:
    drops = list_drops([_row("a", idle_ends=[20, 40]), _row("b", feasible=False)])
    [run] = json.loads(json.dumps(to_sarif(drops, "1.2.3")))["runs"]
    rules = run["tool"]["driver"]["rules"]
    assert [result["ruleId"] for result in run["results"]] == ["idle_ends", "idle_ends", "infeasible"]
    for result in run["results"]:
        assert rules[result["ruleIndex"]]["id"] == result["ruleId"]
        [place] = result["locations"]
        assert place["physicalLocation"]["artifactLocation"]["uri"] == "ds/data/file%200.parquet"
    assert [result["level"] for result in run["results"]] == ["warning", "warning", "error"]
    assert run["results"][1]["properties"] == {"frame_start": 60, "frame_end": 99}
