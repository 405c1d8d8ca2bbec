"""Recordings of clean and of faulty motions, stored as recorders store them, and what an audit makes of them.

Each motion of `trajectory_sets` is stored in one of twelve ways (`Storage`), the ways in turn. Of some the file can
tell what its numbers are (`Storage.decidable`): these should be judged. Of the others no file can: they may be refused,
but not be judged as what they are not.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.feasible import draw_feasible
from benchmarks.markdown import percent, table
from benchmarks.motion import Arm
from benchmarks.planted import PLANTERS
from benchmarks.trajectory import REASONS, Trajectory, TrajectoryKind
from benchmarks.trials import run_all
from kinebench_drake.formats.trajectories.reading import TOOLS
from kinebench_drake.geometry import Array, invert, to_quaternion
from kinebench_drake.io.jsonl import as_object, read_lines, write_lines
from kinebench_drake.results.row import SampleRow

TRUTH = "recordings.jsonl"
"""Name of the file with the ground truth, beside the recordings."""

_HOLD = 3
"""Rows of a log for each measured state."""
_EPISODES = 3
"""Episodes in one file: the motion, and clean ones after it."""
_ZERO_ROWS = 2
"""Rows of zeros before a recorder has its first state."""
_EPOCH_S = 1_700_000_000
"""Time of the first row where clocks count from 1970 [s]."""
_DEFAULT_Q = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
"""Posture whose joint angles are taken off: Franka's ready pose [rad]."""
_SHUFFLED = (2, 0, 6, 4, 1, 5, 3)
"""Joint, from 0, of each column of a message with an order of its own."""


class Storage(Enum):
    """How a recorder stores a motion."""

    HELD = "held"
    ROUNDED = "rounded"
    FLOAT16 = "float16"
    WRAPPED = "wrapped"
    ZEROS = "zeros"
    NANOSECONDS = "nanoseconds"
    FLANGE = "flange"
    QUATERNION_ORDER = "quaternion order"
    ALPHABETICAL = "alphabetical joints"
    OFFSETS = "offsets"
    EPISODES = "several episodes"
    SHUFFLED = "shuffled names"

    @property
    def decidable(self) -> bool:
        """True if the file can tell what its numbers are."""
        return self in (
            Storage.HELD,
            Storage.ROUNDED,
            Storage.FLOAT16,
            Storage.WRAPPED,
            Storage.ZEROS,
            Storage.NANOSECONDS,
            Storage.EPISODES,
        )

    @property
    def of_joints(self) -> bool:
        """True if it is a way to store joint angles."""
        return self in (Storage.WRAPPED, Storage.ALPHABETICAL, Storage.OFFSETS, Storage.SHUFFLED)

    @property
    def of_poses(self) -> bool:
        """True if it is a way to store poses."""
        return self in (Storage.FLANGE, Storage.QUATERNION_ORDER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """Ground truth of one file."""

    file: str
    storage: Storage
    kind: TrajectoryKind
    """Of its first episode; others are clean."""

    def to_json(self) -> dict[str, object]:
        """Return the object as written."""
        return {"file": self.file, "storage": self.storage.value, "kind": self.kind.value}


class _Writer:
    """Draws and stores one motion after the other."""

    def __init__(self, seed: int, faulty: bool, out: Path) -> None:
        self._seed = seed
        self._faulty = faulty
        self._out = out
        self._arm = Arm()

    def __call__(self, index: int) -> Recording:
        storage = list(Storage)[index % len(Storage)]
        rng = np.random.default_rng([self._seed, self._faulty, index])
        kind, trajectory = self._draw(rng, storage, index // len(Storage))
        file = f"{'planted' if self._faulty else 'clean'}-{index:05d}.csv"
        others = []
        if storage is Storage.EPISODES:
            others = [self._clean(rng, joints=trajectory.q is not None) for _ in range(_EPISODES - 1)]
        header, rows = store(storage, trajectory, others)
        decimals = 2 if trajectory.q is not None else 3
        form = {Storage.FLOAT16: "%.5f", Storage.ROUNDED: f"%.{decimals}f"}.get(storage, "%.9g")
        forms = ["%.9f", *[form] * (rows.shape[1] - 1)]
        if storage is Storage.NANOSECONDS:
            forms[:2] = ["%d", "%d"]
        elif storage is Storage.EPISODES:
            forms[1] = "%d"
        np.savetxt(self._out / file, rows, delimiter=",", header=header, comments="", fmt=forms)
        return Recording(file=file, storage=storage, kind=kind)

    def _draw(self, rng: np.random.Generator, storage: Storage, turn: int) -> tuple[TrajectoryKind, Trajectory]:
        joints = storage.of_joints or (not storage.of_poses and turn % 2 == 0)
        if not self._faulty:
            return TrajectoryKind.FEASIBLE, self._clean(rng, joints=joints)
        of_joints = (TrajectoryKind.LIMIT_Q, TrajectoryKind.SELF_Q)
        kinds = [kind for kind in PLANTERS if (kind in of_joints) is joints]
        kind = kinds[turn // (1 if storage.of_joints or storage.of_poses else 2) % len(kinds)]
        while True:
            planted = PLANTERS[kind](rng, self._arm, draw_feasible(rng, self._arm))
            if planted is not None:
                return kind, planted.trajectory

    def _clean(self, rng: np.random.Generator, *, joints: bool) -> Trajectory:
        trajectory = draw_feasible(rng, self._arm).trajectory(self._arm)
        q = trajectory.q if joints else None
        return Trajectory(t_s=trajectory.t_s, X_BG=trajectory.X_BG, finger_width_m=trajectory.finger_width_m, q=q)


def store(storage: Storage, trajectory: Trajectory, others: Sequence[Trajectory] = ()) -> tuple[str, Array]:
    """Return the header and the rows (T, N) of a table, times first."""
    t_s = trajectory.t_s
    period_s = float(np.median(np.diff(t_s)))
    values = _values(storage, trajectory)
    if trajectory.q is not None:
        names = [f"joint_{k}" for k in range(1, 8)]
    elif storage.decidable:  # names that state the frame
        names = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    else:
        names = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    names.append("gripper_width")
    times = ["t_s"]
    if storage is Storage.HELD:
        values = np.repeat(values, _HOLD, axis=0)
        t_s = np.asarray(period_s / _HOLD * np.arange(len(values)), dtype=np.float64)
    elif storage is Storage.ZEROS:
        values = np.vstack([np.zeros((_ZERO_ROWS, values.shape[1])), values])
        t_s = np.asarray(period_s * np.arange(len(values)), dtype=np.float64)
    elif storage is Storage.FLOAT16:
        values = values.astype(np.float16).astype(np.float64)
    elif storage is Storage.WRAPPED:
        values = (values + np.pi) % (2 * np.pi) - np.pi
    elif storage is Storage.ALPHABETICAL:  # panda_finger_joint1, panda_finger_joint2, panda_joint1, ...
        values = np.hstack([np.repeat(0.5 * values[:, 7:], 2, axis=1), values[:, :7]])
        names = [f"position_{k}" for k in range(9)]
    elif storage is Storage.SHUFFLED:
        values = values[:, [*_SHUFFLED, 7]]
        names = [names[k] for k in (*_SHUFFLED, 7)]
    elif storage is Storage.OFFSETS:
        values[:, :7] -= _DEFAULT_Q
    elif storage is Storage.NANOSECONDS:
        seconds = np.floor(t_s)
        times = ["secs", "nsecs"]
        t_s = np.column_stack([_EPOCH_S + seconds, np.round((t_s - seconds) * 1e9)])
    elif storage is Storage.EPISODES:
        parts = [trajectory, *others]
        times = ["t_s", "episode_index"]
        t_s = np.concatenate([np.column_stack([part.t_s, np.full(len(part.t_s), k)]) for k, part in enumerate(parts)])
        values = np.concatenate([_values(storage, part) for part in parts])
    return ",".join([*times, *names]), np.column_stack([t_s, values])


def _values(storage: Storage, trajectory: Trajectory) -> Array:
    """Return the joint angles, or positions and quaternions, and the gap of the fingers (T, 8)."""
    width = trajectory.finger_width_m[:, None]
    if trajectory.q is not None:
        return np.hstack([trajectory.q, width])
    X_BG = trajectory.X_BG
    if storage is Storage.FLANGE:
        X_BG = X_BG @ invert(TOOLS["flange"])
    quaternion = to_quaternion(X_BG[:, :3, :3])
    if storage is Storage.QUATERNION_ORDER:  # named wxyz, stored xyzw
        quaternion = quaternion[:, [1, 2, 3, 0]]
    return np.hstack([X_BG[:, :3, 3], quaternion, width])


def write_recordings(out: Path, count: int, seed: int, jobs: int) -> Iterator[Recording]:
    """Store `count` clean motions and as many faulty ones in a folder, with their ground truth; yield each.

    Raises:
        KinebenchError: a worker died.
    """
    out.mkdir(parents=True, exist_ok=True)
    truths: list[Recording] = []
    for faulty in (False, True):
        for truth in run_all(partial(_Writer, seed, faulty, out), range(count), jobs):
            truths.append(truth)
            yield truth
    write_lines(out / TRUTH, [truth.to_json() for truth in sorted(truths, key=lambda truth: truth.file)])


def read_recordings(out: Path) -> list[Recording]:
    """Read the ground truth of a folder."""
    return [
        Recording(file=str(row["file"]), storage=Storage(row["storage"]), kind=TrajectoryKind(row["kind"]))
        for row in read_lines(out / TRUTH, as_object)
    ]


def recordings_table(rows: Sequence[SampleRow], truths: Sequence[Recording]) -> list[str]:
    """Return a table of verdicts by storage: clean and faulty motions judged, false and missed ones."""
    by_file: dict[str, list[SampleRow]] = {}
    for row in sorted(rows, key=lambda row: row.id):
        by_file.setdefault(Path(row.video).name.partition("#")[0], []).append(row)
    lines = []
    for storage in Storage:
        clean = [by_file.get(t.file, []) for t in truths if t.storage is storage and t.kind is TrajectoryKind.FEASIBLE]
        planted = [(t, by_file.get(t.file, [])) for t in truths if t.storage is storage and t.kind in REASONS]
        first = [own[0] if own else None for _, own in planted]
        lines.append((storage, *_count_clean(clean), *_count_planted(planted, first)))
    head = ("stored as", "clean judged", "false infeasible", "planted judged", "detected", "of those judged")
    return table(head, [_cells(line) for line in lines])


def _count_clean(clean: Sequence[Sequence[SampleRow]]) -> tuple[int, int, int]:
    judged = sum(bool(own) and all(row.feasible is not None for row in own) for own in clean)
    false = sum(any(row.feasible is False for row in own) for own in clean)
    return len(clean), judged, false


def _count_planted(
    planted: Sequence[tuple[Recording, Sequence[SampleRow]]], first: Sequence[SampleRow | None]
) -> tuple[int, int, int]:
    judged = sum(row is not None and row.feasible is not None for row in first)
    detected = sum(row is not None and row.feasible is False for row in first)
    return len(planted), judged, detected


def _cells(line: tuple[Storage, int, int, int, int, int, int]) -> tuple[str, ...]:
    storage, clean, judged, false, planted, planted_judged, detected = line
    share = detected / planted_judged if planted_judged else float("nan")
    return (
        storage.value,
        f"{judged} of {clean}",
        str(false),
        f"{planted_judged} of {planted}",
        str(detected),
        percent(share),
    )
