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

from benchmarks.markdown import table
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


def compare_passes(labels: PairLabels) -> str:
    """Return a table of the agreement of the passes: views with a kind of anomaly, and frames that differ.

    Kappa is the agreement beyond chance (Cohen, Educational and Psychological Measurement 20, 1960).
    """
    first, second = labels.passes
    rows = []
    for kind in AnomalyKind:
        counts = _counts([(kind in first[view].kinds, kind in second[view].kinds) for view in first])
        if sum(counts[:3]):
            rows.append((f"views with `{kind.value}`", *map(str, counts), f"{_kappa(counts):.2f}"))
    marks = [
        (frame in first[view].differs, frame in second[view].differs)
        for view in first
        for frame in range(labels.frames)
        if frame not in first[view].not_comparable | second[view].not_comparable
    ]
    counts = _counts(marks)
    rows.append(("frames that differ", *map(str, counts), f"{_kappa(counts):.2f}"))
    return "\n".join(table(("", "both", "first only", "second only", "neither", "kappa"), rows)) + "\n"


def _view_labels(data: Mapping[str, Any]) -> ViewLabels:
    return ViewLabels(
        kinds=frozenset(AnomalyKind(kind) for kind, _, _ in data["faults"]),
        differs=_frames(data["differs"]),
        not_comparable=_frames(data["not_comparable"]),
    )


def _frames(stretches: Sequence[Sequence[int]]) -> frozenset[int]:
    return frozenset(frame for first, last in stretches for frame in range(first, last + 1))


def _counts(marks: Sequence[tuple[bool, bool]]) -> tuple[int, int, int, int]:
    """Return how often both, the first, the second and neither are set."""
    both, first, second = (marks.count(pair) for pair in ((True, True), (True, False), (False, True)))
    return both, first, second, len(marks) - both - first - second


def _kappa(counts: tuple[int, int, int, int]) -> float:
    both, first, second, neither = counts
    total = sum(counts)
    shares = (both + first) / total, (both + second) / total
    chance = shares[0] * shares[1] + (1 - shares[0]) * (1 - shares[1])
    return ((both + neither) / total - chance) / (1 - chance) if chance < 1 else 1.0
