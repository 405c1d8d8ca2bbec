"""What the checks came to, in a line each."""

import numpy as np
import pytest

from kinebench_drake.report.details import resolutions, summarize_checks

T_S = 2.0 + 0.1 * np.arange(20)
DETAILS = {
    "noise": {"position_m": 0.003, "rotation_rad": 0.01, "assumed": False, "allowance_sigmas": 5.0},
    "slowdown": {"limit": "acceleration", "joint": "j2", "frame": 4},
    "time_scale": {"limit": "torque", "joint": "j4", "frame": 7, "active": []},
    "trajopt": {"tube_limit_m": 0.005, "against": None},
}


def lines(row, t_s=T_S):
    return {fact.name: fact.text for fact in summarize_checks(row, t_s)}


def test_a_feasible_track(judged):
    metrics = {"slowdown_min": 0.42, "time_scale": 0.3, "trajopt_feasible": True, "trajopt_position_tube_m": 0.0021}
    assert lines(judged(details=DETAILS, metrics=metrics)) == {
        "noise of the track": "3 mm, 0.573 °",
        "slow-down needed": "none, 0.42, for acceleration of j2 at 2.40 s",
        "fastest run": "0.3 of its own time, held back by torque of j4 at 2.70 s",
        "smooth trajectory within all limits": "within 2.1 mm of the track (allowed: 5 mm)",
    }


def test_an_infeasible_track_names_what_stands_against_it(judged):
    against = {"kind": "table_collision", "frame": 3, "joint": None, "value": -0.02, "limit": -0.002}
    details = {**DETAILS, "trajopt": {"tube_limit_m": 0.005, "against": against}}
    metrics = {"slowdown_min": 1.5, "trajopt_feasible": False, "trajopt_position_tube_m": 0.018}
    found = lines(judged(details=details, metrics=metrics))
    assert found["slow-down needed"].startswith("1.5, for acceleration")
    assert found["smooth trajectory within all limits"] == (
        "within 18 mm of the track (allowed: 5 mm); table collision at 2.30 s stands against it, -0.02 against -0.002"
    )
    metrics["trajopt_position_tube_m"] = None
    found = lines(judged(details=details, metrics=metrics), None)
    assert found["smooth trajectory within all limits"].startswith("none (allowed: 5 mm); table collision in frame 3")


def test_noise_that_had_to_be_assumed_is_called_so(judged):
    details = {"noise": {**DETAILS["noise"], "assumed": True}}
    assert "assumed" in lines(judged(details=details))["noise of the track"]


@pytest.mark.parametrize("details", [{}, {"noise": None, "slowdown": None, "trajopt": None}, {"time_scale": {}}])
def test_nothing_is_said_of_what_a_row_lacks(judged, details):
    assert summarize_checks(judged(details=details, metrics={"slowdown_min": None}), T_S) == []


def test_resolutions_of_each_limit(judged):
    checks = {
        "velocity": {"ratio_max": 0.5, "window_s": 0.2, "bandwidth_hz": 2.2, "ratios": [0.5, None], "noise_ratio": 0.1},
        "jerk": {"ratio_max": None},
    }
    (found,) = resolutions(judged(details={"checks": checks}))
    assert (found.kind, found.window_s, found.bandwidth_hz, found.noise_ratio) == ("velocity", 0.2, 2.2, 0.1)
    assert found.ratios == (0.5, None)
