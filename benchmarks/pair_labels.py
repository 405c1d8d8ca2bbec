"""Generated clips beside real ones, labelled by eye in two passes: faults, and frames that differ from the real ones.

`pair_labels.json` holds for each pass, clip and exterior view the stretches of frames (inclusive) of the generated row
that no robot could show, by kind of anomaly; that show the gripper clearly elsewhere or otherwise turned than the real
row, by about half of its width or 20 degrees; and that cannot be compared, since it is hidden or out of the picture in
either row. The second pass was made without the first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.io.jsonl import as_object, read_json

LABELS = Path(__file__).with_name("pair_labels.json")


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewLabels:
    """Labels of one view of a clip by one pass."""

    kinds: frozenset[AnomalyKind]
    """Kinds of anomaly in any frame."""
    differs: frozenset[int]
    """Frames that differ from the real ones."""
    not_comparable: frozenset[int]
    """Frames that cannot be compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairLabels:
    """Labels of both passes."""

    frames: int
    """Frames of each clip."""
    passes: tuple[Mapping[str, ViewLabels], ...]
    """By clip and view, such as `ckpt100k_sample00000 ext1`."""


def read_pair_labels(path: Path = LABELS) -> PairLabels:
    """Read the labels."""
    data: Any = as_object(read_json(path))
    return PairLabels(
        frames=int(data["frames"]),
        passes=tuple(
            {f"{clip} {view}": _view_labels(own) for clip, views in one.items() for view, own in views.items()}
            for one in data["passes"]
        ),
    )


def _view_labels(data: Mapping[str, Any]) -> ViewLabels:
    return ViewLabels(
        kinds=frozenset(AnomalyKind(kind) for kind, _, _ in data["faults"]),
        differs=_frames(data["differs"]),
        not_comparable=_frames(data["not_comparable"]),
    )


def _frames(stretches: Sequence[Sequence[int]]) -> frozenset[int]:
    return frozenset(frame for first, last in stretches for frame in range(first, last + 1))
