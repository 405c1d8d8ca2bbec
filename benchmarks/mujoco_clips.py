"""Render clips of a Panda by robosuite on MuJoCo: another simulator's look, with exact poses.

It runs in an environment of its own, since robosuite 1.5.2 needs mujoco 3.3.2:

    python -m venv env && env/bin/pip install mujoco==3.3.2 robosuite==1.5.2 av
    MUJOCO_GL=osmesa env/bin/python benchmarks/mujoco_clips.py OUT --count 14 --seed 100

Writes OUT/NAME.mp4, OUT/NAME.gt.npz and OUT/manifest.jsonl, in the layout of `python -m benchmarks footage`. MuJoCo's
software renderer needs Debian's libosmesa6.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import mujoco
import numpy as np
import robosuite
from numpy.typing import NDArray

SCENES = ("Lift", "Stack", "PickPlace", "NutAssembly", "Door")
SHAPES = ((384, 384), (640, 480), (512, 320), (480, 480), (256, 256))
HAND_TO_TCP_M = 0.1034
PERIOD_S = 0.2
FINGER_M = 0.04
_VISUAL_GROUP = 1
_WORKSPACE = np.array([[0.32, 0.62], [-0.3, 0.3], [0.06, 0.4]])
"""Box of the TCP's positions in the base frame [m]."""
_TABLE_LIFT_M = -0.15
"""Lift of the workspace to the table tops of the scenes, at which their cameras look [m]."""
_LEAST_PX = 300
"""Pixels of the gripper from which it is visible, in an image of 384 px."""
_LEAST_SHARE = 0.8
"""Least share of the frames in which it is visible."""


class Arm:
    """The Panda in a scene of robosuite."""

    def __init__(self, scene: str, seed: int) -> None:
        """Create the scene; `seed` places its objects."""
        np.random.seed(seed)  # noqa: NPY002 - the generator that robosuite draws from
        self.env = robosuite.make(
            scene, robots="Panda", has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False
        )
        self.env.reset()
        self.model: Any = self.env.sim.model._model
        self.data: Any = self.env.sim.data._data
        self.joints = [self.model.joint(f"robot0_joint{i}").qposadr[0] for i in range(1, 8)]
        self.dofs = [self.model.joint(f"robot0_joint{i}").dofadr[0] for i in range(1, 8)]
        self.limits = np.array([self.model.joint(f"robot0_joint{i}").range for i in range(1, 8)])
        self.fingers = [self.model.joint(f"gripper0_right_finger_joint{i}").qposadr[0] for i in (1, 2)]
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
        self.data.qpos[self.fingers] = [width_m / 2, -width_m / 2]
        mujoco.mj_forward(self.model, self.data)

    def solve(self, X_BH: NDArray[Any], q: NDArray[Any]) -> NDArray[Any] | None:
        """Return the posture (7,) that reaches a pose of the hand, from `q` on; None if none is found."""
        J_position, J_rotation = (np.zeros((3, self.model.nv)) for _ in range(2))
        body = self.model.body("robot0_right_hand").id
        for _ in range(200):
            self.set(q, 0.04)
            X_WH = self.X_WB @ X_BH
            off = X_WH[:3, 3] - self.data.body(body).xpos
            turn = np.zeros(3)
            quat = np.zeros(4)
            mujoco.mju_mat2Quat(quat, (X_WH[:3, :3] @ self.data.body(body).xmat.reshape(3, 3).T).ravel())
            mujoco.mju_quat2Vel(turn, quat, 1.0)
            if np.linalg.norm(off) < 1e-3 and np.linalg.norm(turn) < 1e-2:
                return q
            mujoco.mj_jacBody(self.model, self.data, J_position, J_rotation, body)
            J = np.vstack([J_position, J_rotation])[:, self.dofs]
            step = J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(6), np.concatenate([off, turn]))
            q = np.clip(q + np.clip(step, -0.2, 0.2), self.limits[:, 0] + 0.05, self.limits[:, 1] - 0.05)
        return None


def motion(
    arm: Arm, frames: int, rng: np.random.Generator, *, lift_m: float = 0.0
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return postures (T, 7) [rad] and finger gaps (T,) [m] of a smooth motion through random poses of the hand.

    The workspace is lifted by `lift_m`.
    """
    q = np.array([0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])
    targets = list[NDArray[Any]]()
    stops = max(2, round(frames / 16) + 1)
    while len(targets) < stops:
        tilt = rng.normal(0.0, 0.3, 2)
        turn = rng.uniform(-1.2, 1.2)
        X = np.eye(4)
        X[:3, :3] = _turn(2, turn) @ _turn(0, np.pi + tilt[0]) @ _turn(1, tilt[1])
        X[:3, 3] = rng.uniform(*_WORKSPACE.T) - HAND_TO_TCP_M * X[:3, 2]
        X[2, 3] += lift_m
        reached = arm.solve(X, q)
        if reached is not None and (not targets or np.abs(reached - targets[-1]).max() < 0.5 * np.pi):
            targets.append(reached)
            q = reached
    s = np.linspace(0.0, stops - 1, frames)
    first = np.minimum(s.astype(int), stops - 2)
    u = s - first
    u = u**3 * (10 - 15 * u + 6 * u**2)  # minimum jerk (Flash and Hogan 1985)
    postures = np.array(targets)
    gap = rng.uniform(0.0, 2 * FINGER_M, stops)
    blend = (1 - u)[:, None], u[:, None]
    return (
        blend[0] * postures[first] + blend[1] * postures[first + 1],
        blend[0][:, 0] * gap[first] + blend[1][:, 0] * gap[first + 1],
    )


def _turn(axis: int, angle: float) -> NDArray[Any]:
    R = np.eye(3)
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    R[i, i] = R[j, j] = np.cos(angle)
    R[i, j] = -np.sin(angle)
    R[j, i] = np.sin(angle)
    return R


def random_camera(width: int, height: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return a camera.json object: in front of or beside the robot, upright, looking at its workspace."""
    fov = np.deg2rad(rng.uniform(36.0, 65.0))
    focal = height / 2 / np.tan(fov / 2)
    azimuth = rng.uniform(-1.7, 1.7)
    elevation = rng.uniform(0.1, 1.05)
    target = np.array([0.3, 0.0, 0.25]) + rng.normal(0.0, 0.08, 3)
    distance = rng.uniform(0.75, 1.15) / np.tan(fov / 2) * 0.55
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    return camera_json(width, height, focal, look_at(target + distance * away, target))


def look_at(eye: NDArray[Any], target: NDArray[Any]) -> NDArray[Any]:
    """Return the pose (4, 4) of an upright camera at `eye` that looks at `target`; OpenCV axes."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    X = np.eye(4)
    X[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    X[:3, 3] = eye
    return X


def camera_json(width: int, height: int, focal: float, X_BC: NDArray[Any]) -> dict[str, Any]:
    """Return the object of camera.json of a centred camera."""
    return {
        "width": width, "height": height, "fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2,
        "base_from_camera": X_BC.tolist(),
    }  # fmt: skip


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
        bodies = range(arm.model.nbody)
        self._gripper = [
            b
            for b in bodies
            if arm.model.body(b).name == "robot0_right_hand" or "gripper0_right" in arm.model.body(b).name
        ]

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
        return int(np.isin(body, self._gripper).sum())

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


def render(arm: Arm, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any]) -> Iterator[tuple[NDArray[Any], int]]:
    """Yield images and pixels of the gripper."""
    film = Film(arm, camera)
    try:
        for posture, width_m in zip(q, gap, strict=True):
            arm.set(posture, width_m)
            yield film.image(), film.gripper_px()
    finally:
        film.close()


def is_visible(arm: Arm, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any]) -> bool:
    """Return whether a camera shows the gripper in most of some frames."""
    some = np.linspace(0, len(q) - 1, 5).round().astype(int)
    least = _LEAST_PX * min(camera["width"], camera["height"]) ** 2 / 384**2
    return bool(np.mean([n >= least for _, n in render(arm, camera, q[some], gap[some])]) >= _LEAST_SHARE)


def write_video(path: Path, frames: Sequence[NDArray[Any]]) -> None:
    """Write images (H, W, 3) as H.264."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=17, options={"crf": "20"})
        stream.height, stream.width, _ = frames[0].shape
        stream.pix_fmt = "yuv420p"
        for image in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def write_clip(folder: Path, name: str, arm: Arm, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any]) -> None:
    """Render a clip and write it with its truth and its line of the manifest."""
    frames = []
    visible = []
    X_BH = []
    for image, count in render(arm, camera, q, gap):
        frames.append(image)
        visible.append(count)
        X_BH.append(arm.X_BH)
    write_video(folder / f"{name}.mp4", frames)
    tcp = np.eye(4)
    tcp[2, 3] = HAND_TO_TCP_M
    poses = np.array(X_BH)
    np.savez_compressed(
        folder / f"{name}.gt.npz",
        base_from_hand=poses, base_from_tcp=poses @ tcp, q=q, finger_width_m=gap, visible=np.array(visible),
    )  # fmt: skip
    with (folder / "manifest.jsonl").open("a") as manifest:
        manifest.write(json.dumps({"video": f"{name}.mp4", "frame_period_s": PERIOD_S, "camera": camera}) + "\n")


def main() -> None:
    """Render clips from anywhere, or at the cameras of the scenes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=14)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--frames", type=int, default=49)
    parser.add_argument("--prefix", default="m")
    parser.add_argument("--size", help="WxH of all clips; default: five shapes in turn")
    parser.add_argument("--stock", help="scenes with their own cameras, in turn, such as Lift:agentview,Door:frontview")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for number in range(options.count):
        name = f"{options.prefix}{number:02d}"
        if (options.out / f"{name}.gt.npz").exists():
            continue
        rng = np.random.default_rng([options.seed, number])
        stock = options.stock.split(",") if options.stock else SCENES
        scene, _, own_camera = stock[number % len(stock)].partition(":")
        arm = Arm(scene, options.seed + number)
        width, height = (
            tuple(map(int, options.size.split("x"))) if options.size else SHAPES[(number // 2) % len(SHAPES)]
        )
        q, gap = motion(arm, options.frames, rng)
        if own_camera:
            camera = stock_camera(arm, own_camera, width, height)
            while not is_visible(arm, camera, q, gap):
                q, gap = motion(arm, options.frames, rng, lift_m=_TABLE_LIFT_M)
        else:
            while not is_visible(arm, camera := random_camera(width, height, rng), q, gap):
                pass
        write_clip(options.out, name, arm, camera, q, gap)
        print(name, flush=True)


if __name__ == "__main__":
    main()
