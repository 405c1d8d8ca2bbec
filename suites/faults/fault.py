"""Kinds and sizes of the faults that can be planted."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from kinebench_drake.errors import UsageError
from kinebench_drake.types import AnomalyKind


class FaultForm(Enum):
    """How a fault goes on in time, where a kind has several."""

    CONSTANT = "constant"
    """All along."""
    GROWING = "growing"
    """From nothing in the first frame to its size in the last."""
    SHAKE = "shake"
    """To and fro, turning the camera."""
    DRIFT = "drift"
    """Away and away, moving the camera sideways."""
    FLUTTER = "flutter"
    """To and fro with each frame."""
    JUMP = "jump"
    """At once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedFault:
    """What was done to a clip."""

    kind: AnomalyKind
    """Kind of the fault."""
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    size: float
    """Frames without gripper (vanish) or frozen (freeze), metres apart (duplicate_gripper), jumped (teleport) or opened
    (finger_opening), relative stretch (deformation) or size (scale_drift), pixels (camera_motion)."""
    form: FaultForm | None = None
    """How it goes on in time, if its kind has several ways."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultGrades:
    """The sizes in which a kind of fault is planted."""

    sizes: tuple[float, ...]
    """From what hardly shows to what nobody overlooks, in the unit of `PlantedFault.size`."""
    gate: float
    """The least size that has to be found."""
    unit: str
    """Unit of `label`."""
    factor: float
    """Sizes times this are in that unit."""
    forms: tuple[FaultForm | None, ...] = (None,)
    """Ways in which it goes on in time."""

    def label(self, size: float) -> str:
        """A size in words, fit for a file's name."""
        return f"{size * self.factor:g}{self.unit}"


GRADES: dict[AnomalyKind, FaultGrades] = {
    AnomalyKind.VANISH: FaultGrades(sizes=(1, 2, 3, 5, 10), gate=3, unit="f", factor=1),
    AnomalyKind.DUPLICATE: FaultGrades(sizes=(0.1, 0.15, 0.25), gate=0.15, unit="cm", factor=100),
    AnomalyKind.TELEPORT: FaultGrades(sizes=(0.02, 0.05, 0.1, 0.15), gate=0.05, unit="cm", factor=100),
    AnomalyKind.FREEZE: FaultGrades(sizes=(3, 5, 8), gate=5, unit="f", factor=1),
    AnomalyKind.DEFORMATION: FaultGrades(sizes=(0.05, 0.1, 0.2, 0.3), gate=0.2, unit="pc", factor=100),
    AnomalyKind.SCALE: FaultGrades(
        sizes=(0.02, 0.05, 0.1, 0.15), gate=0.05, unit="pc", factor=100, forms=(FaultForm.CONSTANT, FaultForm.GROWING)
    ),
    AnomalyKind.CAMERA: FaultGrades(
        sizes=(1, 2, 4, 8), gate=2, unit="px", factor=1, forms=(FaultForm.SHAKE, FaultForm.DRIFT)
    ),
    AnomalyKind.FINGERS: FaultGrades(
        sizes=(0.01, 0.02, 0.04, 0.06), gate=0.04, unit="mm", factor=1000, forms=(FaultForm.FLUTTER, FaultForm.JUMP)
    ),
}
"""What is planted of each kind. The gripper is about 0.2 m wide; its fingers open by up to 0.08 m, and by up to 0.02 m
between two frames of the benchmark."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultGrade:
    """One kind of fault in one size."""

    kind: AnomalyKind
    size: float
    """In the unit of `PlantedFault.size`."""
    form: FaultForm | None

    @property
    def label(self) -> str:
        """Its name, fit for a file's, such as "camera_motion_shake_2px"."""
        form = "" if self.form is None else f"_{self.form.value}"
        return f"{self.kind.value}{form}_{GRADES[self.kind].label(self.size)}"


def choose(kinds: Sequence[AnomalyKind], sizes: str) -> tuple[FaultGrade, ...]:
    """Faults of some kinds in all sizes ("all"), in those that have to be found ("gated"), or in sizes given.

    Args:
        kinds: of what kinds.
        sizes: "all", "gated" or numbers with commas between, in the unit of `PlantedFault.size`.

    Raises:
        UsageError: sizes are none of these, or given for several kinds at once.
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
