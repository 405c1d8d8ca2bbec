"""Planting a fault of any kind."""

from kinebench_drake.errors import InputError
from kinebench_drake.products import AnomalyKind
from kinebench_drake.suites.clip import Clip
from kinebench_drake.suites.faults.camera import plant_camera_motion
from kinebench_drake.suites.faults.fault import Form, Grade, PlantedFault
from kinebench_drake.suites.faults.fingers import plant_fingers
from kinebench_drake.suites.faults.motion import plant_freeze, plant_teleport, plant_vanish
from kinebench_drake.suites.faults.shape import plant_deformation, plant_duplicate, plant_scale
from kinebench_drake.suites.faults.take import Take
from kinebench_drake.suites.seeding import generator


def plant(take: Take, grade: Grade) -> tuple[Clip, PlantedFault]:
    """The clip with a fault, the same one each time, and what it is.

    Raises:
        InputError: this clip has no place for it.
    """
    rng = generator("fault", take.performance.episode.id, grade.kind.value)
    match grade.kind:
        case AnomalyKind.VANISH:
            return plant_vanish(take, _frames(grade))
        case AnomalyKind.DUPLICATE:
            return plant_duplicate(take, grade.size, rng)
        case AnomalyKind.TELEPORT:
            return plant_teleport(take, grade.size)
        case AnomalyKind.FREEZE:
            return plant_freeze(take, _frames(grade))
        case AnomalyKind.DEFORMATION:
            return plant_deformation(take, grade.size, rng)
        case AnomalyKind.SCALE:
            return plant_scale(take, grade.size, grade.form or Form.CONSTANT, rng)
        case AnomalyKind.CAMERA:
            return plant_camera_motion(take, grade.size, grade.form or Form.SHAKE, rng)
        case AnomalyKind.FINGERS:
            return plant_fingers(take, grade.size, grade.form or Form.JUMP)


def _frames(grade: Grade) -> int:
    if grade.size < 1 or grade.size != int(grade.size):
        raise InputError(f"{grade.kind.value} of size {grade.size}: expected a whole number of frames")
    return int(grade.size)
