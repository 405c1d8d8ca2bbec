"""Contacts with obstacles by sweeps and by dense sampling, over many tracks."""

import json
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks import markdown
from benchmarks.record import machine_text
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.sweep import RESOLUTION_M, sweep
from kinebench_drake.models.arm import load_robot

_FRAMES = 25
_PERIOD_S = 0.2
_OBSTACLES = 4
_TOLERANCE_M = 0.002
_SPREAD_RAD = 0.35  # of the knots of a motion about the rest posture
_SCENES = 10  # of as many tracks each


def compare(count: int, samples: int, seed: int) -> list[str]:
    """Return how sweeps of `count` random tracks compare with `samples` postures between two frames, as a section."""
    rng = np.random.default_rng(seed)
    missed = extra = slots = hits = between = 0
    sweep_s = dense_s = error_m = 0.0
    with TemporaryDirectory() as folder:
        for k in range(_SCENES):
            plant = ArmPlant(load_robot(obstacles=_write_scene(Path(folder), rng)))
            model = CollisionModel(plant)
            for _ in range(k, count, _SCENES):
                knots = plant.robot.rest_q + rng.normal(0.0, _SPREAD_RAD, (5, 7))
                times = np.linspace(0.0, 1.0, _FRAMES)
                q = CubicSpline(np.linspace(0.0, 1.0, 5), knots)(times).clip(plant.lower, plant.upper)
                width = rng.uniform(0.0, 0.08, _FRAMES)
                start = time.process_time()
                contacts = sweep(plant, model, q, width, _TOLERANCE_M)
                middle = time.process_time()
                dense = _sample(plant, model, q, width, samples)
                sweep_s = sweep_s + middle - start
                dense_s = dense_s + time.process_time() - middle
                swept = {(c.link, c.obstacle): c.distance_m for c in contacts}
                none = np.full(2 * _FRAMES - 1, np.inf)
                for pair in dense.keys() | swept.keys():
                    a = swept.get(pair, none)
                    b = dense.get(pair, none)
                    deep = b < -_TOLERANCE_M - RESOLUTION_M
                    slots = slots + int(deep.sum())
                    hits = hits + int(np.isfinite(a).sum())
                    missed += int((deep & np.isinf(a)).sum())
                    extra += int((np.isfinite(a) & ~(b < -_TOLERANCE_M)).sum())
                    error_m = max(error_m, float(np.max((a - b)[deep & np.isfinite(a)], initial=0.0)))
                of_frames = any(np.isfinite(d[::2]).any() for d in swept.values())
                between += bool(contacts) and not of_frames
    rows = [
        ["contacts of dense sampling, deeper than the tolerance by 0.5 mm", str(slots)],
        ["of these missed by the sweep", str(missed)],
        ["contacts of the sweep", str(hits)],
        ["of these not in the samples", str(extra)],
        ["tracks with contacts between frames only", str(between)],
        ["depth less than that of the samples by at most", f"{1000.0 * error_m:.1f} mm"],
        ["time per track, sweep / samples", f"{1000.0 * sweep_s / count:.0f} / {1000.0 * dense_s / count:.0f} ms"],
    ]
    head = f"{count} tracks of {_FRAMES} frames at {_PERIOD_S} s, {_OBSTACLES} obstacles, {samples} postures a step"
    return [*markdown.table((head, ""), rows), "", machine_text()]


def _write_scene(folder: Path, rng: np.random.Generator) -> Path:
    """Write random obstacles in front of the arm, thin ones among them."""
    obstacles = []
    for k in range(_OBSTACLES):
        azimuth = rng.uniform(-1.2, 1.2)
        distance = rng.uniform(0.35, 0.75)
        place = [distance * np.cos(azimuth), distance * np.sin(azimuth), rng.uniform(0.05, 0.8)]
        turn = rng.normal(size=4)
        shape = [
            {"box_m": [0.3, 0.3, 0.004]},
            {"box_m": rng.uniform(0.03, 0.15, 3).tolist()},
            {"sphere_m": float(rng.uniform(0.02, 0.08))},
            {"cylinder_m": [float(rng.uniform(0.005, 0.03)), 0.5]},
        ][k % 4]
        pose = {"position_m": place, "quaternion_wxyz": (turn / np.linalg.norm(turn)).tolist()}
        obstacles.append({"name": f"body{k}", **shape, **pose})
    path = folder / "scene.json"
    path.write_text(json.dumps({"obstacles": obstacles}))
    return path


def _sample(
    plant: ArmPlant, model: CollisionModel, q: Array, width: Array, samples: int
) -> dict[tuple[str, str], Array]:
    """Return the least distances of densely sampled postures, as in `Contact`, by link and obstacle."""
    blocks = {solid.link for solid in model.obstacles}
    inspector = plant.query(q[0]).inspector()
    least: dict[tuple[str, str], Array] = {}
    for slot in range(2 * len(q) - 1):
        i, between = divmod(slot, 2)
        for share in np.linspace(0.0, 1.0, samples + 2) if between else (0.0,):
            row, gap = ((1.0 - share) * values[i] + share * values[i + between] for values in (q, width))
            for pair in plant.query(row, float(gap)).ComputeSignedDistancePairwiseClosestPoints(0.0):
                ids = (inspector.GetFrameId(pair.id_A), inspector.GetFrameId(pair.id_B))
                links = sorted((plant.drake.GetBodyFromFrameId(id).name() for id in ids), key=blocks.__contains__)
                if links[1] in blocks:
                    own = least.setdefault((links[0], links[1]), np.full(2 * len(q) - 1, np.inf))
                    own[slot] = min(own[slot], pair.distance)
    return least
