"""Stills of a performance for training perception: moments of it, seen from near the benchmark's camera.

In some the arm is put elsewhere while the things stay, with fingers opened anew: tasks alone show it in few poses.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.perception.frame import RenderedFrame, varied_camera
from kinebench_drake.suites.rollout import Rollout
from kinebench_drake.suites.simulator import Simulator, Snapshot

STILLS = 32
"""Stills of a performance."""
_ELSEWHERE = 0.4  # share of stills with the arm put elsewhere
_BENCHMARK = 0.4  # share of stills from the benchmark's camera itself
_SPREAD_RAD = np.array([0.2, 0.2, 0.2, 0.25, 0.3, 0.3, 0.6])  # of the joints of an arm put elsewhere
_LEAST_Z_M = 0.012  # of a tool centre point above the table
_TRIES = 200


def take_stills(stage: Simulator, performance: Rollout, rng: np.random.Generator) -> list[RenderedFrame]:
    """`STILLS` frames of a performance, on the stage where it took place; its camera comes back in the end."""
    before, size = stage.camera, stage.camera.width
    plant = ArmPlant()
    frames = []
    for snapshot in _moments(performance.snapshots, rng):
        camera = benchmark_camera().resized(size, size) if rng.random() < _BENCHMARK else varied_camera(rng, size)
        stage.look_from(camera)
        stage.show(_elsewhere(plant, snapshot, rng) if rng.random() < _ELSEWHERE else snapshot)
        frames.append(stage.still())
    stage.look_from(before)
    return frames


def _moments(snapshots: Sequence[Snapshot], rng: np.random.Generator) -> list[Snapshot]:
    chosen = rng.choice(len(snapshots), size=STILLS, replace=len(snapshots) < STILLS)
    return [snapshots[i] for i in np.sort(chosen)]


def _elsewhere(plant: ArmPlant, snapshot: Snapshot, rng: np.random.Generator) -> Snapshot:
    """The snapshot with another posture of the arm above the table; unchanged where none is found."""
    for _ in range(_TRIES):
        q: Array = snapshot.q + rng.normal(0.0, _SPREAD_RAD)
        inside = (q > plant.lower).all() and (q < plant.upper).all()
        if inside and plant.forward(q)[2, 3] > _LEAST_Z_M:
            fingers = np.full(2, rng.uniform(0.0, 0.04)) if rng.random() < 0.5 else snapshot.fingers_m
            return replace(snapshot, q=q, fingers_m=fingers)
    return snapshot
