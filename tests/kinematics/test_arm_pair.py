"""Distances between two arms, against one Drake plant of both."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from kinebench_drake.geometry import make_pose, rotation_z
from kinebench_drake.kinematics.arm_pair import ArmPair
from kinebench_drake.kinematics.plant import ArmPlant

COUNT = 60
TOLERANCE_M = 0.002


def test_contacts_of_two_arms_are_those_of_one_plant_of_both(plant: ArmPlant) -> None:
    X_WB = [make_pose(np.eye(3), [0.0, 0.3, 0.0]), make_pose(rotation_z(0.4), [0.0, -0.3, 0.1])]
    rng = np.random.default_rng(0)
    q = [plant.robot.rest_q + rng.normal(scale=0.6, size=(COUNT, 7)) for _ in X_WB]
    widths = [np.full(COUNT, np.nan)] * 2
    least = np.zeros(COUNT)
    for contact in ArmPair([plant, ArmPlant()], X_WB).contacts(q, widths, TOLERANCE_M):
        least = np.fmin(least, contact.distance_m)

    builder = DiagramBuilder()
    both, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    parser = Parser(both)
    parser.SetAutoRenaming(True)
    models = [parser.AddModels(str(plant.robot.urdf))[0] for _ in X_WB]
    for model, X in zip(models, X_WB, strict=True):
        both.WeldFrames(both.world_frame(), both.GetFrameByName("panda_link0", model), RigidTransform(X))
    both.Finalize()
    diagram = builder.Build()
    context = both.GetMyMutableContextFromRoot(diagram.CreateDefaultContext())
    expected = np.zeros(COUNT)
    for i in range(COUNT):
        for model, own in zip(models, q, strict=True):
            both.SetPositions(context, model, np.concatenate([own[i], [0.04, 0.04]]))
        query = both.get_geometry_query_input_port().Eval(context)
        inspector = query.inspector()
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(-TOLERANCE_M):
            frames = [inspector.GetFrameId(id) for id in (pair.id_A, pair.id_B)]
            if len({both.GetBodyFromFrameId(frame).model_instance() for frame in frames}) == 2:
                expected[i] = min(expected[i], pair.distance)
    assert (expected < 0.0).sum() > 5
    np.testing.assert_allclose(least, expected, atol=1e-9)
