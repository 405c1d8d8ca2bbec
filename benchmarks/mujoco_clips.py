"""Render clips of a Panda by robosuite on MuJoCo: another simulator's look, with exact poses.

It runs in an environment of its own, since robosuite 1.5.2 needs mujoco 3.3.2:

    python -m venv env && env/bin/pip install mujoco==3.3.2 robosuite==1.5.2 av
    MUJOCO_GL=osmesa env/bin/python benchmarks/mujoco_clips.py OUT --count 14 --seed 100
    MUJOCO_GL=osmesa env/bin/python benchmarks/mujoco_clips.py FAULTS --count 9 --faults vanish,teleport,freeze
    MUJOCO_GL=osmesa env/bin/python benchmarks/mujoco_clips.py ROBOTIQ --count 20 --gripper robotiq

Writes OUT/NAME.mp4, OUT/NAME.gt.npz and OUT/manifest.jsonl, in the layout of `python -m benchmarks footage`; with
faults, the truth is that of the shown motion. MuJoCo's software renderer needs Debian's libosmesa6.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import robosuite
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).parent.parent))  # a script of a checkout, which its environment has not installed

from benchmarks.clip_scenes import (
    NO_FAULT,
    camera_json,
    clip_parser,
    is_visible,
    missing_clips,
    motion,
    plant,
    random_camera,
    write_clip,
)

SCENES = ("Lift", "Stack", "PickPlace", "NutAssembly", "Door")
_VISUAL_GROUP = 1
_HIDDEN_GROUP = 0
_STRETCH = np.diag([1.0, 1.35, 1.0])
"""Scale of deformed hands and fingers along the axes of the hand: wider where the fingers move."""
_TABLE_LIFT_M = -0.15
"""Lift of the workspace to the table tops of the scenes, at which their cameras look [m]."""


_GRIPPERS = {"franka": "default", "robotiq": "Robotiq85Gripper"}
_LEVER_M = (0.0376, 0.043)
"""Finger of the Robotiq gripper from the axis of its outer knuckle, open, along y and z [m] (its XML)."""
_PAD_OFFSET_M = -0.0054058
"""The same along y with touching pads [m]."""


def _franka_fingers(width_m: float) -> dict[str, float]:
    """Return joint positions of the Franka hand with its pads `width_m` apart [m]."""
    return {"finger_joint1": width_m / 2, "finger_joint2": -width_m / 2}


def _robotiq_fingers(width_m: float) -> dict[str, float]:
    """Return joint angles of the Robotiq gripper with its pads `width_m` apart [rad]."""
    reach = (width_m / 2 + _PAD_OFFSET_M) / np.hypot(*_LEVER_M)
    turn = float(np.arctan2(*_LEVER_M) - np.arcsin(reach))
    knuckles = ("finger_joint", "left_inner_knuckle_joint", "right_outer_knuckle_joint", "right_inner_knuckle_joint")
    return {**dict.fromkeys(knuckles, turn), "left_inner_finger_joint": -turn, "right_inner_finger_joint": -turn}


class Arm:
    """The Panda in a scene of robosuite."""

    def __init__(self, scene: str, seed: int, gripper: str = "franka") -> None:
        """Create the scene; `seed` places its objects."""
        self.env = robosuite.make(
            scene,
            robots="Panda",
            gripper_types=_GRIPPERS[gripper],
            has_renderer=False,
            has_offscreen_renderer=False,
            use_camera_obs=False,
            seed=seed,
        )
        self.env.reset()
        self.model: Any = self.env.sim.model._model
        self.data: Any = self.env.sim.data._data
        self.joints = [self.model.joint(f"robot0_joint{i}").qposadr[0] for i in range(1, 8)]
        self.dofs = [self.model.joint(f"robot0_joint{i}").dofadr[0] for i in range(1, 8)]
        self.limits = np.array([self.model.joint(f"robot0_joint{i}").range for i in range(1, 8)])
        self._set_fingers = _franka_fingers if gripper == "franka" else _robotiq_fingers
        self.gripper = [
            b
            for b in range(self.model.nbody)
            if self.model.body(b).name == "robot0_right_hand" or "gripper0_right" in self.model.body(b).name
        ]
        mujoco.mj_forward(self.model, self.data)

    @property
    def X_WB(self) -> NDArray[Any]:
        """Pose (4, 4) of panda_link0 in the world [m]."""
        return self._pose("robot0_link0")

    @property
    def X_BH(self) -> NDArray[Any]:
        """Pose (4, 4) of panda_hand in the base frame [m]."""
        return np.asarray(np.linalg.inv(self.X_WB) @ self._pose("robot0_right_hand"))

    def _pose(self, body: str) -> NDArray[Any]:
        X = np.eye(4)
        X[:3, :3] = self.data.body(body).xmat.reshape(3, 3)
        X[:3, 3] = self.data.body(body).xpos
        return X

    def set(self, q: NDArray[Any], width_m: float) -> None:
        """Pose the arm (7,) [rad] and the fingers, `width_m` apart."""
        self.data.qpos[self.joints] = q
        for joint, value in self._set_fingers(width_m).items():
            self.data.qpos[self.model.joint(f"gripper0_right_{joint}").qposadr[0]] = value
        mujoco.mj_forward(self.model, self.data)

    def offset(self, X_BH: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the shift (3,) [m] and the rotation vector (3,) [rad] from the hand to a pose, in the world."""
        hand = self.data.body("robot0_right_hand")
        X_WH = self.X_WB @ X_BH
        turn = np.zeros(3)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, (X_WH[:3, :3] @ hand.xmat.reshape(3, 3).T).ravel())
        mujoco.mju_quat2Vel(turn, quat, 1.0)
        return X_WH[:3, 3] - hand.xpos, turn

    def jacobian(self) -> NDArray[Any]:
        """Return the Jacobian (6, 7) of the hand's position and rotation, in the world."""
        J_position, J_rotation = (np.zeros((3, self.model.nv)) for _ in range(2))
        body = self.model.body("robot0_right_hand").id
        mujoco.mj_jacBody(self.model, self.data, J_position, J_rotation, body)
        return np.vstack([J_position, J_rotation])[:, self.dofs]

    def render(
        self, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any], fault: str = NO_FAULT
    ) -> Iterator[tuple[NDArray[Any], int]]:
        """Yield images (H, W, 3) and the pixels of hand and fingers; the arm stays posed as the image shows."""
        with self._altered(fault):
            film = Film(self, camera)
            try:
                for posture, width_m in zip(q, gap, strict=True):
                    self.set(posture, width_m)
                    yield film.image(), film.gripper_px()
            finally:
                film.close()

    @contextmanager
    def _altered(self, fault: str) -> Iterator[None]:
        """Hide hand and fingers (vanish) or stretch their meshes (deformation) for the renderers created inside."""
        group = self.model.geom_group.copy()
        vertices = self.model.mesh_vert.copy()
        geoms = np.flatnonzero(np.isin(self.model.geom_bodyid, self.gripper) & (group == _VISUAL_GROUP))
        if fault == "vanish":
            self.model.geom_group[geoms] = _HIDDEN_GROUP
        if fault == "deformation":
            R_WH = self.data.body("robot0_right_hand").xmat.reshape(3, 3)
            for geom in geoms:  # the fingers share a mesh, to which they do the same
                mesh = self.model.geom_dataid[geom]
                R = R_WH.T @ self.data.geom_xmat[geom].reshape(3, 3)
                start = self.model.mesh_vertadr[mesh]
                part = slice(start, start + self.model.mesh_vertnum[mesh])
                self.model.mesh_vert[part] = vertices[part] @ R.T @ _STRETCH @ R
        try:
            yield
        finally:
            self.model.geom_group[:] = group
            self.model.mesh_vert[:] = vertices


def stock_camera(arm: Arm, name: str, width: int, height: int) -> dict[str, Any]:
    """Return the camera.json object of a camera of the scene."""
    number = arm.model.cam(name).id
    X = np.eye(4)
    X[:3, :3] = arm.data.cam_xmat[number].reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])  # from OpenGL axes
    X[:3, 3] = arm.data.cam_xpos[number]
    focal = height / 2 / np.tan(np.deg2rad(arm.model.cam_fovy[number]) / 2)
    return camera_json(width, height, focal, np.linalg.inv(arm.X_WB) @ X)


class Film:
    """Renders a scene from a camera that is set freely."""

    def __init__(self, arm: Arm, camera: dict[str, Any]) -> None:
        """Place the camera `frontview`, which every scene has."""
        self._arm = arm
        self._camera = arm.model.cam("frontview").id
        width = camera["width"]
        height = camera["height"]
        arm.model.vis.global_.offwidth = width
        arm.model.vis.global_.offheight = height
        X_WC = arm.X_WB @ np.array(camera["base_from_camera"])
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, (X_WC[:3, :3] @ np.diag([1.0, -1.0, -1.0])).ravel())
        arm.model.cam_pos[self._camera] = X_WC[:3, 3]
        arm.model.cam_quat[self._camera] = quat
        arm.model.cam_bodyid[self._camera] = 0
        arm.model.cam_targetbodyid[self._camera] = -1
        arm.model.cam_mode[self._camera] = mujoco.mjtCamLight.mjCAMLIGHT_FIXED
        arm.model.cam_fovy[self._camera] = np.rad2deg(2 * np.arctan(height / 2 / camera["fy"]))
        self._renderer = mujoco.Renderer(arm.model, height, width)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[_VISUAL_GROUP] = 1

    def image(self) -> NDArray[Any]:
        """Return the image (H, W, 3)."""
        mujoco.mj_forward(self._arm.model, self._arm.data)
        self._renderer.update_scene(self._arm.data, camera=self._camera, scene_option=self._option)
        return np.asarray(self._renderer.render())

    def gripper_px(self) -> int:
        """Return the number of pixels that show hand or fingers."""
        self._renderer.enable_segmentation_rendering()
        shown = self.image()
        self._renderer.disable_segmentation_rendering()
        geom = np.where(shown[..., 1] == mujoco.mjtObj.mjOBJ_GEOM, shown[..., 0], -1)
        body = np.where(geom >= 0, self._arm.model.geom_bodyid[geom], -1)
        return int(np.isin(body, self._arm.gripper).sum())

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


def main() -> None:
    """Render clips from anywhere, or at the cameras of the scenes."""
    parser = clip_parser(__doc__.splitlines()[0], prefix="m")
    parser.add_argument("--stock", help="scenes with their own cameras, in turn, such as Lift:agentview,Door:frontview")
    parser.add_argument("--gripper", choices=sorted(_GRIPPERS), default="franka")
    options = parser.parse_args()
    for number, name, (width, height), fault, rng in missing_clips(options):
        stock = options.stock.split(",") if options.stock else SCENES
        scene, _, own_camera = stock[number % len(stock)].partition(":")
        arm = Arm(scene, options.seed + number, options.gripper)
        take = None
        while take is None:
            q, gap = motion(arm, options.frames, rng)
            if own_camera:
                camera = stock_camera(arm, own_camera, width, height)
                while not is_visible(arm, camera, q, gap):
                    q, gap = motion(arm, options.frames, rng, lift_m=_TABLE_LIFT_M)
            else:
                while not is_visible(arm, camera := random_camera(width, height, rng), q, gap):
                    pass
            take = plant(fault, arm, camera, q, gap, rng)
        write_clip(options.out, name, arm, camera, take)


if __name__ == "__main__":
    main()
