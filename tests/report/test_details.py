"""Summaries of the checks of a sample."""

import numpy as np
import pytest

from kinebench_drake.report.sample import summarize_checks

T_S = 2.0 + 0.1 * np.arange(20)
DETAILS = {
    "noise": {"position_m": 0.003, "rotation_rad": 0.01, "assumed": False, "allowance_sigmas": 5.0},
    "slowdown": {"limit": "acceleration", "joint": "j2", "frame": 4},
    "time_scale": {"limit": "torque", "joint": "j4", "frame": 7},
    "trajopt": {"tube_limit_m": 0.005, "against": None},
}


def summary(row, t_s=T_S):
    return dict(summarize_checks(row, t_s))


def test_the_frame_period_from_which_a_motion_is_feasible_is_in_words(judged):
    slow = judged(metrics={"slowdown_min": 3.1, "feasible_from_period_s": 0.3123}, details=DETAILS)
    text = summary(slow)["slow-down needed"]
    assert text == "3.1, for acceleration of j2 at 2.40 s; feasible from a frame period of 0.31 s"


def test_checks_of_a_feasible_track_are_summarized(judged):
    metrics = {"slowdown_min": 0.42, "time_scale": 0.3, "trajopt_feasible": True, "trajopt_position_tube_m": 0.0021}
    assert summary(judged(details=DETAILS, metrics=metrics)) == {
        "noise of the track": "3 mm, 0.573 °",
        "slow-down needed": "none, 0.42, for acceleration of j2 at 2.40 s",
        "fastest execution": "0.3 of its own duration, limited by torque of j4 at 2.70 s",
        "smooth trajectory within all limits": "within 2.1 mm of the track (allowed: 5 mm)",
    }


def test_an_infeasible_track_names_the_limit_that_prevents_it(judged):
    against = {"kind": "table_collision", "frame": 3, "joint": None, "value": -0.02, "limit": -0.002}
    details = {**DETAILS, "trajopt": {"tube_limit_m": 0.005, "against": against}}
    metrics = {"slowdown_min": 1.5, "trajopt_feasible": False, "trajopt_position_tube_m": 0.018}
    texts = summary(judged(details=details, metrics=metrics))
    assert texts["slow-down needed"].startswith("1.5, for acceleration")
    assert texts["smooth trajectory within all limits"] == (
        "within 18 mm of the track (allowed: 5 mm); prevented by table collision at 2.30 s, -20 against -2 mm"
    )
    metrics["trajopt_position_tube_m"] = None
    texts = summary(judged(details=details, metrics=metrics), None)
    assert texts["smooth trajectory within all limits"].startswith(
        "none (allowed: 5 mm); prevented by table collision in frame 3"
    )


def test_assumed_noise_is_marked(judged):
    details = {"noise": {**DETAILS["noise"], "assumed": True}}
    assert "assumed" in summary(judged(details=details))["noise of the track"]


@pytest.mark.parametrize("details", [{}, {"slowdown": None}, {"time_scale": {}}])
def test_missing_checks_are_left_out(judged, details):
    assert summarize_checks(judged(details=details, metrics={"slowdown_min": None}), T_S) == []
