"""Planting of a fault of any kind."""

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.suites.faults.appearance import plant_deformation, plant_duplicate, plant_scale
from kinebench_drake.suites.faults.fault import FaultForm, FaultGrade, PlantedFault
from kinebench_drake.suites.faults.motion import (
    plant_camera_motion,
    plant_fingers,
    plant_freeze,
    plant_teleport,
    plant_vanish,
)
from kinebench_drake.suites.faults.recording import Recording
from kinebench_drake.suites.rollout import RolloutVideo
from kinebench_drake.suites.seeding import generator


def plant(recording: Recording, grade: FaultGrade) -> tuple[RolloutVideo, PlantedFault]:
    """Return the video with a fault and the fault, deterministic in episode and kind.

    Raises:
        InputError: the clip has no place for the fault.
    """
    rng = generator("fault", recording.rollout.episode.id, grade.kind.value)
    match grade.kind:
        case AnomalyKind.VANISH:
            return plant_vanish(recording, _frames(grade))
        case AnomalyKind.DUPLICATE:
            return plant_duplicate(recording, grade.size, rng)
        case AnomalyKind.TELEPORT:
            return plant_teleport(recording, grade.size)
        case AnomalyKind.FREEZE:
            return plant_freeze(recording, _frames(grade))
        case AnomalyKind.DEFORMATION:
            return plant_deformation(recording, grade.size, rng)
        case AnomalyKind.SCALE:
            return plant_scale(recording, grade.size, grade.form or FaultForm.CONSTANT, rng)
        case AnomalyKind.CAMERA:
            return plant_camera_motion(recording, grade.size, grade.form or FaultForm.SHAKE, rng)
        case AnomalyKind.FINGERS:
            return plant_fingers(recording, grade.size, grade.form or FaultForm.JUMP)


def _frames(grade: FaultGrade) -> int:
    if grade.size < 1 or grade.size != int(grade.size):
        raise InputError(f"{grade.kind.value} of size {grade.size}: expected a whole number of frames")
    return int(grade.size)
