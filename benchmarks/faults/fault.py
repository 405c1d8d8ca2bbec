"""Kinds, forms and sizes of faults."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import UsageError
from kinebench_drake.io.jsonl import Json


class FaultForm(Enum):
    """Course of a fault in time, for kinds with several."""

    SHAKE = "shake"
    """Random rotation of the camera."""
    DRIFT = "drift"
    """Linear sideways motion of the camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedFault:
    """Fault planted into a clip."""

    kind: AnomalyKind
    """Kind of the fault."""
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    size: float
    """Frames without gripper (vanish) or frozen (freeze), metres apart (duplicate_gripper), jumped (teleport) or opened
    and closed (finger_opening), relative stretch (deformation), pixels (camera_motion)."""
    form: FaultForm | None = None
    """Course in time, for kinds with several."""

    def to_json(self) -> dict[str, Json]:
        """Return the JSON object."""
        return {
            "kind": self.kind.value,
            "frame_start": self.frame_start,
            "frame_end": self.frame_end,
            "size": self.size,
            "form": None if self.form is None else self.form.value,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultGrades:
    """Graded sizes of a kind of fault."""

    sizes: tuple[float, ...]
    """Sizes from barely visible to obvious, in the unit of `PlantedFault.size`."""
    gate: float
    """Smallest size that a detector must find."""
    unit: str
    """Unit of `label`."""
    factor: float
    """Factor from sizes to that unit."""
    forms: tuple[FaultForm | None, ...] = (None,)
    """Courses in time."""

    def label(self, size: float) -> str:
        """Return a size with its unit, safe in a file name."""
        return f"{size * self.factor:g}{self.unit}"


GRADES: dict[AnomalyKind, FaultGrades] = {
    AnomalyKind.VANISH: FaultGrades(sizes=(1, 2, 3, 5, 10), gate=3, unit="f", factor=1),
    AnomalyKind.DUPLICATE: FaultGrades(sizes=(0.1, 0.15, 0.25), gate=0.15, unit="cm", factor=100),
    AnomalyKind.TELEPORT: FaultGrades(sizes=(0.02, 0.05, 0.1, 0.15), gate=0.05, unit="cm", factor=100),
    AnomalyKind.FREEZE: FaultGrades(sizes=(3, 5, 8), gate=5, unit="f", factor=1),
    AnomalyKind.DEFORMATION: FaultGrades(sizes=(0.05, 0.1, 0.2, 0.3), gate=0.2, unit="pc", factor=100),
    AnomalyKind.CAMERA: FaultGrades(
        sizes=(1, 2, 4, 8), gate=2, unit="px", factor=1, forms=(FaultForm.SHAKE, FaultForm.DRIFT)
    ),
    AnomalyKind.FINGERS: FaultGrades(sizes=(0.01, 0.02, 0.04, 0.06), gate=0.04, unit="mm", factor=1000),
}
"""Grades of each kind. The gripper is about 0.2 m wide; its fingers open by up to 0.08 m."""


def unit_of(kind: AnomalyKind) -> str:
    """Return the unit in which sizes of a kind are shown."""
    unit = GRADES[kind].unit
    return {"f": "frames", "pc": "%"}.get(unit, unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultGrade:
    """Kind, size and form of a fault."""

    kind: AnomalyKind
    size: float
    """In the unit of `PlantedFault.size`."""
    form: FaultForm | None

    @property
    def label(self) -> str:
        """Name, safe in a file name, such as "camera_motion_shake_2px"."""
        form = "" if self.form is None else f"_{self.form.value}"
        return f"{self.kind.value}{form}_{GRADES[self.kind].label(self.size)}"


def choose(kinds: Sequence[AnomalyKind], sizes: str) -> tuple[FaultGrade, ...]:
    """Return the grades of kinds of faults.

    Args:
        kinds: kinds of faults.
        sizes: "all", "gated" (those that a detector must find), or comma-separated numbers in the unit of
            `PlantedFault.size`.

    Raises:
        UsageError: sizes are invalid, or numbers are combined with several kinds.
    """
    if sizes not in ("all", "gated") and len(kinds) != 1:
        raise UsageError(f"sizes {sizes!r}: numbers are of one kind's unit; name one kind, or say all or gated")
    return tuple(
        FaultGrade(kind=kind, size=size, form=form)
        for kind in kinds
        for size in _sizes(GRADES[kind], sizes)
        for form in GRADES[kind].forms
    )


def _sizes(grades: FaultGrades, sizes: str) -> tuple[float, ...]:
    if sizes == "all":
        return grades.sizes
    if sizes == "gated":
        return tuple(size for size in grades.sizes if size >= grades.gate)
    try:
        numbers = tuple(float(size) for size in sizes.split(","))
    except ValueError:
        numbers = ()
    if not numbers or not all(0 < number < float("inf") for number in numbers):
        raise UsageError(f"sizes {sizes!r}: expected all, gated or positive numbers such as 0.05,0.1")
    return numbers
