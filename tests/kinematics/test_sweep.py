"""Contacts along a path: those of dense sampling, none missed between two postures."""

import json
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.sweep import RESOLUTION_M, sweep
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.models.arm import load_robot
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.violation import ViolationKind

PLATE = {"name": "plate", "box_m": [0.4, 0.002, 0.6], "position_m": [0.6, 0.0, 0.3]}
OTHERS = [
    {"name": "ball", "sphere_m": 0.08, "position_m": [0.5, 0.35, 0.4]},
    {"name": "post", "cylinder_m": [0.03, 0.8], "position_m": [0.4, -0.3, 0.4]},
]
TOLERANCE_M = 0.002


def make_plant(folder: Path, *obstacles: dict[str, object]) -> ArmPlant:
    path = folder / "scene.json"
    path.write_text(json.dumps({"obstacles": obstacles}))
    return ArmPlant(load_robot(obstacles=path))


def turn(start_rad: float, end_rad: float, frames: int = 2) -> Array:
    """Postures whose first joint turns the outstretched arm about the vertical."""
    q = np.tile(rest_q(), (frames, 1))
    q[:, 0] = np.linspace(start_rad, end_rad, frames)
    return q


def deepest(
    plant: ArmPlant, model: CollisionModel, q: Array, width: Array, samples: int
) -> dict[tuple[str, int], float]:
    """Least distances of dense postures by obstacle and slot: frames, and the ways between them."""
    found: dict[tuple[str, int], float] = {}
    blocks = {solid.link for solid in model.obstacles}
    for slot in range(2 * len(q) - 1):
        i, between = divmod(slot, 2)
        for share in np.linspace(0.0, 1.0, samples) if between else [0.0]:
            row = (1.0 - share) * q[i] + share * q[i + between]
            gap = (1.0 - share) * width[i] + share * width[i + between]
            for pair in model.near_pairs(row, 0.0, float(gap)):
                if pair.link_b in blocks:
                    key = pair.link_b, slot
                    found[key] = min(found.get(key, 0.0), pair.distance_m)
    return found


def test_a_thin_plate_between_two_free_postures_is_met_on_the_way(tmp_path: Path) -> None:
    plant = make_plant(tmp_path, PLATE)
    contacts = sweep(plant, CollisionModel(plant), turn(-0.6, 0.6), np.full(2, 0.04), TOLERANCE_M)
    assert "panda_hand" in {contact.link for contact in contacts}
    for contact in contacts:
        assert np.isinf(contact.distance_m[[0, 2]]).all()
        assert contact.distance_m[1] < -TOLERANCE_M


def test_a_way_that_ends_before_the_plate_is_free(tmp_path: Path) -> None:
    plant = make_plant(tmp_path, PLATE)
    assert not sweep(plant, CollisionModel(plant), turn(0.3, 1.5, 4), np.full(4, np.nan), TOLERANCE_M)


def test_no_contact_is_looked_for_across_unknown_postures(tmp_path: Path) -> None:
    plant = make_plant(tmp_path, PLATE)
    q = turn(-0.6, 0.6, 3)
    q[1] = np.nan
    assert not sweep(plant, CollisionModel(plant), q, np.full(3, 0.04), TOLERANCE_M)


@pytest.mark.parametrize("seed", range(3))
def test_contacts_are_those_of_dense_sampling(tmp_path: Path, seed: int) -> None:
    plant = make_plant(tmp_path, PLATE, *OTHERS)
    rng = np.random.default_rng(seed)
    model = CollisionModel(plant)
    q = np.clip(rest_q() + np.cumsum(rng.normal(0.0, 0.12, (6, 7)), axis=0), plant.lower, plant.upper)
    width = rng.uniform(0.0, 0.08, 6)
    found: dict[tuple[str, int], float] = {}
    for contact in sweep(plant, model, q, width, TOLERANCE_M):
        for slot in np.flatnonzero(np.isfinite(contact.distance_m)):
            key = contact.obstacle, int(slot)
            found[key] = min(found.get(key, 0.0), float(contact.distance_m[slot]))
    dense = deepest(plant, model, q, width, 60)
    assert {key for key, depth in dense.items() if depth < -TOLERANCE_M - RESOLUTION_M} <= found.keys()
    for key, depth in found.items():
        assert depth < dense[key] + max(RESOLUTION_M, -0.1 * depth)
        assert depth > dense[key] - 0.01  # dense sampling misses the deepest point


def test_a_violation_names_link_body_frames_and_depth(tmp_path: Path) -> None:
    plant = make_plant(tmp_path, PLATE)
    q = turn(-0.6, 0.61, 12)
    result = TrackJudge(plant).judge_joints(0.2 * np.arange(12), q, np.full(12, 0.04))
    hits = [v for v in result.violations if v.kind is ViolationKind.OBSTACLE_COLLISION]
    assert result.feasible is False
    assert {hit.body for hit in hits} == {"plate"}
    [hand] = [hit for hit in hits if hit.link == "panda_hand"]
    assert hand.frame_start <= 5
    assert hand.frame_end >= 6
    assert hand.value < -TOLERANCE_M
    assert result.metrics["self_distance_min_m"] > 0.05


def test_poses_past_an_obstacle_are_followed_by_postures_that_avoid_it(tmp_path: Path) -> None:
    elbow = {"name": "beside-the-elbow", "sphere_m": 0.06, "position_m": [0.0, 0.0, 0.0]}
    free = ArmPlant()
    X = free.forward_path(turn(-0.05, 0.05, 8))
    elbow["position_m"] = free.link_poses(rest_q())["panda_link4"][:3, 3].tolist()
    plant = make_plant(tmp_path, elbow)
    from kinebench_drake.kinematics.track_ik import solve_track
    from kinebench_drake.track import GripperTrack

    n = len(X)
    track = GripperTrack(
        t_s=0.2 * np.arange(n), X_CH=np.full_like(X, np.nan), X_BG=X, tracked=np.ones(n, dtype=bool),
        confidence=np.ones(n), finger_width_m=np.full(n, 0.04),
    )  # fmt: skip
    model = CollisionModel(plant)
    joints = solve_track(plant, track, model)
    assert joints.ok.all()
    assert not sweep(plant, model, joints.q, track.finger_width_m, TOLERANCE_M)
