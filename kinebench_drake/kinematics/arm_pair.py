"""Distances between two arms that stand side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    GeometrySet,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant


@dataclass(frozen=True, slots=True, kw_only=True)
class PairContact:
    """Two links, one of each arm, that penetrate each other in some postures."""

    links: tuple[str, str]
    """Link of the first arm, link of the second."""
    of_tools: bool
    """True if both are fixed to the TCP of their arm, so that the poses fix them."""
    distance_m: Array
    """(N,) signed distance [m], negative: depth of penetration; NaN where they are not in contact."""


class ArmPair:
    """Two arms with their bases in a common frame W. Uses a context of its own."""

    def __init__(self, plants: Sequence[ArmPlant], X_WB: Sequence[Array]) -> None:
        """Register the links of two arms with bases at poses (4, 4) in W [m]; at one pose the base is of both."""
        self._plants = plants
        self._X_WB = X_WB
        graph: Any = SceneGraph()
        source = graph.RegisterSource("arms")
        filters = graph.collision_filter_manager()
        is_shared = np.allclose(X_WB[0], X_WB[1])
        self._frames: list[list[Any]] = []
        self._links: dict[Any, str] = {}
        at_rest: list[Any] = []
        for k, plant in enumerate(plants):
            stages = plant.chain.motions(plant.robot.rest_q[None]).shape[1]
            frames = [graph.RegisterFrame(source, GeometryFrame(f"{k}_{stage}")) for stage in range(stages)]
            inspector = plant.query(plant.robot.rest_q).inspector()
            own: list[Any] = []
            for id, solid in CollisionModel(plant).arm_solids().items():
                if is_shared and solid.stage == 0:
                    continue
                X_BS = plant.chain.home[solid.link] @ inspector.GetPoseInFrame(id).GetAsMatrix4()
                copy = GeometryInstance(RigidTransform(X_BS), inspector.GetShape(id), f"{k}_{len(own)}")
                copy.set_proximity_properties(inspector.GetProperties(id, Role.kProximity))
                own.append(graph.RegisterGeometry(source, frames[solid.stage], copy))
                self._links[own[-1]] = solid.link
                at_rest += own[-1:] if solid.stage == 0 else []
            filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(own)))
            self._frames.append(frames)
        filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(at_rest)))
        self._graph = graph
        self._context = graph.CreateDefaultContext()
        self._port = graph.get_source_pose_port(source)

    def contacts(self, q: Sequence[Array], finger_width_m: Sequence[Array], tolerance_m: float) -> list[PairContact]:
        """Return the pairs of links that penetrate each other by more than a tolerance [m] in one of N postures.

        Postures `q` (N, J) [rad] of each arm, NaN where unknown; finger gaps (N,) [m], the default where NaN.
        """
        rows = np.flatnonzero(np.isfinite(q[0]).all(axis=-1) & np.isfinite(q[1]).all(axis=-1))
        motions = [
            X @ plant.chain.motions(own[rows], width[rows])
            for plant, X, own, width in zip(self._plants, self._X_WB, q, finger_width_m, strict=True)
        ]
        depths: dict[tuple[str, str], Array] = {}
        for i, row in enumerate(rows):
            poses = FramePoseVector()
            for frames, M in zip(self._frames, motions, strict=True):
                for frame, X in zip(frames, M[i], strict=True):
                    poses.set_value(frame, RigidTransform(X))
            self._port.FixValue(self._context, poses)
            query = self._graph.get_query_output_port().Eval(self._context)
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(-tolerance_m):
                links = self._links[pair.id_A], self._links[pair.id_B]  # ids grow, those of the first arm are less
                distance = depths.setdefault(links, np.full(len(q[0]), np.nan))
                distance[row] = np.fmin(distance[row], pair.distance)
        tools = [plant.tool for plant in self._plants]
        return [
            PairContact(links=(a, b), of_tools=a in tools[0] and b in tools[1], distance_m=distance)
            for (a, b), distance in depths.items()
        ]
