"""Link poses and Jacobians of many postures at once, in NumPy, with the geometry of a Drake plant.

Drake computes one posture per call; for hundreds of postures the calls cost more than the arithmetic.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.tree import BodyIndex

from kinebench_drake.geometry import Array, cross, invert, make_pose
from kinebench_drake.models.robot import N_JOINTS, Robot

Positions = Callable[[ArrayLike, ArrayLike | None], Array]
"""Function from arm postures (N, 7) [rad] and finger widths (N,) [m] to all positions (N, n) of the Drake plant."""


class LinkChain:
    """Product of exponentials of the plant's joints.

    Each link's pose is X_BL(q) = exp(S_1 q_1) ... exp(S_k q_k) X_BL(0), over the joints between base and link, with
    every joint's axis as it lies in B at the zero posture. Source: R. W. Brockett, "Robotic manipulators and the
    product of exponentials formula", Mathematical Theory of Networks and Systems, 1984.
    """

    def __init__(self, drake: Any, robot: Robot, positions: Positions) -> None:
        """Read the joint axes and link poses at the zero posture from a finalized Drake plant.

        Args:
            drake: the MultibodyPlant.
            robot: names of the arm's joints and of the TCP link.
            positions: completes arm postures to positions of the whole plant.
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
        self._K = np.array([[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]] for x, y, z in rotary])  # their cross products
        first = [next(name for name in names if self.stage[name] == i + 1) for i in range(len(moving))]
        self._carried = [drake.GetBodyByName(name) for name in first]
        self._to_zero = invert([home[name] for name in first])
        self._arm = [[joint.name() for joint in moving].index(name) for name in robot.joints]
        self._upstream = np.zeros((len(moving) + 1, N_JOINTS), dtype=bool)
        for i, parent in enumerate(self._parents):
            self._upstream[i + 1] = self._upstream[parent] | (np.array(self._arm) == i)

    def motions(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Array:
        """Return motions (N, stages, 4, 4) from the zero posture to postures `q` (N, 7) [rad]; stage 0 is at rest.

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
        s, c = np.sin(positions)[..., None, None], np.cos(positions)[..., None, None]
        R = np.eye(3) + s * self._K + (1.0 - c) * (self._K @ self._K)
        return make_pose(R, self._point - (R @ self._point[..., None])[..., 0] + positions[..., None] * self._shift)

    def current(self, context: Any) -> Array:
        """Return the motions (stages, 4, 4) of the one posture in a context of the Drake plant, computed by Drake."""
        M = np.empty((len(self._parents) + 1, 4, 4))
        M[0] = np.eye(4)
        for i, body in enumerate(self._carried):
            M[i + 1] = body.EvalPoseInWorld(context).GetAsMatrix4()
        M[1:] = M[1:] @ self._to_zero
        return M

    def poses(self, q: ArrayLike, link: str, finger_width_m: ArrayLike | None = None) -> Array:
        """Return the poses (N, 4, 4) of `link` in B [m] at postures `q` (N, 7) [rad]."""
        return np.asarray(self.motions(q, finger_width_m)[:, self.stage[link]] @ self.home[link])

    def axes(self, motions: Array) -> tuple[Array, Array]:
        """Return the unit axes (N, 7, 3) of the arm's joints in B and a point (N, 7, 3) [m] on each, from `motions`."""
        M = motions[:, [self._parents[i] for i in self._arm]]
        axis, point = self._axis[self._arm], self._point[self._arm]
        return (
            np.asarray((M[..., :3, :3] @ axis[..., None])[..., 0]),
            np.asarray((M[..., :3, :3] @ point[..., None])[..., 0] + M[..., :3, 3]),
        )

    def carries(self, link: str) -> Array:
        """Return (7,): 1 for each arm joint between base and `link`, else 0."""
        return np.asarray(self._upstream[self.stage[link]], dtype=np.float64)

    def jacobians(self, q: ArrayLike) -> Array:
        """Return the geometric Jacobians (N, 6, 7) of the TCP in B at `q` (N, 7) [rad], rows as `ArmPlant.jacobian`."""
        M = self.motions(q)
        tcp = self._tcp_link
        p = (M[:, self.stage[tcp]] @ self.home[tcp])[:, None, :3, 3]
        axis, point = self.axes(M)
        J = np.concatenate([axis, cross(axis, p - point)], axis=-1)
        return np.ascontiguousarray(np.swapaxes(J, -1, -2))
