"""A trajectory as `audit` reads it, and what is known about it."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import dump
from kinebench_drake.io.npz import pack_arrays
from kinebench_drake.types import Json, ViolationKind

TRUTH = "truth.jsonl"
"""Name of the file beside the trajectories that tells what each of them is."""


class Kind(Enum):
    """What is known about a trajectory."""

    FEASIBLE = "feasible"
    REACH = "reach"
    FAST = "fast"
    TABLE = "table"
    TELEPORT = "teleport"
    LIMIT_Q = "limit_q"
    SELF_Q = "self_q"
    LIMIT_POSE = "limit_pose"
    PERTURBED = "perturbed"
    NOISY = "noisy"


REASONS: Mapping[Kind, tuple[ViolationKind, ...]] = {
    Kind.REACH: (ViolationKind.UNREACHABLE,),
    Kind.FAST: (ViolationKind.VELOCITY,),
    Kind.TABLE: (ViolationKind.TABLE_COLLISION,),
    Kind.TELEPORT: (ViolationKind.DISCONTINUITY,),
    Kind.LIMIT_Q: (ViolationKind.JOINT_LIMIT,),
    Kind.SELF_Q: (ViolationKind.SELF_COLLISION,),
    Kind.LIMIT_POSE: (ViolationKind.JOINT_LIMIT,),
}
"""Violations of which one must be named, for each planted kind."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """What one file holds."""

    t_s: Array
    """(T,) times [s]."""
    X_BG: Array
    """(T, 4, 4) poses of the TCP in the base [m]; NaN where not tracked."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""
    q: Array | None = None
    """(T, 7) joint angles [rad] of a trajectory that is given in joints; its poses are then not written."""
    tracked: NDArray[np.bool_] | None = None
    """(T,) frames that are known, of a trajectory written as grounding writes its tracks; None: all."""

    def to_bytes(self) -> bytes:
        """The npz file, the same bytes for the same numbers."""
        arrays: dict[str, NDArray[np.generic]] = {"t_s": self.t_s, "finger_width_m": self.finger_width_m}
        if self.q is not None:
            arrays["q"] = self.q
        else:
            arrays["base_from_tcp"] = self.X_BG
        if self.tracked is not None:
            n = len(self.t_s)
            arrays |= {
                "tracked": self.tracked,
                "confidence": self.tracked.astype(np.float64),
                "camera_from_hand": np.full((n, 4, 4), np.nan),
                "q": np.full((n, 7), np.nan),
                "ik_ok": np.zeros(n, dtype=bool),
            }
        return pack_arrays(arrays)


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What is known about one trajectory."""

    id: str
    """Name of the file without its suffix."""
    kind: Kind
    family: str
    """How it was drawn, or the motion it was planted into."""
    reasons: tuple[ViolationKind, ...] = ()
    """Violations of which one must be named; none for a feasible trajectory."""
    parameters: Mapping[str, Json] = field(default_factory=dict)
    """Sizes, places, and the figures of the proof."""

    @property
    def feasible(self) -> bool | None:
        """Whether the arm can do it; None where nobody knows."""
        if self.kind in (Kind.FEASIBLE, Kind.NOISY):
            return True
        return None if self.kind is Kind.PERTURBED else False

    def to_json(self) -> dict[str, Json]:
        """The object as written."""
        return {
            "id": self.id,
            "kind": self.kind.value,
            "family": self.family,
            "feasible": self.feasible,
            "reasons": [reason.value for reason in self.reasons],
            "parameters": dict(self.parameters),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Json]) -> "Truth":
        """What `to_json` wrote.

        Raises:
            InputError: a key is absent or its value unknown.
        """
        try:
            reasons, parameters = data["reasons"], data["parameters"]
            if not isinstance(reasons, list) or not isinstance(parameters, dict):
                raise ValueError("reasons is a list, parameters an object")
            return cls(
                id=str(data["id"]),
                kind=Kind(data["kind"]),
                family=str(data["family"]),
                reasons=tuple(ViolationKind(reason) for reason in reasons),
                parameters=parameters,
            )
        except (KeyError, ValueError) as error:
            raise InputError(f"not a line of {TRUTH} ({error})") from None


def write_truth(path: Path, truths: Iterable[Truth]) -> None:
    """Write one line a trajectory, by id."""
    lines = [dump(truth.to_json()) for truth in sorted(truths, key=lambda truth: truth.id)]
    write_atomically(path, "".join(lines).encode())


def read_truth(path: Path) -> dict[str, Truth]:
    """Truths by id.

    Raises:
        InputError: the file is absent or damaged.
    """
    try:
        truths = [Truth.from_json(json.loads(line)) for line in path.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name}: cannot be read ({cause(error)})") from None
    return {truth.id: truth for truth in truths}
