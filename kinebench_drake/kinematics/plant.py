"""The arm as a Drake plant: forward kinematics, Jacobian, limits, dynamics, and the geometry for distances."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable, MultibodyForces
from pydrake.systems.framework import DiagramBuilder

from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.chain import LinkChain
from kinebench_drake.models.panda.robot import panda
from kinebench_drake.models.robot import N_JOINTS, Robot


class ArmPlant:
    """A seven-joint arm with its base link fixed at the origin of B.

    Holds one Drake context that every call overwrites: make one object a thread. The fingers are present in the plant
    but stay where `finger_width_m` puts them.
    """

    def __init__(self, robot: Robot | None = None, *, finger_width_m: float = 0.08) -> None:
        """Load the robot (some 100 ms; the first time ever some seconds, to convert the meshes).

        Args:
            robot: the arm; None takes the Panda.
            finger_width_m: gap between the finger pads where a call names none, 0..0.08 [m].

        Raises:
            SetupError: the Panda's files are missing or cannot be converted.
            InputError: Drake does not take the given robot.
        """
        self.robot = robot or panda()
        """Names, files and published limits."""
        builder: Any = DiagramBuilder()
        plant: Any
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        try:
            Parser(plant).AddModels(self.robot.urdf)
            base = plant.GetFrameByName(self.robot.base_link)
            if base.body().index() != plant.world_body().index():
                plant.WeldFrames(plant.world_frame(), base, RigidTransform())
            plant.Finalize()
        except (RuntimeError, ValueError) as error:
            raise InputError(f"{self.robot.name}: Drake cannot load this robot ({cause(error)})") from None
        self.drake: Any = plant
        """The Drake plant itself, finalised: for the Panda 7 arm joints, then the fingers."""
        self.diagram: Any = builder.Build()
        """The plant connected to its scene graph."""
        joints = [plant.GetJointByName(name) for name in self.robot.joints]
        fingers = [plant.GetJointByName(name) for name in self.robot.finger_joints]
        self.arm = _index([joint.position_start() for joint in joints])
        """Where the seven arm joints are among all the plant's positions; other joints may come before or between."""
        self.arm_rates = _index([joint.velocity_start() for joint in joints])
        """The same among all the plant's velocities."""
        self._fingers = np.array([joint.position_start() for joint in fingers], dtype=np.intp)
        self._opening = np.array([[j.position_lower_limit(), j.position_upper_limit()] for j in fingers]).reshape(-1, 2)
        self.lower = np.array([joint.position_lower_limit() for joint in joints])
        """(7,) lower joint limits [rad]."""
        self.upper = np.array([joint.position_upper_limit() for joint in joints])
        """(7,) upper joint limits [rad]."""
        self.velocity_limits = np.array([float(joint.velocity_upper_limits()[0]) for joint in joints])
        """(7,) greatest joint speeds [rad/s]."""
        self.effort_limits = self.robot.effort_limits
        """(7,) greatest joint torques [N m]."""
        self.acceleration_limits = self.robot.acceleration_limits
        """(7,) greatest joint accelerations [rad/s^2]; None where unpublished."""
        self.jerk_limits = self.robot.jerk_limits
        """(7,) greatest joint jerks [rad/s^3]; None where unpublished."""
        self.finger_width_m = finger_width_m
        """Gap between the finger pads where a call names none [m]."""
        low, high = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        self._held = np.clip(np.zeros(plant.num_positions()), low, high)
        self._held[self._fingers] = np.clip(finger_width_m / 2.0, *self._opening.T)
        self._positions = self._held.copy()
        self.chain = LinkChain(plant, self.robot, self.positions)
        """Poses and Jacobians of many postures at once."""
        given = self.robot.allowed_pairs
        self.allowed_pairs = self._touching(0.5 * (self.lower + self.upper)) if given is None else given
        """Pairs of links that are never checked for contact, beyond those that Drake leaves out by itself."""
        self._filter(scene_graph)
        self._root = self.diagram.CreateDefaultContext()
        self.context: Any = plant.GetMyMutableContextFromRoot(self._root)
        """The plant's context that the methods use."""
        self.base_frame: Any = plant.GetFrameByName(self.robot.base_link)
        """Frame B."""
        self.tcp_frame: Any = plant.GetFrameByName(self.robot.tcp_link)
        """Frame G."""
        moved = plant.GetBodiesKinematicallyAffectedBy([joints[-1].index()])
        self.tool = frozenset(plant.get_body(index).name() for index in moved)
        """Links beyond the last arm joint: the TCP's pose alone says where they are."""
        self._links = {name: plant.GetFrameByName(name) for name in self.robot.links}
        self._origin = np.zeros(3)
        self._rates = np.zeros((2, plant.num_velocities()))

    def set_posture(self, q: ArrayLike, finger_width_m: float | None = None) -> None:
        """Put the plant's context into a posture `q` (7,) [rad], the fingers `finger_width_m` apart.

        Raises:
            UsageError: `q` is not (7,).
        """
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (N_JOINTS,):
            raise UsageError(f"q has shape {q.shape}, expected the 7 arm joints in radians")
        self._positions[:] = self._held
        self._positions[self.arm] = q
        if finger_width_m is not None:
            self._positions[self._fingers] = np.clip(finger_width_m / 2.0, *self._opening.T)
        self.drake.SetPositions(self.context, self._positions)

    def positions(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Array:
        """All the plant's positions (N, n) at postures `q` (N, 7) [rad], in Drake's order.

        The fingers are `finger_width_m` (N,) [m] apart, as far as their limits let them; where it is None or NaN, as
        `set_posture` has them. Joints that are neither the arm's nor fingers stay at 0, or at their limit nearest to 0.

        Raises:
            UsageError: `q` is not (N, 7).
        """
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != N_JOINTS:
            raise UsageError(f"q has shape {q.shape}, expected (N, {N_JOINTS}) arm joints in radians")
        positions = np.tile(self._held, (len(q), 1))
        positions[:, self.arm] = q
        if finger_width_m is not None:
            width = np.asarray(finger_width_m, dtype=np.float64)[:, None]
            asked = np.clip(width / 2.0, *self._opening.T)
            positions[:, self._fingers] = np.where(np.isfinite(width), asked, self._held[self._fingers])
        return positions

    def forward(self, q: ArrayLike) -> Array:
        """Pose X_BG (4, 4) of the TCP in the base [m] at joint angles `q` (7,) [rad]."""
        self.set_posture(q)
        return np.asarray(self.tcp_frame.CalcPoseInWorld(self.context).GetAsMatrix4())

    def link_poses(self, q: ArrayLike) -> dict[str, Array]:
        """Poses (4, 4) in the base [m] of all links of `robot.links`, by name, at joint angles `q` (7,) [rad]."""
        self.set_posture(q)
        return {name: np.asarray(f.CalcPoseInWorld(self.context).GetAsMatrix4()) for name, f in self._links.items()}

    def jacobian(self, q: ArrayLike) -> Array:
        """Geometric Jacobian (6, 7) of the TCP in B at `q` (7,) [rad]: `V_BG = J @ qdot`.

        Rows 0-2 are the angular velocity [rad/s], rows 3-5 the velocity of the TCP's origin [m/s], both expressed in
        B (Drake's order of a spatial velocity).
        """
        self.set_posture(q)
        return self._jacobian()

    def _jacobian(self) -> Array:
        J = self.drake.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, self.tcp_frame, self._origin, self.base_frame, self.base_frame
        )
        return np.asarray(J[:, self.arm_rates])

    def forward_and_jacobian(self, q: ArrayLike) -> tuple[Array, Array]:
        """Both `forward(q)` and `jacobian(q)`, at the price of one."""
        self.set_posture(q)
        return np.asarray(self.tcp_frame.CalcPoseInWorld(self.context).GetAsMatrix4()), self._jacobian()

    def torque(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Joint torques (7,) [N m] that move the arm with nothing in its hand, by Drake's inverse dynamics.

        tau = M(q) a + C(q, v) v - tau_g(q), without friction: `q` (7,) [rad], `v` [rad/s], `a` [rad/s^2]. The fingers
        stay still.
        """
        self.set_posture(q)
        self._rates[:, self.arm_rates] = v, a
        self.drake.SetVelocities(self.context, self._rates[0])
        inverse = self.drake.CalcInverseDynamics(self.context, self._rates[1], MultibodyForces(self.drake))
        gravity = self.drake.CalcGravityGeneralizedForces(self.context)
        return np.asarray((inverse - gravity)[self.arm_rates])

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Mass matrix (7, 7) [kg m^2] of the arm at `q` (7,) [rad], the fingers held."""
        self.set_posture(q)
        return np.asarray(self.drake.CalcMassMatrix(self.context)[self.arm_rates][:, self.arm_rates])

    def query(self, q: ArrayLike, finger_width_m: float | None = None) -> Any:
        """Drake's QueryObject of all geometry at `q` (7,) [rad]; allowed pairs of links are left out."""
        self.set_posture(q, finger_width_m)
        return self.drake.get_geometry_query_input_port().Eval(self.context)

    def _filter(self, scene_graph: Any) -> None:
        """Take pairs out of the search for contacts: the allowed ones, and links with no arm joint between them."""
        manager = scene_graph.collision_filter_manager()
        bodies = [self.drake.get_body(BodyIndex(i)) for i in range(self.drake.num_bodies())]
        geometry = {body.name(): self.drake.GetCollisionGeometriesForBody(body) for body in bodies}
        for pair in sorted(self.allowed_pairs, key=sorted):
            first, second = (GeometrySet(geometry.get(name, [])) for name in (sorted(pair) * 2)[:2])
            manager.Apply(CollisionFilterDeclaration().ExcludeBetween(first, second))
        together: dict[tuple[float, ...], list[Any]] = {}
        for name, ids in geometry.items():
            together.setdefault(tuple(self.chain.carries(name)), []).extend(ids)
        for ids in together.values():
            manager.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(ids)))

    def _touching(self, q: Array) -> frozenset[frozenset[str]]:
        """Pairs of links that touch at `q` (7,) [rad] with nothing left out but what Drake leaves out by itself."""
        root = self.diagram.CreateDefaultContext()
        context = self.drake.GetMyMutableContextFromRoot(root)
        self.drake.SetPositions(context, self.positions(q[None])[0])
        query = self.drake.get_geometry_query_input_port().Eval(context)
        inspector = query.inspector()
        return frozenset(
            frozenset(self.drake.GetBodyFromFrameId(inspector.GetFrameId(id)).name() for id in (pair.id_A, pair.id_B))
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(0.0)
        )


def _index(starts: list[int]) -> slice | NDArray[np.intp]:
    """Where the arm's joints are among all: a slice in the usual case that they stand in a row, which is faster."""
    in_row = starts == list(range(starts[0], starts[0] + len(starts)))
    return slice(starts[0], starts[-1] + 1) if in_row else np.array(starts, dtype=np.intp)


@contextmanager
def silent_drake() -> Iterator[None]:
    """Keep Drake from logging that a program has no solution, where that is an answer like any other."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
