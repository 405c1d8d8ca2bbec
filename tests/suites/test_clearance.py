"""Collision geometry of plans: Drake's solids are where SAPIEN's are."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.expert.clearance import SceneGeometry
from kinebench_drake.suites.expert.motion import Waypoint, plan
from kinebench_drake.suites.families.task import Scene
from kinebench_drake.suites.scene.model import AssetModel, Collider, ColliderKind, Joint, JointKind, RigidBody

UPRIGHT = make_pose(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.zeros(3))
POST = np.array([0.5, 0.2, 0.15])


DOOR = RigidBody(name="door", visuals=(), joint=Joint(kind=JointKind.HINGE, upper=1.0))


def post(collider: Collider) -> AssetModel:
    body = RigidBody(name="post", visuals=(), colliders=(collider,))
    return AssetModel(asset_id="post/00", words="post", bodies=(body,), size={})


def with_door(scene: Scene) -> Scene:
    """Return the scene with the post as the fixed body of an articulation."""
    model = scene.models["post"]
    return replace(scene, models={"post": replace(model, bodies=(*model.bodies, DOOR))})


def scene_with(collider: Collider, position: np.ndarray, **marks: frozenset[str]) -> Scene:
    X = make_pose(np.eye(3), position)
    return Scene(
        X_BG=np.eye(4), finger_width_m=0.08, poses={"post": X}, joints={}, models={"post": post(collider)}, **marks
    )


COLLIDERS = (
    Collider(kind=ColliderKind.BOX, size=(0.01, 0.01, 0.15)),
    Collider(kind=ColliderKind.SPHERE, size=(0.05,)),
    Collider(kind=ColliderKind.CYLINDER, size=(0.01, 0.12), X_BodyC=UPRIGHT),
    Collider(kind=ColliderKind.CAPSULE, size=(0.01, 0.12), X_BodyC=UPRIGHT),
    Collider(kind=ColliderKind.HULL, points=0.05 * np.concatenate([np.eye(3), -np.eye(3)])),
)  # fmt: skip


@pytest.fixture(scope="module")
def plant() -> ArmPlant:
    return ArmPlant()


@pytest.fixture(scope="module")
def tip(plant: ArmPlant) -> Array:
    """Position of the fingertips of the arm at rest."""
    return plant.forward(plant.robot.rest_q)[:3, 3]


def touched(plant: ArmPlant, scene: Scene) -> set[str]:
    """Return the links of the arm at rest, its fingers closed, that penetrate a scene."""
    geometry = SceneGeometry(plant, scene)
    return {t.link for t in geometry.penetrations(plant.robot.rest_q[None], np.zeros(1))}


@pytest.mark.parametrize("collider", COLLIDERS, ids=lambda c: c.kind.value)
def test_a_solid_at_the_fingertips_penetrates_the_gripper_alone(
    plant: ArmPlant, tip: Array, collider: Collider
) -> None:
    links = touched(plant, scene_with(collider, tip, avoided=frozenset({"post"})))
    assert links & {"panda_leftfinger", "panda_rightfinger"}
    assert not links & {"panda_link3", "panda_link4"}
    assert not touched(plant, scene_with(collider, tip + np.array([0.0, 0.3, 0.0]), avoided=frozenset({"post"})))


def test_a_cylinder_has_the_axis_that_it_has_in_sapien(plant: ArmPlant, tip: Array) -> None:
    """A cylinder turned upright reaches its half length up, and is thin."""
    for offset, touches in (([0.0, 0.0, -0.12], True), ([0.0, 0.06, -0.1], False)):
        scene = scene_with(COLLIDERS[2], tip + offset, avoided=frozenset({"post"}))
        assert bool(touched(plant, scene)) == touches


def test_the_gripper_may_touch_fixed_objects_and_no_link_avoided_ones(plant: ArmPlant, tip: Array) -> None:
    free = scene_with(COLLIDERS[0], tip)
    for scene, touches in (
        (free, False),
        (with_door(free), False),
        (replace(free, avoided=frozenset({"post"})), True),
    ):
        assert bool(touched(plant, scene)) == touches
    elbow = plant.link_poses(plant.robot.rest_q)["panda_link4"][:3, 3]
    fixed = with_door(scene_with(COLLIDERS[0], elbow))
    assert touched(plant, fixed) & {"panda_link3", "panda_link4", "panda_link5"}


def test_a_plan_through_an_avoided_post_is_refused(plant: ArmPlant) -> None:
    q = plant.robot.rest_q
    X = plant.forward(q)
    beyond = X.copy()
    beyond[:3, 3] = [0.5, 0.3, X[2, 3]]
    scene = scene_with(COLLIDERS[0], POST, avoided=frozenset({"post"}))
    with pytest.raises(InputError, match="post collide"):
        plan(plant, q, 0.08, [Waypoint(X_BG=beyond, finger_width_m=0.08)], 96, scene)
    plan(plant, q, 0.08, [Waypoint(X_BG=beyond, finger_width_m=0.08)], 96, replace(scene, avoided=frozenset()))
