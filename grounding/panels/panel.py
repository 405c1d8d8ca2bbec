"""Panels of a tiled frame: rectangle, kind, place by name, and the choice of one."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json
from kinebench_drake.view_name import AUTO_VIEW

_CENTRED = 0.1
"""Largest distance of a centre from that of the frame that still counts as the middle, over the side of the frame."""


class PanelKind(Enum):
    """What a panel shows."""

    EXTERIOR = "exterior"
    """A robot, from outside."""
    WRIST = "wrist"
    """The view of a camera on the hand: most of it moves."""
    EMPTY = "empty"
    """One colour."""
    TEXT = "text"
    NO_ROBOT = "no_robot"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rectangle:
    """Part of a frame [px]."""

    left: int
    top: int
    width: int
    height: int

    def crop(self, frames: Frames) -> Frames:
        """Return this part of frames (T, H, W, 3)."""
        part: Frames = frames[:, self.top : self.top + self.height, self.left : self.left + self.width]
        return part

    def within(self, outer: "Rectangle") -> "Rectangle":
        """Return the rectangle in the frame, if it is stated relative to `outer`."""
        return Rectangle(left=self.left + outer.left, top=self.top + outer.top, width=self.width, height=self.height)


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel of the frames of a video."""

    rectangle: Rectangle
    kind: PanelKind
    number: int | None
    """Place in the reading order, from 1; None for text, which is not counted."""
    name: str | None
    """Place in words, such as `top-left`; None for text, and where several panels would have the same one."""
    robot_px: float = 0.0
    """Mean number of pixels that show the arm [px]."""

    @property
    def label(self) -> str:
        """Name, else number."""
        return self.name or str(self.number)

    def to_json(self) -> dict[str, Json]:
        """Serialize the panel for results."""
        r = self.rectangle
        place: dict[str, Json] = {"left_px": r.left, "top_px": r.top, "width_px": r.width, "height_px": r.height}
        return {"number": self.number, "name": self.name, "kind": self.kind.value, **place}


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelChoice:
    """The panels of a video, and the one that is measured."""

    panels: tuple[Panel, ...]
    panel: Panel

    def to_json(self) -> dict[str, Json]:
        """Serialize the choice for results."""
        return {"view": self.panel.label, "panels": [panel.to_json() for panel in self.panels]}


def sort_panels(rectangles: Sequence[Rectangle]) -> list[Rectangle]:
    """Return rectangles in reading order: by rows, and within a row from left to right.

    A rectangle belongs to the row of the uppermost one if it begins above the middle of that one.
    """
    rows: list[list[Rectangle]] = []
    for r in sorted(rectangles, key=lambda r: (r.top, r.left)):
        if rows and 2 * (r.top - rows[-1][0].top) < rows[-1][0].height:
            rows[-1].append(r)
        else:
            rows.append([r])
    return [r for row in rows for r in sorted(row, key=lambda r: r.left)]


def name_places(rectangles: Sequence[Rectangle]) -> list[str | None]:
    """Return the place of each of the rectangles in the area that all of them cover; None where it is not unique."""
    left = min(r.left for r in rectangles)
    top = min(r.top for r in rectangles)
    right = max(r.left + r.width for r in rectangles)
    bottom = max(r.top + r.height for r in rectangles)
    names = []
    for r in rectangles:
        row = _place(r.top - top, r.height, bottom - top, ("top", "middle", "bottom"))
        column = _place(r.left - left, r.width, right - left, ("left", "middle", "right"))
        names.append("-".join(dict.fromkeys(part for part in (row, column) if part)))
    counts = Counter(names)
    return [name if name and counts[name] == 1 else None for name in names]


def _place(start: int, length: int, total: int, words: tuple[str, str, str]) -> str:
    """Return the word for the place of a stretch in another one; empty if it fills more than half of it, centred."""
    offset = (start + 0.5 * length) / total - 0.5
    if abs(offset) <= _CENTRED:
        return "" if 2 * length > total else words[1]
    return words[0] if offset < 0.0 else words[2]


def choose_panel(panels: Sequence[Panel], view: str) -> Panel:
    """Return the panel that a view names by number or place; of `auto` the exterior one that shows most of the robot.

    Raises:
        InputError: no panel has this name.
        UnmeasurableError: no panel shows a robot from outside.
    """
    counted = [panel for panel in panels if panel.number is not None]
    labels = ", ".join(
        f"{p.number}{f' or {p.name}' if p.name else ''} ({p.kind.value.replace('_', ' ')})" for p in counted
    )
    if view != AUTO_VIEW:
        named = [panel for panel in counted if view in (str(panel.number), panel.name)]
        if not named:
            raise InputError(
                f"$view {view}: the frames have {len(counted)} panels, {labels}; name one of them, or auto"
            )
        return named[0]
    exterior = [panel for panel in counted if panel.kind is PanelKind.EXTERIOR]
    if not exterior:
        raise UnmeasurableError(
            f"the frames have {len(counted)} panels, none of which shows a robot from outside: {labels}; $view names "
            "the one to measure all the same"
        )
    return max(exterior, key=lambda panel: panel.robot_px)
