"""The Panda as a Drake plant: forward kinematics, Jacobian, limits."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.robot import (
    ARM_JOINTS,
    BASE_LINK,
    FINGER_JOINTS,
    HAND_LINK,
    LINKS,
    TCP_LINK,
    panda_urdf,
)

N_JOINTS = 7


class PandaPlant:
    """Kinematics of the Panda's seven arm joints, with panda_link0 (B) fixed; no geometry, no collisions.

    Holds one Drake context that every call overwrites: make one object a thread. The fingers are present in the plant
    (as positions 8 and 9) but stay where `finger_width_m` puts them.
    """

    def __init__(self, *, finger_width_m: float = 0.08) -> None:
        """Load the robot (some 10 ms; the first time ever some seconds, to convert the meshes).

        Args:
            finger_width_m: gap between the finger pads, 0..0.08 [m].

        Raises:
            SetupError: the robot's files are missing or cannot be converted.
        """
        plant: Any = MultibodyPlant(time_step=0.0)
        parser: Any = Parser(plant)
        parser.AddModels(str(panda_urdf()))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(BASE_LINK), RigidTransform())
        plant.Finalize()
        self.drake: Any = plant
        """The Drake plant itself, finalised: 7 arm joints, then 2 finger joints."""
        self.context: Any = plant.CreateDefaultContext()
        """The context that the methods use."""
        joints = [plant.GetJointByName(name) for name in ARM_JOINTS]
        fingers = [plant.GetJointByName(name) for name in FINGER_JOINTS]
        if [joint.position_start() for joint in (*joints, *fingers)] != list(range(N_JOINTS + len(fingers))):
            raise RuntimeError("the plant's joints are not in the URDF's order")
        self.lower = np.array([joint.position_lower_limit() for joint in joints])
        """(7,) lower joint limits [rad]."""
        self.upper = np.array([joint.position_upper_limit() for joint in joints])
        """(7,) upper joint limits [rad]."""
        self.velocity_limits = np.array([float(joint.velocity_upper_limits()[0]) for joint in joints])
        """(7,) greatest joint speeds [rad/s]."""
        self._positions = np.full(N_JOINTS + len(fingers), finger_width_m / 2.0)
        self.base_frame: Any = plant.GetFrameByName(BASE_LINK)
        """Frame B."""
        self.tcp_frame: Any = plant.GetFrameByName(TCP_LINK)
        """Frame G."""
        self._hand = plant.GetFrameByName(HAND_LINK)
        self._links = {name: plant.GetFrameByName(name) for name in LINKS}
        self._origin = np.zeros(3)

    def _set(self, q: ArrayLike) -> None:
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (N_JOINTS,):
            raise UsageError(f"q has shape {q.shape}, expected the 7 arm joints in radians")
        self._positions[:N_JOINTS] = q
        self.drake.SetPositions(self.context, self._positions)

    def forward(self, q: ArrayLike) -> Array:
        """Pose X_BG (4, 4) of panda_hand_tcp in panda_link0 [m] at joint angles `q` (7,) [rad]."""
        self._set(q)
        return np.asarray(self.tcp_frame.CalcPoseInWorld(self.context).GetAsMatrix4())

    def forward_hand(self, q: ArrayLike) -> Array:
        """Pose X_BH (4, 4) of panda_hand in panda_link0 [m] at joint angles `q` (7,) [rad]."""
        self._set(q)
        return np.asarray(self._hand.CalcPoseInWorld(self.context).GetAsMatrix4())

    def link_poses(self, q: ArrayLike) -> dict[str, Array]:
        """Poses (4, 4) in panda_link0 [m] of all links of `robot.LINKS`, by name, at joint angles `q` (7,) [rad]."""
        self._set(q)
        return {name: np.asarray(f.CalcPoseInWorld(self.context).GetAsMatrix4()) for name, f in self._links.items()}

    def jacobian(self, q: ArrayLike) -> Array:
        """Geometric Jacobian (6, 7) of panda_hand_tcp in B at `q` (7,) [rad]: `V_BG = J @ qdot`.

        Rows 0-2 are the angular velocity [rad/s], rows 3-5 the velocity of the TCP's origin [m/s], both expressed in
        B (Drake's order of a spatial velocity).
        """
        self._set(q)
        return self._jacobian()

    def _jacobian(self) -> Array:
        J = self.drake.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, self.tcp_frame, self._origin, self.base_frame, self.base_frame
        )
        return np.asarray(J[:, :N_JOINTS])

    def forward_and_jacobian(self, q: ArrayLike) -> tuple[Array, Array]:
        """Both `forward(q)` and `jacobian(q)`, at the price of one."""
        self._set(q)
        return np.asarray(self.tcp_frame.CalcPoseInWorld(self.context).GetAsMatrix4()), self._jacobian()
