"""Trajectories in npz and csv files."""

import csv
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.trajectories.check import MAX_FRAMES
from kinebench_drake.formats.trajectories.reading import Layout, Reading
from kinebench_drake.formats.trajectories.trajectory import RawTrajectory, TrajectoryOptions, TrajectorySample
from kinebench_drake.geometry import Array
from kinebench_drake.io.npz import check_bytes, open_npz

_MAX_BYTES = 2**28
_POSES, _JOINTS = "base_from_tcp", "q"


def read_npz(sample: TrajectorySample, choice: TrajectoryOptions) -> RawTrajectory:
    """Read `t_s` and `base_from_tcp` or `q`, and `tracked` and `finger_width_m` if present.

    Joint angles take precedence over poses, as they determine the posture; except in the tracks of an output folder
    (recognized by their array `ik_ok`), whose angles were computed from the poses.

    Raises:
        InputError: the file is damaged, lacks an array, or holds pickled objects.
    """
    with open_npz(sample.path, partial(check_bytes, most=_MAX_BYTES)) as archive:
        names, warnings = archive.files, list[str]()
        choices = [name for name in (choice.joints, choice.poses) if name is not None]
        if choices:
            [name], is_joints = choices, choice.joints is not None
            if name not in names:
                raise InputError(f"holds no array {name!r}, but {_list_arrays(names)}")
        else:
            order = (_POSES, _JOINTS) if "ik_ok" in names else (_JOINTS, _POSES)
            candidates = [name for name in order if name in names]
            if not candidates:
                raise InputError(f"holds {_list_arrays(names)}, expected t_s and {_POSES} (T,4,4) or {_JOINTS} (T,7)")
            name, is_joints = candidates[0], candidates[0] == _JOINTS
            if len(candidates) > 1 and "ik_ok" not in names:
                warnings.append(f"holds {_JOINTS} and {_POSES}: {_JOINTS} was read ($poses {_POSES} reads the poses)")
        return RawTrajectory(
            **{"q" if is_joints else "X_BG": archive[name]},
            **{key: archive[key] if key in names else None for key in ("t_s", "tracked", "finger_width_m")},
            columns=name,
            warnings=tuple(warnings),
        )


def _list_arrays(names: list[str]) -> str:
    return f"the arrays {', '.join(names[:12])}" if names else "no array"


TIME, WIDTH = "t_s", "finger_width_m"
POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
JOINTS = tuple(f"q{j}_rad" for j in range(1, 8))
_NUMERIC = (*JOINTS, *POSE, TIME, WIDTH)
_EXPECTED = f"{TIME} and {','.join(POSE)} or {JOINTS[0]}..{JOINTS[-1]}"


def read_csv(sample: TrajectorySample, choice: TrajectoryOptions) -> RawTrajectory:
    """Read `t_s` with x_m, y_m, z_m, qw, qx, qy, qz or with q1_rad .. q7_rad; columns in any order.

    If both are present the joint angles are read, or the kind that `choice` names (by any name). Unknown columns give
    a warning.

    Raises:
        InputError: the file is not such a table; the message names the line.
    """
    if not sample.path.stat().st_size:
        raise InputError("the file is empty (0 bytes)")
    header, rows = _rows(sample.path)
    reading = _find_columns(header, choice)
    return reading.apply(rows, rows[:, header.index(TIME)] if TIME in header else None)


def _find_columns(header: Sequence[str], choice: TrajectoryOptions) -> Reading:
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise InputError(f"the header names {', '.join(repeated)} more than once")
    complete = [group for group in (JOINTS, POSE) if set(group) <= set(header)]
    wanted = JOINTS if choice.joints else POSE if choice.poses else complete[0] if complete else None
    if wanted is None or wanted not in complete:
        partial = wanted or next((g for g in (JOINTS, POSE) if set(g) & set(header)), ())
        lacking = f", lacks {', '.join(n for n in partial if n not in header)}" if partial else ""
        raise InputError(f"the header has {', '.join(header[:12]) or 'no name'}{lacking}; expected {_EXPECTED}")
    warnings = []
    if len(complete) > 1:
        warnings.append(f"holds joint angles and poses: {wanted[0]}..{wanted[-1]} were read")
    unread = [name for name in header if name not in _NUMERIC]
    if unread:
        warnings.append(f"columns {', '.join(unread[:12])} are not read")
    return Reading(
        layout=Layout.JOINTS if wanted is JOINTS else Layout.QUATERNION,
        indices=tuple(map(header.index, wanted)),
        width=header.index(WIDTH) if WIDTH in header else None,
        description=",".join(wanted),
        warnings=tuple(warnings),
    )


def _rows(path: Path) -> tuple[list[str], Array]:
    """Return the names of the header and the numbers (T, columns)."""
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            for fields in reader:
                if any(field.strip() for field in fields):
                    rows.append(_numbers(fields, header, reader.line_num))
                if len(rows) > MAX_FRAMES:
                    raise InputError(f"has more than {MAX_FRAMES} frames: cut it into parts")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read as a comma-separated text ({cause(error)})") from None
    if len(header) == 1 and (";" in header[0] or "\t" in header[0]):
        raise InputError("the names of the header are not separated by commas, expected a comma-separated table")
    return header, np.reshape(np.array(rows, dtype=np.float64), (len(rows), len(header)))


def _numbers(fields: list[str], header: list[str], line: int) -> list[float]:
    if len(fields) != len(header):
        raise InputError(f"line {line} has {len(fields)} fields, the header {len(header)}")
    numbers = []
    for name, text in zip(header, fields, strict=True):
        try:
            numbers.append(float(text))
        except ValueError:
            if name in _NUMERIC and (text.strip() or name != WIDTH):
                raise InputError(f"line {line}: {name} is {text.strip()!r:.40}, expected a number") from None
            numbers.append(np.nan)  # an unknown column, or a missing width
    return numbers
