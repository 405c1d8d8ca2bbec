"""A trajectory as `audit` reads it, and its ground truth."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from kinebench_drake.errors import InputError, cause
from kinebench_drake.geometry import Array, rotation_exp
from kinebench_drake.io.jsonl import Json, write_lines
from kinebench_drake.io.npz import pack_arrays
from kinebench_drake.violation import ViolationKind

TRUTH = "truth.jsonl"
"""Name of the file with the ground truth, beside the trajectories."""


class TrajectoryKind(Enum):
    """Ground truth about a trajectory: feasible, or the planted fault."""

    FEASIBLE = "feasible"
    REACH = "reach"
    FAST = "fast"
    TABLE = "table"
    TELEPORT = "teleport"
    LIMIT_Q = "limit_q"
    SELF_Q = "self_q"
    LIMIT_POSE = "limit_pose"
    NOISY = "noisy"


REASONS: Mapping[TrajectoryKind, tuple[ViolationKind, ...]] = {
    TrajectoryKind.REACH: (ViolationKind.UNREACHABLE,),
    TrajectoryKind.FAST: (ViolationKind.VELOCITY,),
    TrajectoryKind.TABLE: (ViolationKind.TABLE_COLLISION,),
    TrajectoryKind.TELEPORT: (ViolationKind.DISCONTINUITY,),
    TrajectoryKind.LIMIT_Q: (ViolationKind.JOINT_LIMIT,),
    TrajectoryKind.SELF_Q: (ViolationKind.SELF_COLLISION,),
    TrajectoryKind.LIMIT_POSE: (ViolationKind.JOINT_LIMIT,),
}
"""Violations of which an audit must name one, for each planted fault."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Content of one trajectory file."""

    t_s: Array
    """(T,) times [s]."""
    X_BG: Array
    """(T, 4, 4) poses of the TCP in the base [m]."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""
    q: Array | None = None
    """(T, 7) joint angles [rad]; if present they are written instead of the poses."""

    def to_bytes(self) -> bytes:
        """Return the npz file; equal numbers give equal bytes."""
        motion = {"base_from_tcp": self.X_BG} if self.q is None else {"q": self.q}
        return pack_arrays({"t_s": self.t_s, "finger_width_m": self.finger_width_m, **motion})


def add_noise(rng: np.random.Generator, trajectory: Trajectory, position_m: float, rotation_rad: float) -> Trajectory:
    """Add white noise to the poses: standard deviations along each axis of B [m] and about each axis of G [rad]."""
    n = len(trajectory.t_s)
    X = trajectory.X_BG.copy()
    X[:, :3, 3] += position_m * rng.normal(size=(n, 3))
    X[:, :3, :3] = X[:, :3, :3] @ rotation_exp(rotation_rad * rng.normal(size=(n, 3)))
    return replace(trajectory, X_BG=X, q=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryTruth:
    """Ground truth of one trajectory."""

    id: str
    """Name of the file without its suffix."""
    kind: TrajectoryKind
    family: str
    """How the motion was drawn."""
    reasons: tuple[ViolationKind, ...] = ()
    """Violations of which an audit must name one; empty for a feasible trajectory."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Sizes and places of the fault, and figures of the proof."""

    @property
    def feasible(self) -> bool:
        """True if the arm can execute it."""
        return self.kind in (TrajectoryKind.FEASIBLE, TrajectoryKind.NOISY)

    def to_json(self) -> dict[str, Json]:
        """Return the object as written."""
        return {
            "id": self.id,
            "kind": self.kind.value,
            "family": self.family,
            "feasible": self.feasible,
            "reasons": [reason.value for reason in self.reasons],
            "parameters": dict(self.parameters),
        }


def write_truths(path: Path, truths: Iterable[TrajectoryTruth]) -> None:
    """Write one line a trajectory, sorted by id."""
    write_lines(path, [truth.to_json() for truth in sorted(truths, key=lambda truth: truth.id)])


def read_truths(path: Path) -> dict[str, TrajectoryTruth]:
    """Read ground truths by id.

    Raises:
        InputError: the file is absent or damaged.
    """
    try:
        adapter = TypeAdapter(TrajectoryTruth)
        truths = [adapter.validate_json(line) for line in path.read_bytes().splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name}: cannot be read ({cause(error)})") from None
    return {truth.id: truth for truth in truths}
