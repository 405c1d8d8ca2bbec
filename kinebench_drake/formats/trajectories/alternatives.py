"""Other readings of a trajectory's numbers, which people mean where a file does not say it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product

from kinebench_drake.formats.trajectories.reading import ANGLES, JOINTS, LAYOUTS, LENGTHS, TIMES, Reading

_UNITS = {"length": LENGTHS, "angle": ANGLES, "time_unit": TIMES}
_NOUNS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "deg": "degrees", "rad": "radians"}
_NOUNS |= {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "s": "seconds"}
UNIT_COST = 0.05
"""Cost of one other unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternative:
    """One other reading."""

    name: str
    """What the numbers would be."""
    cost: float
    """How much better it must fit than the reading by the names: the less usual, the more."""
    change: Mapping[str, object] = field(default_factory=dict)
    """Keys that differ."""
    fits_frame: bool = False
    """True if `base_from_world` is fitted to the poses."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that it changes."""
        return ("base_from_world",) if self.fits_frame else tuple(self.change)


ALTERNATIVES = (
    Alternative(name="rotation vectors", cost=0.05, change={"layout": "rotation_vector"}),
    *(
        Alternative(name=f"Euler angles {order}", cost=0.15, change={"layout": f"euler_{order}"})
        for order in ("xyz", "zyx", "XYZ", "ZYX")
    ),
    Alternative(name="quaternions x y z w", cost=0.15, change={"layout": "quaternion_xyzw"}),
    Alternative(name="quaternions w x y z", cost=0.15, change={"layout": "quaternion_wxyz"}),
    Alternative(name="matrices by columns", cost=0.05, change={"layout": "matrix_columns"}),
    Alternative(name="matrices by rows", cost=0.05, change={"layout": "matrix_rows"}),
    Alternative(name="poses of the flange", cost=0.05, change={"tool": "flange"}),
    Alternative(name="changes from frame to frame", cost=0.3, change={"deltas": True}),
    *(
        Alternative(name=f"poses in the world of {world}", cost=0.15, change={"base_from_world": offset})
        for world, offset in {
            "LIBERO (base at -0.66 0 0.912)": (0.66, 0.0, -0.912),  # mounted Panda, table arenas
            "robosuite (base at -0.56 0 0.912)": (0.56, 0.0, -0.912),  # table of 0.8 m
            "ManiSkill (base at -0.615 0 0)": (0.615, 0.0, 0.0),  # table scenes
        }.items()
    ),
    Alternative(name="poses in a frame other than the robot's base", cost=0.6, fits_frame=True),
)
"""All but those of other units."""


def alternatives(reading: Reading) -> Iterator[Alternative]:
    """Yield the alternatives that a complete reading has: layouts of as many numbers, other units and frames."""
    is_pose = reading.layout != JOINTS
    sizes = set(LAYOUTS[reading.layout or JOINTS])
    for alternative in ALTERNATIVES:
        layout = alternative.change.get("layout")
        if not is_pose and layout is None and alternative.change != {"deltas": True}:
            continue
        if isinstance(layout, str) and (layout == reading.layout or not sizes & set(LAYOUTS[layout])):
            continue
        if any(getattr(reading, key) == value for key, value in alternative.change.items()):
            continue
        yield alternative
    for units in product(*_UNITS.values()):
        present = reading.keys(_UNITS)
        change = {key: unit for key, unit in zip(_UNITS, units, strict=True) if unit != present[key]}
        if change and (is_pose or "length" not in change) and (reading.time is not None or "time_unit" not in change):
            yield Alternative(
                name=", ".join(_NOUNS[unit] for unit in change.values()), cost=UNIT_COST * len(change), change=change
            )
