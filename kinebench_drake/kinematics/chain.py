"""Link poses, Jacobians and torques of many postures at once, in NumPy, with geometry and masses of a Drake plant.

Drake computes one posture per call; for hundreds of postures the calls cost more than the arithmetic.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.tree import BodyIndex

from kinebench_drake.geometry import Array, cross, invert, make_pose
from kinebench_drake.models.robot import Robot

Positions = Callable[[ArrayLike, ArrayLike | None], Array]
"""Function from arm postures (N, J) [rad] and finger widths (N,) [m] to all positions (N, n) of the Drake plant."""


class LinkChain:
    """Product of exponentials of the plant's joints.

    Each link's pose is X_BL(q) = exp(S_1 q_1) ... exp(S_k q_k) X_BL(0), over the joints between base and link, with
    every joint's axis as it lies in B at the zero posture. Source: R. W. Brockett, "Robotic manipulators and the
    product of exponentials formula", Mathematical Theory of Networks and Systems, 1984.
    """

    def __init__(self, drake: Any, robot: Robot, positions: Positions) -> None:
        """Read the joint axes and link poses at the zero posture from a finalized MultibodyPlant.

        `positions` completes arm postures to positions of the whole plant.
        """
        context = drake.CreateDefaultContext()
        drake.SetPositions(context, np.zeros(drake.num_positions()))
        joints = [drake.get_joint(index) for index in drake.GetJointIndices()]
        inboard = {joint.child_body().name(): joint for joint in joints}
        bodies = [drake.get_body(BodyIndex(i)) for i in range(drake.num_bodies())]
        names = [body.name() for body in bodies]
        home = {b.name(): np.asarray(b.EvalPoseInWorld(context).GetAsMatrix4()) for b in bodies}
        self._positions = positions
        self._tcp_link = robot.tcp_link
        moving: list[Any] = []
        self._parents: list[int] = []
        self.stage = {drake.world_body().name(): 0}
        """Index of the motion of each link, by name; 0 for links that never move."""
        self.home: dict[str, Array] = home
        """Poses (4, 4) of the links in B at the zero posture [m]."""

        def visit(name: str) -> int:
            if name not in self.stage:
                joint = inboard[name]
                stage = visit(joint.parent_body().name())
                if joint.num_positions():
                    self._parents.append(stage)
                    moving.append(joint)
                    stage = len(moving)
                self.stage[name] = stage
            return self.stage[name]

        for name in names:
            visit(name)
        turning = np.array([joint.type_name() != "prismatic" for joint in moving])[:, None]
        axes = [j.revolute_axis() if turns else j.translation_axis() for j, turns in zip(moving, turning, strict=True)]
        X = [joint.frame_on_parent().CalcPoseInWorld(context).GetAsMatrix4() for joint in moving]
        self._position = [joint.position_start() for joint in moving]
        self._axis = np.array([X_BF[:3, :3] @ axis for X_BF, axis in zip(X, axes, strict=True)])
        self._shift = np.where(turning, 0.0, self._axis)
        self._point = np.where(turning, [X_BF[:3, 3] for X_BF in X], 0.0)
        rotary = np.where(turning, self._axis, 0.0)
        K = np.array([[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]] for x, y, z in rotary])  # their cross products
        self._K = K
        self._K_squared = K @ K
        first = [next(name for name in names if self.stage[name] == i + 1) for i in range(len(moving))]
        self._carried = [drake.GetBodyByName(name) for name in first]
        self._to_zero = invert([home[name] for name in first])
        self._arm = [[joint.name() for joint in moving].index(name) for name in robot.joints]
        self.turns = turning[self._arm, 0]
        """(J,) False for joints of the arm that slide."""
        self.n_joints = len(robot.joints)
        """Number J of joints of the arm."""
        self._upstream = np.zeros((len(moving) + 1, self.n_joints), dtype=bool)
        for i, parent in enumerate(self._parents):
            self._upstream[i + 1] = self._upstream[parent] | (np.array(self._arm) == i)

        self._read_masses(drake, robot, bodies)

    def _read_masses(self, drake: Any, robot: Robot, bodies: Sequence[Any]) -> None:
        """Read what each arm joint moves and the next does not: one rigid body at the zero posture, fingers at rest."""
        context = drake.CreateDefaultContext()
        drake.SetPositions(context, self._positions(np.zeros((1, self.n_joints)), None)[0])
        last = {b.index(): int(self.carries(b.name()).sum()) for b in bodies if b.index() != drake.world_body().index()}
        parts = [[body for body, count in last.items() if count == j + 1] for j in range(self.n_joints)]
        inertia = [drake.CalcSpatialInertia(context, drake.world_frame(), part).CopyToFullMatrix6() for part in parts]
        self._inertia, self._center, self._mass = _split_inertia(np.array(inertia))
        self._gravity = np.asarray(drake.gravity_field().gravity_vector())
        self._reflected = np.zeros(self.n_joints)
        for index in drake.GetJointActuatorIndices():
            actuator = drake.get_joint_actuator(index)
            if actuator.joint().name() in robot.joints:
                self._reflected[robot.joints.index(actuator.joint().name())] = actuator.default_reflected_inertia()

    def motions(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Array:
        """Return motions (N, stages, 4, 4) from the zero posture to postures `q` (N, J) [rad]; stage 0 is at rest.

        The pose of a link is `motions[:, stage[link]] @ home[link]`. Finger gap `finger_width_m` (N,) [m]; the plant's
        default where None or NaN.
        """
        positions = self._positions(q, finger_width_m)
        M = np.zeros((len(positions), len(self._parents) + 1, 4, 4))
        M[:, 0] = np.eye(4)
        steps = self._steps(positions[:, self._position])
        for i, parent in enumerate(self._parents):
            M[:, i + 1] = M[:, parent] @ steps[:, i]
        return M

    def _steps(self, positions: Array) -> Array:
        """Return the motion (N, J, 4, 4) of each joint by `positions` (N, J) [rad or m] (Rodrigues' formula)."""
        s = np.sin(positions)[..., None, None]
        R = np.eye(3) + s * self._K + (1.0 - np.cos(positions)[..., None, None]) * self._K_squared
        return make_pose(R, self._point - (R @ self._point[..., None])[..., 0] + positions[..., None] * self._shift)

    def current(self, context: Any) -> Array:
        """Return the motions (stages, 4, 4) of the one posture in a context of the Drake plant, computed by Drake."""
        M = np.empty((len(self._parents) + 1, 4, 4))
        M[0] = np.eye(4)
        for i, body in enumerate(self._carried):
            M[i + 1] = body.EvalPoseInWorld(context).GetAsMatrix4()
        M[1:] = M[1:] @ self._to_zero
        return M

    def poses(self, q: ArrayLike, link: str) -> Array:
        """Return the poses (N, 4, 4) of `link` in B [m] at postures `q` (N, J) [rad]."""
        return np.asarray(self.motions(q)[:, self.stage[link]] @ self.home[link])

    def axes(self, motions: Array) -> tuple[Array, Array]:
        """Return the unit axes (N, J, 3) of the arm's joints in B and a point (N, J, 3) [m] on each, from `motions`."""
        M = motions[:, [self._parents[i] for i in self._arm]]
        axis = self._axis[self._arm]
        point = self._point[self._arm]
        return (
            np.asarray((M[..., :3, :3] @ axis[..., None])[..., 0]),
            np.asarray((M[..., :3, :3] @ point[..., None])[..., 0] + M[..., :3, 3]),
        )

    def twists(self, motions: Array) -> tuple[Array, Array]:
        """Return the twist of each arm joint at unit rate, by `motions`: turn (N, J, 3), speed (N, J, 3) at B's origin.

        They are in B [rad/rad or rad/m, and m/rad or m/m].
        """
        axis, point = self.axes(motions)
        speed = cross(point, axis)
        turns = self.turns[:, None]
        return np.where(turns, axis, 0.0), np.where(turns, speed, axis)

    def carries(self, link: str) -> Array:
        """Return (J,): 1 for each arm joint between base and `link`, else 0."""
        return np.asarray(self._upstream[self.stage[link]], dtype=np.float64)

    def jacobians(self, q: ArrayLike) -> Array:
        """Return the geometric Jacobians (N, 6, J) of the TCP in B at `q` (N, J) [rad], rows as `ArmPlant.jacobian`."""
        return self.poses_and_jacobians(q)[1]

    def poses_and_jacobians(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return the poses (N, 4, 4) of the TCP in B [m] and its Jacobians (N, 6, J) at `q` (N, J) [rad]."""
        M = self.motions(q)
        tcp = self._tcp_link
        X = M[:, self.stage[tcp]] @ self.home[tcp]
        axis, point = self.axes(M)
        turns = self.turns[:, None]
        speed = np.where(turns, cross(axis, X[:, None, :3, 3] - point), axis)
        J = np.concatenate([np.where(turns, axis, 0.0), speed], axis=-1)
        return X, np.ascontiguousarray(np.swapaxes(J, -1, -2))

    def torques(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the joint torques (..., N, J) [N m] of motions: those of `ArmPlant.torque`, at once.

        Newton-Euler equations of all links about the origin of B (R. Featherstone, "Rigid Body Dynamics Algorithms",
        2008, sections 2.13 and 5.3), without friction, fingers and other joints at rest: angles `q` (N, J) [rad],
        speeds `v` (..., N, J) [rad/s], accelerations `a` (..., N, J) [rad/s^2].
        """
        v, a = (np.asarray(rates, dtype=np.float64)[..., None] for rates in (v, a))
        motions = self.motions(q)
        axis, lever = self.twists(motions)
        M = motions[:, [i + 1 for i in self._arm]]
        R = M[..., :3, :3]
        center = (R @ self._center[..., None])[..., 0] + M[..., :3, 3]
        inertia = R @ self._inertia @ np.swapaxes(R, -1, -2)
        turn = np.cumsum(axis * v, axis=-2)
        shift = np.cumsum(lever * v, axis=-2)
        turn_rate = np.cumsum(axis * a + cross(turn, axis * v), axis=-2)
        shift_rate = np.cumsum(lever * a + cross(turn, lever * v) + cross(shift, axis * v), axis=-2)
        acceleration = shift_rate + cross(turn_rate, center) + cross(turn, shift + cross(turn, center))
        force = self._mass[:, None] * (acceleration - self._gravity)
        spin = (inertia @ turn[..., None])[..., 0]
        moment = (inertia @ turn_rate[..., None])[..., 0] + cross(turn, spin) + cross(center, force)
        force, moment = (np.cumsum(array[..., ::-1, :], axis=-2)[..., ::-1, :] for array in (force, moment))
        return np.asarray((axis * moment + lever * force).sum(axis=-1) + self._reflected * a[..., 0])


def _split_inertia(spatial: Array) -> tuple[Array, Array, Array]:
    """Return inertia about the centre of mass (K, 3, 3), centre (K, 3) and mass (K,) of spatial inertias (K, 6, 6).

    A spatial inertia about the origin is [[I + m [c] [c]^T, m [c]], [m [c]^T, m 1]] (Featherstone, equation 2.63).
    """
    mass = spatial[:, 5, 5]
    moment = spatial[:, :3, 3:]
    c = np.divide(moment, mass[:, None, None], out=np.zeros_like(moment), where=mass[:, None, None] > 0.0)
    center = np.stack([c[:, 2, 1], c[:, 0, 2], c[:, 1, 0]], axis=-1)
    return spatial[:, :3, :3] - moment @ np.swapaxes(c, -1, -2), center, mass
