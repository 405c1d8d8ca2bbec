"""Reading files: keys, units, rotations, frames, and the examples of the documentation."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.trajectories.reading import EULER, LAYOUTS, START_Q, TOOLS, Reading
from kinebench_drake.formats.trajectories.trajectory import ColumnTable, NumberColumn
from kinebench_drake.geometry import invert, pose_difference
from kinebench_drake.models.panda.description import hand_from_tcp, rest_q

DOCS = Path(__file__).parents[3] / "docs" / "formats.md"


def apply(rows, **keys):
    table = ColumnTable(
        columns=(NumberColumn(name="a", size=rows.shape[1]),), load={"a": rows}.__getitem__, rate_hz=10.0
    )
    return Reading(columns=("a",), **keys).apply(table)


def numbers(layout, X):
    """The numbers of poses (T, 4, 4) in a layout."""
    R = X[:, :3, :3]
    p = X[:, :3, 3]
    rotation = Rotation.from_matrix(R)
    return {
        "quaternion_wxyz": lambda: np.hstack([p, rotation.as_quat(scalar_first=True)]),
        "quaternion_xyzw": lambda: np.hstack([p, rotation.as_quat()]),
        "rotation_vector": lambda: np.hstack([p, rotation.as_rotvec()]),
        "matrix_rows": lambda: X.reshape(-1, 16),
        "matrix_columns": lambda: np.swapaxes(X, 1, 2).reshape(-1, 16),
        "rotation_6d_rows": lambda: np.hstack([p, R[:, 0], R[:, 1]]),
        "rotation_6d_columns": lambda: np.hstack([p, R[:, :, 0], R[:, :, 1]]),
        **{name: lambda name=name: np.hstack([p, rotation.as_euler(name[6:])]) for name in EULER},
    }[layout]()


@pytest.mark.parametrize("layout", [layout for layout in LAYOUTS if layout != "joints"])
def test_every_layout_gives_back_the_poses_that_were_written_in_it(X_BG, layout):
    assert max(d.max() for d in pose_difference(apply(numbers(layout, X_BG), layout=layout).X_BG, X_BG)) < 1e-7


def test_units_frames_and_tools_are_undone(X_BG):
    base_from_world = (0.66, 0.0, -0.912, 0.8, 0.0, 0.0, 0.6)
    X_WB = invert(_pose(base_from_world))
    rows = numbers("euler_xyz", X_WB @ X_BG @ invert(TOOLS["flange"]))
    rows[:, :3] *= 1e3
    rows[:, 3:] = np.rad2deg(rows[:, 3:])
    keys = {"layout": "euler_xyz", "length": "mm", "angle": "deg", "tool": "flange", "base_from_world": base_from_world}
    assert max(d.max() for d in pose_difference(apply(rows, **keys).X_BG, X_BG)) < 1e-7


def _pose(numbers):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat(numbers[3:], scalar_first=True).as_matrix()
    X[:3, 3] = numbers[:3]
    return X


def test_changes_add_up_to_the_motion_from_their_start(q):
    deltas = np.diff(q, axis=0, append=q[-1:])
    np.testing.assert_allclose(apply(deltas, layout="joints", deltas=True, start=tuple(q[0])).q, q, atol=1e-12)


@pytest.mark.parametrize(("unit", "first"), [("s", 1.7e9), ("ms", 1.7e12), ("us", 1.7e15), ("ns", 1.7e18)])
def test_times_since_1970_show_their_unit(q, unit, first):
    stamps = first + 0.05 * np.arange(len(q)) / {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    data = {"q": q, "stamp": stamps}
    columns = (NumberColumn(name="q", size=7), NumberColumn(name="stamp", size=1))
    t_s = (
        Reading(columns=("q",), layout="joints", time="stamp")
        .apply(ColumnTable(columns=columns, load=data.__getitem__))
        .t_s
    )
    np.testing.assert_allclose(np.diff(t_s), 0.05, atol=1e-5)


def test_frames_and_posture_of_the_panda_are_those_of_its_model():
    np.testing.assert_array_equal(TOOLS["hand"], hand_from_tcp())
    np.testing.assert_array_equal(START_Q, rest_q())


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"colums": "a"}, r"colums is no key \(did you mean columns\?\)"),
        ({"layout": "quaternion"}, r"layout is 'quaternion' \(did you mean quaternion_"),
        ({"length": "inch"}, "length Input should be 'm', 'cm' or 'mm'"),
        ({"base_from_world": [1, 2]}, "base_from_world has 2 numbers, expected 7"),
    ],
)
def test_an_invalid_key_is_named_with_the_valid_ones(keys, message):
    with pytest.raises(UsageError, match=message):
        Reading.parse(keys)


def test_the_reading_files_of_the_documentation_are_valid():
    lines = re.findall(r"^    (\{.*?\}) {2,}\S", DOCS.read_text(), re.MULTILINE)
    assert len([Reading.parse(json.loads(line)) for line in lines]) == 10
