from benchmarks.accuracy import HeldoutFigures, figures, section
from benchmarks.footage import ReferenceKind
from benchmarks.markdown import replace_section
from kinebench_drake.stats import IntervalEstimate

POSES = {
    "videos": 3, "tracked": 0.9, "hand_mm_median": 4.25, "hand_mm_p95": 14.0, "rotation_deg_median": 1.0,
    "rotation_deg_p95": 3.0, "silent": 0.01, "good": 0.8, "confidence_mean": 0.85,
}  # fmt: skip
OTHERS = [
    {
        "kinds": {ReferenceKind.JOINTS.value: {**POSES, "hand_mm_median": 9.5}},
        "labels": {"all": {"frames": 80, "tracked": 0.5, "error_median": 0.08, "error_p95": 0.15, "silent": 0.0}},
        "anomalies": {"clean_videos": 10, "clean_videos_with_anomalies": 2},
    },
    {
        "kinds": {ReferenceKind.SIMULATOR.value: POSES},
        "anomalies": {"clean_videos": 0, "clean_videos_with_anomalies": 0},
    },
]
HELDOUT = HeldoutFigures(
    summary={
        "videos": 22.0, "tracked_fraction": 0.995, "position_median_mm": 1.39, "position_p95_mm": 3.9,
        "rotation_median_deg": 0.59, "rotation_p95_deg": 1.8, "tracked_frames_off_by_3_cm": 0.0, "cpu_median_s": 5.0,
        "finger_width_known": 0.95, "finger_width_median_mm": 0.7, "finger_width_p95_mm": 3.5,
        "calibration_error": 0.01, "anomalies_not_planted": 1.0,
    },
    intervals={
        "position_median_mm": IntervalEstimate(value=1.39, low=1.25, high=1.54),
        "rotation_median_deg": IntervalEstimate(value=0.59, low=0.55, high=0.66),
    },
)  # fmt: skip


def test_external_videos_come_before_renderings_of_this_project():
    rows = [line for line in section(HELDOUT, OTHERS).splitlines() if line.startswith("| ")][2:]
    assert ["other simulator" in rows[0], "real arm" in rows[1], "this project" in rows[2]] == [True] * 3
    assert "4.2 / 14.0 mm" in rows[0]
    assert "9.5 / 14.0 mm" in rows[1]
    assert "1.4 [1.2, 1.5] / 3.9 mm" in rows[2]
    assert "by 0.010 (mean over bins" in section(HELDOUT, OTHERS).replace("\n", " ")


def test_a_section_without_external_videos_does_not_mention_them():
    text = section(HELDOUT, [])
    assert "others" not in text.partition("The commands")[0].replace("--others", "")


def test_the_section_replaces_its_predecessor_in_the_page():
    page = replace_section("# Title\n\n## Accuracy\n\nold\n\n## More\n\nkept\n", section(HELDOUT, OTHERS))
    assert "old" not in page
    assert page.endswith("## More\n\nkept\n")


def test_lower_is_better_for_every_figure():
    better = [{**OTHERS[1], "kinds": {ReferenceKind.SIMULATOR.value: {**POSES, "tracked": 1.0, "silent": 0.0}}}]
    before = figures(HELDOUT, OTHERS[1:])
    now = figures(HELDOUT, better)
    assert before.keys() == now.keys()
    assert all(now[name] <= before[name] for name in now)
    assert now != before
