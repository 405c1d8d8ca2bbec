"""The closing lines of a run: verdicts, faults, reasons, frame period, camera."""

import pytest

from kinebench_drake.cli.progress import ProgressView, summary_lines
from kinebench_drake.errors import count_noun
from kinebench_drake.results.row import Status
from tests.report.pages import row

CLOCK = {"frame_period_s": 0.2, "frame_period_source": "manifest", "camera_source": "folder"}


def lines(*rows):
    return list(summary_lines(rows))


def judged(id, executable, feasible, anomalies=(), violations=(), **fields):
    """A judged row."""
    marks = [{"kind": kind, "frame_start": 1, "frame_end": 2, "severity": 1.0} for kind in anomalies]
    limits = tuple({"kind": kind, "frame_start": 0, "frame_end": 1} for kind in violations)
    values = {"executable": executable, "feasible": feasible, "violations": limits}
    return row(id, metrics={"anomalies": marks}, extra={**CLOCK, **fields}, **values)


def lost(id, reason, status=Status.UNMEASURABLE):
    return row(id, status, reason=reason, metrics={"anomalies": None}, extra={"camera_source": "folder"})


def test_summary_has_lines_for_verdicts_anomalies_reasons_period_and_camera():
    run = (
        judged("a", True, True),
        judged("b", False, True, anomalies=("vanish", "vanish", "freeze")),
        judged("c", False, False, anomalies=("vanish",), violations=("velocity",)),
        lost("d", "the gripper was found in 0 of 49 frames"),
        lost("e", "the gripper was found in 1 of 33 frames"),
        lost("f", "too short"),
    )
    verdicts, faults, reasons, period, camera = lines(*run)
    assert verdicts == (
        "executable: 1 of 6 samples, 17% (95% interval 3% to 56%; at most 67%, 3 undecided); "
        "feasible: 2 of 3 judged samples, 67% (95% interval 21% to 94%; at least 33% of all 6)"
    )
    assert faults == "anomalies: vanish in 2 samples, freeze in 1 sample; violated limits: velocity in 1 sample"
    assert reasons == "unmeasurable: 3 of 6 samples (2 x the gripper was found in 0 of 49 frames; 1 x too short)"
    assert period == "frame period: 0.2 s, from the manifest"
    assert camera == "camera: from camera.json"


def test_summary_of_one_clean_sample_is_singular_with_anomalies_none():
    assert lines(judged("a", True, True))[:3] == [
        "executable: 1 of 1 sample, 100% (95% interval 21% to 100%); feasible: 1 of 1 sample, 100% "
        "(95% interval 21% to 100%)",
        "anomalies: none",
        "unmeasurable: 0 of 1 sample",
    ]


def test_summary_of_trajectories_lists_violated_limits_in_place_of_anomalies():
    assert lines(row("a", feasible=True, metrics={"sparc": -2.0}))[1] == "violated limits: none"


def test_summary_lists_errors_beside_unmeasurable_samples_with_escaped_reasons():
    third = lines(judged("a", True, True), lost("b", "no video\nat all \x1b[31m", Status.ERROR))[2]
    assert third == r"unmeasurable: 0 of 2 samples; error: 1 of 2 samples: no video at all \x1b[31m"


def test_summary_of_failed_episodes_has_the_share_of_each_cause():
    causes = ("grounding", "generation", "generation", None)
    failed = [judged(f"f{k}", True, True, success=False, verdict=cause) for k, cause in enumerate(causes)]
    attribution = lines(*failed, judged("a", True, True, success=True, verdict=None))[1]
    assert attribution == (
        "attribution of 4 failures: grounding 25% (1), generation 50% (2), execution 0% (0), task 0% (0), "
        "undecided 25% (1)"
    )


def test_summary_counts_motionless_samples():
    still = row("a", feasible=True, metrics={"motionless": True})
    assert "motionless: 1 of 2 samples" in lines(still, row("b", feasible=True, metrics={"motionless": False}))


def test_summary_of_episodes_begins_with_the_success_rate():
    assert lines(judged("a", True, True, success=True))[0].startswith("success: 1 of 1 sample, 100%")


def test_the_line_of_a_sample_is_its_verdict_then_its_trust(capsys):
    trust = {"level": "check", "reason": "the look is unfamiliar", "line": "check: the look is unfamiliar (look ...)"}
    view = ProgressView()
    view.start(2, 0)
    view.finish(judged("a", True, True, trust=trust), 6.34)
    view.finish(lost("b", "too short", Status.ERROR), 0.0)
    assert capsys.readouterr().err.splitlines() == [
        "[1/2] a executable; trust: check, the look is unfamiliar (6.3 s)",
        "[2/2] b error: too short (0.0 s)",
    ]


@pytest.mark.parametrize(("n", "text"), [(0, "0 samples"), (1, "1 sample"), (2, "2 samples")])
def test_count_noun_is_plural_except_for_one(n, text):
    assert count_noun(n, "sample") == text
