"""Findings as text: units from the keys, degrees and millimetres on screen."""

import pytest

from kinebench_drake.report.details import list_facts


@pytest.mark.parametrize(
    ("key", "value", "name", "text"),
    [
        ("position_m", 0.0012, "position", "1.2 mm"),
        ("rotation_rad", 3.141592653589793, "rotation", "180 °"),
        ("bandwidth_hz", 1.25, "bandwidth", "1.25 Hz"),
        ("t_worst_s", 2, "t worst", "2 s"),
        ("feasible", False, "feasible", "no"),
        ("joint", "panda_joint4", "joint", "panda_joint4"),
        ("margins_rad", [0.0, 1.5707963267948966, None], "margins", "0, 90, – °"),
        ("levels", list(range(20)), "levels", "0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 … (20 in all)"),
    ],
)
def test_units_follow_the_key(key, value, name, text):
    (fact,) = list_facts({key: value})
    assert (fact.depth, fact.name, fact.text) == (0, name, text)


def test_objects_within_objects_lie_deeper():
    facts = list_facts({"trajopt": {"certificate": {"samples": 3}, "note": None}, "empty": {}, "z": 1})
    assert [(f.depth, f.name, f.text) for f in facts] == [
        (0, "trajopt", ""),
        (1, "certificate", ""),
        (2, "samples", "3"),
        (0, "z", "1"),
    ]


def test_lists_of_objects_have_a_line_each():
    facts = list(list_facts({"jumps": [{"frame": 3, "size_m": 0.1}, {"frame": 9, "size_m": 0.2}]}))
    assert [(f.name, f.text) for f in facts] == [
        ("jumps", ""),
        ("1", "frame 3; size 100 mm"),
        ("2", "frame 9; size 200 mm"),
    ]
