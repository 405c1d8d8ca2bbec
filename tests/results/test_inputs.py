"""Frame period and camera of a run, with their sources."""

import pytest

from kinebench_drake.camera import CameraSource
from kinebench_drake.results.inputs import PeriodSource, input_lines, list_inputs
from tests.report.pages import row


def rows(*periods, camera="benchmark"):
    return [
        row(str(k), extra={"frame_period_s": period_s, "frame_period_source": source, "camera_source": camera})
        for k, (period_s, source) in enumerate(periods)
    ]


def test_a_single_frame_period_and_camera_are_listed_with_their_sources():
    assert input_lines(rows((0.2, "manifest"), (0.2, "manifest"), camera="folder")) == [
        "frame period: 0.2 s, from the manifest",
        "camera: from camera.json",
    ]


def test_several_frame_periods_are_listed_with_sample_counts_most_frequent_first():
    many = rows((1 / 17, "fps"), (0.2, "manifest"), (0.2, "manifest"), (0.1, "fps"), (0.5, "fps"), (0.25, "fps"))
    assert input_lines(many)[0] == (
        "frame period: 0.2 s, from the manifest (2 x); 0.05882 s, 1 / fps of the file (1 x); "
        "0.1 s, 1 / fps of the file (1 x); 2 more"
    )
    assert list_inputs(many)["frame_periods"][0] == {"frame_period_s": 0.2, "source": "manifest", "samples": 2}
    assert list_inputs(reversed(many)) == list_inputs(many)


def test_the_looks_of_a_run_stand_in_one_line():
    looks = [row(str(k), extra={"domain": domain}) for k, domain in enumerate(("unfamiliar", "familiar", "familiar"))]
    assert input_lines(looks) == ["look: familiar to the networks (2 x); unfamiliar to the networks (1 x)"]
    assert input_lines(looks[1:]) == ["look: familiar to the networks"]


def test_rows_without_frame_period_source_or_camera_are_not_listed():
    assert input_lines([row("a"), row("b", extra={"frame_period_s": 0.2})]) == []


@pytest.mark.parametrize("source", PeriodSource)
def test_every_frame_period_source_has_a_description(source):
    assert input_lines(rows((0.2, source.value)))[0] != f"frame period: 0.2 s, {source.value}"


@pytest.mark.parametrize("source", CameraSource)
def test_every_camera_source_has_a_description(source):
    (line,) = input_lines([row("a", extra={"camera_source": source.value})])
    assert len(line.split()) > 2


def timed(feasible, least_s, source="fps", camera="benchmark"):
    clock = {"frame_period_s": 0.05, "frame_period_source": source}
    fits = {"camera_source": camera, "camera_state": "confirmed"}
    return row("a", feasible=feasible, metrics={"feasible_from_period_s": least_s}, extra={**clock, **fits})


def test_verdicts_that_the_benchmarks_frame_period_changes_are_counted_where_its_camera_fits():
    run = [timed(False, 0.19), timed(False, 0.21), timed(False, None), timed(True, 0.04), timed(True, 0.2)]
    assert input_lines(run)[0].endswith("; but the benchmark camera fits: 1 verdict changes at 0.2 s")
    assert input_lines([timed(True, 0.3), *run])[0].endswith("2 verdicts change at 0.2 s")
    assert input_lines(run[1:])[0].endswith("no verdict changes at 0.2 s")


@pytest.mark.parametrize("other", [{"source": "manifest"}, {"camera": "folder"}])
def test_a_given_frame_period_or_camera_is_not_doubted(other):
    assert "0.2 s" not in input_lines([timed(False, 0.1, **other)])[0]
