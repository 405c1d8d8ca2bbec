import pytest

from kinebench_drake.metrics.trust import TrustLevel, assess_trust, trust_lines
from tests.rows import make_row

EXTRA = {
    "camera_state": "named",
    "camera_agreement": 0.72,
    "domain": "familiar",
    "frames": 49,
    "frame_period_source": "manifest",
}
PERIOD = "0.2 s, from the manifest"
OWN_CLOCK = {"camera_state": "confirmed", "frame_period_source": "fps"}
EPISODE = {"camera_agreement": None, "camera_source": "benchmark", "frame_period_source": "benchmark"}
METRICS = {"tracked_fraction": 1.0, "confidence_mean": 0.97}


def test_a_sample_without_doubts_is_solid_and_its_line_lists_the_evidence():
    trust = assess_trust(make_row(metrics=METRICS, extra=EXTRA), PERIOD, is_measured=True)
    assert trust.level == TrustLevel.SOLID.value
    assert trust.line == (
        "solid: nothing speaks against it (camera named, 72% of the arm's contours on image edges; look familiar; mean "
        "confidence 0.97; frame period 0.2 s, from the manifest; 0 of 49 frames not measured)"
    )


@pytest.mark.parametrize(
    ("extra", "metrics", "is_measured", "level", "reason"),
    [
        ({"camera_state": "none"}, {}, True, TrustLevel.UNKNOWN, "the base frame is unknown"),
        ({}, {}, False, TrustLevel.UNKNOWN, "the track is not trusted"),
        ({"camera_state": "estimated"}, {}, True, TrustLevel.CHECK, "the camera is estimated"),
        ({"camera_agreement": 0.5}, {}, True, TrustLevel.CHECK, "does not confirm the named camera"),
        ({"camera_agreement": None}, {}, True, TrustLevel.CHECK, "does not confirm the named camera"),
        (EPISODE, {}, True, TrustLevel.SOLID, "nothing"),
        ({"frame_period_source": "benchmark"}, {}, True, TrustLevel.CHECK, "the frame period is assumed"),
        ({}, {"tracked_fraction": 0.9}, True, TrustLevel.CHECK, "could not be measured"),
        ({}, {"confidence_mean": 0.6}, True, TrustLevel.CHECK, "confidence is low"),
        ({"domain": "unfamiliar"}, {}, True, TrustLevel.CHECK, "unfamiliar"),
        ({"domain": "arm_alone"}, {}, True, TrustLevel.CHECK, "without a hand"),
        ({**OWN_CLOCK, "camera_source": "benchmark"}, {}, True, TrustLevel.CHECK, "0.2 s"),
        ({**OWN_CLOCK, "camera_source": "recognized"}, {}, True, TrustLevel.SOLID, "nothing"),
    ],
)
def test_each_doubt_lowers_the_trust_level_and_is_its_reason(extra, metrics, is_measured, level, reason):
    trust = assess_trust(
        make_row(metrics={**METRICS, **metrics}, extra={**EXTRA, **extra}), PERIOD, is_measured=is_measured
    )
    assert trust.level == level.value
    assert reason in trust.reason


def test_all_reasons_are_stated_the_worst_first_and_each_is_counted():
    doubtful = {**EXTRA, "camera_state": "none", "domain": "unfamiliar"}
    row = make_row(metrics={**METRICS, "tracked_fraction": 0.9}, extra=doubtful)
    trust = assess_trust(row, PERIOD, is_measured=True)
    assert trust.reason == "the base frame is unknown; frames could not be measured; the look is unfamiliar"
    assert trust_lines([row.extended(trust=trust)] * 2) == [
        "trust: 2 unknown (frames could not be measured: 2; the base frame is unknown: 2; the look is unfamiliar: 2)"
    ]


def test_the_trust_line_of_an_unknown_base_frame_states_its_evidence():
    trust = assess_trust(
        make_row(metrics=METRICS, extra={**EXTRA, "camera_state": "none", "base_frame_reason": "72% against 56%"}),
        PERIOD,
        is_measured=True,
    )
    assert trust.reason == "the base frame is unknown"
    assert trust.line.startswith("unknown: 72% against 56% (")


def test_the_trust_line_of_a_run_counts_levels_with_their_reasons():
    labels = [EXTRA, EXTRA, {**EXTRA, "camera_state": "none"}, {**EXTRA, "domain": "unfamiliar"}]
    rows = [make_row(metrics=METRICS, extra=extra) for extra in labels]
    assessed = [row.extended(trust=assess_trust(row, PERIOD, is_measured=True)) for row in rows]
    assert trust_lines([*assessed, make_row()]) == [
        "trust: 2 solid, 1 check (the look is unfamiliar: 1), 1 unknown (the base frame is unknown: 1)"
    ]
    assert trust_lines([make_row()]) == []
