import numpy as np
import pytest
from pydrake.multibody.tree import BodyIndex

from benchmarks.body import shape_vertices
from kinebench_drake.geometry import transform_points


@pytest.fixture
def postures(arm):
    rng = np.random.default_rng(0)
    return rng.uniform(arm.plant.lower, arm.plant.upper, (20, 7)), rng.uniform(0.0, 0.08, 20)


def lowest_by_drake(arm, q, width, leave_out):
    inspector = arm.plant.diagram.GetSubsystemByName("scene_graph").model_inspector()
    query = arm.plant.query(q, width)
    heights = []
    for i in range(arm.plant.drake.num_bodies()):
        body = arm.plant.drake.get_body(BodyIndex(i))
        if not leave_out(body.name()):
            for geometry in arm.plant.drake.GetCollisionGeometriesForBody(body):
                X = query.GetPoseInWorld(geometry).GetAsMatrix4()
                heights.append(transform_points(X, shape_vertices(inspector.GetShape(geometry)))[:, 2].min())
    return min(heights)


def test_the_lowest_point_of_the_arm_equals_that_of_drakes_geometry(arm, postures):
    q, width = postures
    expected = [lowest_by_drake(arm, x, w, "panda_link0".__eq__) for x, w in zip(q, width, strict=True)]
    np.testing.assert_allclose(arm.body.lowest(q, width), expected, atol=1e-12)


def test_the_lowest_point_of_the_gripper_follows_from_pose_and_finger_width(arm, postures):
    q, width = postures
    expected = [lowest_by_drake(arm, x, w, lambda name: "link" in name) for x, w in zip(q, width, strict=True)]
    np.testing.assert_allclose(arm.body.lowest_of_gripper(arm.body.forward(q), width), expected, atol=1e-12)
