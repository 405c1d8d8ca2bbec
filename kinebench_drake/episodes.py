"""What the benchmark knows of its own episodes' videos: where the robot stands in the first frame."""

from collections.abc import Iterable
from dataclasses import replace

from kinebench_drake.grounding.known import FirstFrame
from kinebench_drake.inputs import Sample
from kinebench_drake.suites.start import START_WIDTH_M, start_q


def with_first_frames(samples: Iterable[Sample]) -> list[Sample]:
    """The samples, those of a known task and seed with the pose in which the episode's scene begins.

    What a manifest says of the first frame itself goes before. A video that begins elsewhere, such as the second clip
    of an episode, is told by what its first frame shows.

    Raises:
        SetupError: the Panda's files are missing.
    """
    from kinebench_drake.kinematics.plant import ArmPlant

    plant: ArmPlant | None = None
    told = []
    for sample in samples:
        task, seed = sample.task, sample.seed
        if sample.first is None and seed is not None and task is not None and task in START_WIDTH_M:
            plant = plant or ArmPlant()
            q = start_q(task, seed)
            first = FirstFrame(X_BG=plant.forward(q[:7]), finger_width_m=float(q[7:].sum()))
            sample = replace(sample, first=first)
        told.append(sample)
    return told
