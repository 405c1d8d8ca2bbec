import pytest

from benchmarks.check import compare, read_rows, summary_table
from benchmarks.trajectory import REASONS, TrajectoryKind, TrajectoryTruth
from kinebench_drake.errors import InputError
from kinebench_drake.io.jsonl import dump
from kinebench_drake.stats import wilson
from tests.rows import make_row, make_violation


def truth(kind, n):
    return TrajectoryTruth(id=f"{kind.value}-{n}", kind=kind, family="cartesian", reasons=REASONS.get(kind, ()))


def row(name, feasible, kinds=(), **changes):
    violations = [make_violation(kind) for kind in kinds]
    values = {"video": f"{name}.npz", "reason": None, "feasible": feasible, "violations": violations, **changes}
    return make_row(name, **values)


@pytest.fixture
def verdicts():
    truths = [truth(TrajectoryKind.FEASIBLE, n) for n in range(4)] + [truth(TrajectoryKind.FAST, n) for n in range(4)]
    rows = [
        row("feasible-0", True, metrics={"sparc": None}, null_reasons={"sparc": "nearly still"}),
        row("feasible-1", False, ["jerk"]),
        row("feasible-2", None, metrics={"sparc": None}),
        row("fast-0", False, ["velocity", "torque"]),
        row("fast-1", False, ["torque"]),
        row("fast-2", True),
        row("renamed", False, ["velocity"], video="folder/fast-3.npz"),
    ]
    return {v.kind: v for v in compare(rows, {t.id: t for t in truths})}


def test_feasible_trajectories_judged_infeasible_are_false_alarms(verdicts):
    v = verdicts[TrajectoryKind.FEASIBLE]
    assert v.judged_infeasible.hits == 1
    assert v.judged_infeasible.share.n == 3
    assert v.judged_infeasible.ids == ("feasible-1",)
    assert v.reason_named is None
    assert v.undecided == ("feasible-2",)
    assert v.missing == ("feasible-3",)


def test_detections_and_named_reasons_have_wilson_intervals(verdicts):
    v = verdicts[TrajectoryKind.FAST]
    assert v.judged_infeasible.hits == 3
    assert v.judged_infeasible.ids == ("fast-2",)
    assert v.reason_named.hits == 2
    assert v.reason_named.ids == ("fast-1", "fast-2")
    assert v.missing == ()
    assert (v.judged_infeasible.share.low, v.judged_infeasible.share.high) == pytest.approx(wilson(3, 4))


def test_the_table_names_misses_and_false_alarms(verdicts):
    text = summary_table(list(verdicts.values()))
    assert "| fast | 4 | 3/4 = 75.0 %" in text
    assert "fast, not detected: fast-2" in text
    assert "fast, another reason named: fast-1" in text
    assert "feasible, false alarms: feasible-1" in text
    assert "all planted" not in text  # there is one kind of them


def test_the_table_also_pools_all_planted_kinds():
    truths = [truth(TrajectoryKind.FAST, n) for n in range(2)] + [truth(TrajectoryKind.REACH, n) for n in range(3)]
    rows = [row("fast-0", False, ["velocity"]), row("fast-1", False, ["jerk"])]
    rows += [row(f"reach-{n}", n != 2, ["unreachable"] if n == 2 else []) for n in range(3)]
    text = summary_table(compare(rows, {t.id: t for t in truths}))
    assert "| all planted | 5 | 3/5 = 60.0 %" in text
    assert "2/5 = 40.0 %" in text


def test_rows_are_read_from_an_output_folder(tmp_path):
    (tmp_path / "samples.jsonl").write_text(dump(row("a", True).to_json()))
    assert [r.id for r in read_rows(tmp_path)] == ["a"]
    with pytest.raises(InputError, match="cannot be read"):
        read_rows(tmp_path / "nowhere")
