"""Drake plant of the arm: forward kinematics, Jacobian, limits, inverse dynamics, collision geometry."""

from collections.abc import Iterable
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
from kinebench_drake.models.arm import panda
from kinebench_drake.models.drake_log import silent_drake
from kinebench_drake.models.obstacles import is_obstacle
from kinebench_drake.models.robot import Robot

ASSUMED_SPEED = float(np.pi)
"""Speed by which paths of joints without a speed limit are compared [rad/s]: half a turn a second, as of small arms."""


class ArmPlant:
    """Arm of J = 5 to 7 joints with its base link fixed at the origin of B.

    It has one Drake context that every call overwrites: use one object per thread. The fingers are part of the plant,
    at the positions that `finger_width_m` sets.
    """

    def __init__(self, robot: Robot | None = None, *, finger_width_m: float = 0.08) -> None:
        """Load the robot, the Panda by default: some 100 ms; some seconds on first use, which converts the meshes.

        The fingers' default gap is `finger_width_m`, 0..0.08 [m].

        Raises:
            SetupError: the Panda's files are missing or cannot be converted.
            InputError: Drake cannot load the robot.
        """
        self.robot = robot or panda()
        """Names, files and limits."""
        builder: Any = DiagramBuilder()
        plant: Any
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        try:
            with silent_drake():  # a line for each element that is not of use here
                Parser(plant).AddModels(self.robot.urdf)
            base = plant.GetFrameByName(self.robot.base_link)
            if base.body().index() != plant.world_body().index():
                plant.WeldFrames(plant.world_frame(), base, RigidTransform())
            plant.Finalize()
        except (RuntimeError, ValueError) as error:
            raise InputError(f"{self.robot.name}: Drake cannot load this robot ({cause(error)})") from None
        self.drake: Any = plant
        """Finalized MultibodyPlant: for the Panda the arm joints, then the fingers."""
        self.diagram: Any = builder.Build()
        """Diagram of the plant and its scene graph."""
        joints = [plant.GetJointByName(name) for name in self.robot.joints]
        fingers = [plant.GetJointByName(name) for name in self.robot.finger_joints]
        self.arm = _index([joint.position_start() for joint in joints])
        """Indices of the arm joints in the plant's positions; other joints may come before or between."""
        self.arm_rates = _index([joint.velocity_start() for joint in joints])
        """Indices of the arm joints in the plant's velocities."""
        self._fingers = np.array([joint.position_start() for joint in fingers], dtype=np.intp)
        self._half = 0.5 * np.array(self.robot.finger_signs)
        self._opening = np.array([[j.position_lower_limit(), j.position_upper_limit()] for j in fingers]).reshape(-1, 2)
        limits = self.robot.limits
        self.lower = limits.lower
        self.upper = limits.upper
        """(J,) lower and upper joint limits [rad]."""
        self.velocity_limits = limits.velocity
        """(J,) joint speed limits at any position [rad/s]; `limits.speeds` are those at one position."""
        self.planned_speeds = np.where(np.isfinite(limits.velocity), limits.velocity, ASSUMED_SPEED)
        """(J,) joint speeds by which paths are compared [rad/s]: the limits, where they are stated."""
        self.acceleration_limits = limits.acceleration
        """(J,) joint acceleration limits [rad/s^2]; None if not stated."""
        self.jerk_limits = limits.jerk
        """(J,) joint jerk limits [rad/s^3]; None if not stated."""
        self.effort_limits = limits.torque
        """(J,) joint torque limits [N m]."""
        self.finger_width_m = finger_width_m
        """Default gap between the finger pads [m]."""
        low = plant.GetPositionLowerLimits()
        self._default = np.clip(np.zeros(plant.num_positions()), low, plant.GetPositionUpperLimits())
        self._default[self._fingers] = np.clip(finger_width_m * self._half, *self._opening.T)
        self._positions = self._default.copy()
        self.chain = LinkChain(plant, self.robot, self.positions)
        """Link poses and Jacobians of many postures at once."""
        pairs = self.robot.allowed_pairs
        self.allowed_pairs = self._contacts(0.5 * (self.lower + self.upper)) if pairs is None else pairs
        """Pairs of links excluded from contact checks, besides those that Drake excludes itself."""
        self._exclude_pairs(scene_graph)
        self._root = self.diagram.CreateDefaultContext()
        self.context: Any = plant.GetMyMutableContextFromRoot(self._root)
        """Context of the plant that the methods use."""
        self.base_frame: Any = plant.GetFrameByName(self.robot.base_link)
        """Frame B."""
        self.tcp_frame: Any = plant.GetFrameByName(self.robot.tcp_link)
        """Frame G."""
        moved = plant.GetBodiesKinematicallyAffectedBy([joints[-1].index()])
        self.tool = frozenset(plant.get_body(index).name() for index in moved)
        """Links beyond the last arm joint: fixed relative to the TCP, but for the fingers."""
        self._links = {name: plant.GetFrameByName(name) for name in self.robot.links}
        self._rates = np.zeros((2, plant.num_velocities()))
        self._no_forces = MultibodyForces(plant)

    @property
    def rate_limits(self) -> tuple[Array, Array | None, Array | None]:
        """Limits (J,) of speed [rad/s], acceleration [rad/s^2] and jerk [rad/s^3]; None if not stated."""
        return self.velocity_limits, self.acceleration_limits, self.jerk_limits

    def set_posture(self, q: ArrayLike, finger_width_m: float | None = None) -> None:
        """Set the context to posture `q` (J,) [rad] and finger gap `finger_width_m` [m].

        Raises:
            UsageError: `q` is not (J,).
        """
        q = np.asarray(q, dtype=np.float64)
        if q.shape != self.lower.shape:
            raise UsageError(f"q has shape {q.shape}, expected the {len(self.lower)} arm joints in radians")
        self._positions[:] = self._default
        self._positions[self.arm] = q
        if finger_width_m is not None:
            self._positions[self._fingers] = np.clip(finger_width_m * self._half, *self._opening.T)
        self.drake.SetPositions(self.context, self._positions)

    def positions(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Array:
        """Return the positions (N, n) of all joints of the plant at postures `q` (N, J) [rad], in Drake's order.

        Fingers: gap `finger_width_m` (N,) [m], clipped to their limits; the default gap where None or NaN. Other joints
        are at 0, or at their limit nearest to 0.

        Raises:
            UsageError: `q` is not (N, J).
        """
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != len(self.lower):
            raise UsageError(f"q has shape {q.shape}, expected (N, {len(self.lower)}) arm joints in radians")
        positions = np.tile(self._default, (len(q), 1))
        positions[:, self.arm] = q
        if finger_width_m is not None:
            width = np.asarray(finger_width_m, dtype=np.float64)[:, None]
            fingers = np.clip(width * self._half, *self._opening.T)
            positions[:, self._fingers] = np.where(np.isfinite(width), fingers, self._default[self._fingers])
        return positions

    def forward(self, q: ArrayLike) -> Array:
        """Return the pose X_BG (4, 4) of the TCP in the base [m] at joint angles `q` (J,) [rad]."""
        self.set_posture(q)
        return np.asarray(self.tcp_frame.CalcPoseInWorld(self.context).GetAsMatrix4())

    def forward_path(self, q: Iterable[ArrayLike]) -> Array:
        """Return `forward` (N, 4, 4) [m] of postures `q` (N, J) [rad]."""
        return np.reshape([self.forward(row) for row in q], (-1, 4, 4))

    def link_poses(self, q: ArrayLike) -> dict[str, Array]:
        """Return the poses (4, 4) in B [m] of `robot.links`, by name, at joint angles `q` (J,) [rad]."""
        self.set_posture(q)
        return {name: np.asarray(f.CalcPoseInWorld(self.context).GetAsMatrix4()) for name, f in self._links.items()}

    def jacobian(self, q: ArrayLike) -> Array:
        """Return the geometric Jacobian (6, J) of the TCP in B at `q` (J,) [rad]: `V_BG = J @ qdot`.

        Rows 0-2 are the angular velocity [rad/s], rows 3-5 the velocity of the TCP's origin [m/s], both expressed in
        B (Drake's order of a spatial velocity).
        """
        return self.forward_and_jacobian(q)[1]

    def forward_and_jacobian(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return `forward(q)` and `jacobian(q)`, setting the context once."""
        X_BG = self.forward(q)
        J = self.drake.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, self.tcp_frame, np.zeros(3), self.base_frame, self.base_frame
        )
        return X_BG, np.asarray(J[:, self.arm_rates])

    def torque(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the joint torques (J,) [N m] of a motion with the robot's payload, by Drake's inverse dynamics.

        tau = M(q) a + C(q, v) v - tau_g(q), without friction: `q` (J,) [rad], `v` [rad/s], `a` [rad/s^2], fingers at
        rest.
        """
        self.set_posture(q)
        self._rates[:, self.arm_rates] = v, a
        self.drake.SetVelocities(self.context, self._rates[0])
        inverse = self.drake.CalcInverseDynamics(self.context, self._rates[1], self._no_forces)
        return np.asarray((inverse - self.drake.CalcGravityGeneralizedForces(self.context))[self.arm_rates])

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return the mass matrix (J, J) [kg m^2] of the arm at `q` (J,) [rad], fingers fixed."""
        self.set_posture(q)
        return np.asarray(self.drake.CalcMassMatrix(self.context)[self.arm_rates][:, self.arm_rates])

    def query(self, q: ArrayLike, finger_width_m: float | None = None) -> Any:
        """Return Drake's QueryObject of the geometry at `q` (J,) [rad], excluded pairs of links left out."""
        self.set_posture(q, finger_width_m)
        return self.drake.get_geometry_query_input_port().Eval(self.context)

    def _exclude_pairs(self, scene_graph: Any) -> None:
        """Exclude from contact checks the allowed pairs and links with no arm joint between them."""
        manager = scene_graph.collision_filter_manager()
        bodies = [self.drake.get_body(BodyIndex(i)) for i in range(self.drake.num_bodies())]
        geometry = {body.name(): self.drake.GetCollisionGeometriesForBody(body) for body in bodies}
        for pair in sorted(self.allowed_pairs, key=sorted):
            first, second = (GeometrySet(geometry.get(name, [])) for name in (sorted(pair) * 2)[:2])
            manager.Apply(CollisionFilterDeclaration().ExcludeBetween(first, second))
        rigid_groups: dict[tuple[float, ...], list[Any]] = {}
        for name, ids in geometry.items():
            rigid_groups.setdefault(tuple(self.chain.carries(name)), []).extend(ids)
        for ids in rigid_groups.values():
            manager.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(ids)))

    def _contacts(self, q: Array) -> frozenset[frozenset[str]]:
        """Return the pairs of links in contact at `q` (J,) [rad], Drake's own exclusions and obstacles left out."""
        context = self.drake.GetMyMutableContextFromRoot(self.diagram.CreateDefaultContext())
        self.drake.SetPositions(context, self.positions(q[None])[0])
        query = self.drake.get_geometry_query_input_port().Eval(context)
        inspector = query.inspector()
        pairs = frozenset(
            frozenset(self.drake.GetBodyFromFrameId(inspector.GetFrameId(id)).name() for id in (pair.id_A, pair.id_B))
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(0.0)
        )
        return frozenset(pair for pair in pairs if not any(map(is_obstacle, pair)))


def _index(starts: list[int]) -> slice | NDArray[np.intp]:
    """Return an index of the arm joints: a slice if they are consecutive, which is faster."""
    consecutive = starts == list(range(starts[0], starts[0] + len(starts)))
    return slice(starts[0], starts[-1] + 1) if consecutive else np.array(starts, dtype=np.intp)
