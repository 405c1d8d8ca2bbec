"""Distances between two arms that stand side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import FramePoseVector, GeometryFrame, GeometryInstance, Role, SceneGraph
from pydrake.math import RigidTransform

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import CollisionModel, Solid
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
        self._solids: list[list[Solid]] = []
        self._frames: list[list[Any]] = []
        self._geometries: list[list[Any]] = []
        is_shared = np.allclose(X_WB[0], X_WB[1])
        for k, plant in enumerate(plants):
            inspector = plant.query(plant.robot.rest_q).inspector()
            own = CollisionModel(plant).arm_solids().items()
            chosen = [(id, solid) for id, solid in own if solid.stage > 0 or not is_shared]
            names = [f"{k}_{i}" for i in range(len(chosen))]
            frames = [graph.RegisterFrame(source, GeometryFrame(name)) for name in names]
            geometries = []
            for (id, solid), name, frame in zip(chosen, names, frames, strict=True):
                X_BS = plant.chain.home[solid.link] @ inspector.GetPoseInFrame(id).GetAsMatrix4()
                copy = GeometryInstance(RigidTransform(X_BS), inspector.GetShape(id), name)
                copy.set_proximity_properties(inspector.GetProperties(id, Role.kProximity))
                geometries.append(graph.RegisterGeometry(source, frame, copy))
            self._solids.append([solid for _, solid in chosen])
            self._frames.append(frames)
            self._geometries.append(geometries)
        stages = [np.array([solid.stage for solid in own], dtype=np.intp) for own in self._solids]
        self._stages = stages
        self._balls = [[solid.ball() for solid in own] for own in self._solids]
        radii = [np.array([radius for _, radius in own]) for own in self._balls]
        self._reach = radii[0][:, None] + radii[1]
        self._reach[(stages[0] == 0)[:, None] & (stages[1] == 0)] = -np.inf  # both at rest
        self._graph = graph
        self._context = graph.CreateDefaultContext()
        self._port = graph.get_source_pose_port(source)

    def contacts(self, q: Sequence[Array], finger_width_m: Sequence[Array], tolerance_m: float) -> list[PairContact]:
        """Return the pairs of links that penetrate each other by more than a tolerance [m] in one of N postures.

        Postures `q` (N, J) [rad] of each arm, NaN where unknown; finger gaps (N,) [m], the default where NaN.
        """
        rows = np.flatnonzero(np.isfinite(q[0]).all(axis=-1) & np.isfinite(q[1]).all(axis=-1))
        motions = []
        centers = []
        for k, plant in enumerate(self._plants):
            M = (self._X_WB[k] @ plant.chain.motions(q[k][rows], finger_width_m[k][rows]))[:, self._stages[k]]
            middle = np.reshape([center for center, _ in self._balls[k]], (-1, 3))
            motions.append(M)
            centers.append((M[..., :3, :3] @ middle[..., None])[..., 0] + M[..., :3, 3])
        near = np.linalg.norm(centers[0][:, :, None] - centers[1][:, None], axis=-1) < self._reach - tolerance_m
        depths: dict[tuple[int, int], Array] = {}
        for row in np.flatnonzero(near.any(axis=(1, 2))):
            query = self._query([M[row] for M in motions])
            for a, b in np.argwhere(near[row]).tolist():
                pair = query.ComputeSignedDistancePairClosestPoints(self._geometries[0][a], self._geometries[1][b])
                if pair.distance < -tolerance_m:
                    depths.setdefault((a, b), np.full(len(q[0]), np.nan))[rows[row]] = pair.distance
        return [self._contact(a, b, distance) for (a, b), distance in depths.items()]

    def _contact(self, a: int, b: int, distance_m: Array) -> PairContact:
        links = self._solids[0][a].link, self._solids[1][b].link
        of_tools = all(link in plant.tool for link, plant in zip(links, self._plants, strict=True))
        return PairContact(links=links, of_tools=of_tools, distance_m=distance_m)

    def _query(self, motions: Sequence[Array]) -> Any:
        """Return Drake's QueryObject with the solids moved by (S, 4, 4) of each arm."""
        poses = FramePoseVector()
        for frames, own in zip(self._frames, motions, strict=True):
            for frame, M in zip(frames, own, strict=True):
                poses.set_value(frame, RigidTransform(M))
        self._port.FixValue(self._context, poses)
        return self._graph.get_query_output_port().Eval(self._context)
