"""Render clips of a Panda by PyBullet's software renderer: another simulator's look, with exact poses.

It runs in an environment of its own, as the other simulators do:

    python -m venv env && env/bin/pip install pybullet==3.2.7 av
    env/bin/python benchmarks/bullet_clips.py OUT --count 14 --seed 100
    env/bin/python benchmarks/bullet_clips.py FAULTS --count 6 --faults vanish,teleport,freeze

Writes OUT/NAME.mp4, OUT/NAME.gt.npz and OUT/manifest.jsonl, in the layout of `python -m benchmarks footage`. Robot,
objects and textures are those of pybullet_data. The frames of its Panda equal Franka's within 0.2 um and 1e-6 rad.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
import pybullet_data
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).parent.parent))  # a script of a checkout, which its environment has not installed

from benchmarks.clip_scenes import (
    NO_FAULT,
    clip_parser,
    is_visible,
    missing_clips,
    motion,
    plant,
    random_camera,
    write_clip,
)

_HAND = 8
"""Number of panda_hand among the links of panda.urdf."""
_FINGERS = (9, 10)
_FAULTS = ("vanish", "teleport", "freeze")
_LIMITS = np.array(
    [
        [-2.8973, 2.8973], [-1.7628, 1.7628], [-2.8973, 2.8973], [-3.0718, -0.0698],
        [-2.8973, 2.8973], [-0.0175, 3.7525], [-2.8973, 2.8973],
    ]
)  # fmt: skip
"""Franka's limits of the joints [rad]; those of panda.urdf that PyBullet reads are wider."""
_OBJECTS = (
    ("cube_small.urdf", 1.0),
    ("duck_vhacd.urdf", 0.9),
    ("soccerball.urdf", 0.08),
    ("lego/lego.urdf", 1.3),
    ("jenga/jenga.urdf", 0.7),
    ("domino/domino.urdf", 1.2),
    ("objects/mug.urdf", 0.7),
    ("sphere_small.urdf", 0.8),
    ("teddy_vhacd.urdf", 0.9),
    ("block.urdf", 1.5),
    ("tray/traybox.urdf", 0.5),
    ("random_urdfs/{:03d}/{:03d}.urdf", 0.8),
)
"""Objects of pybullet_data and their scale; `{}` is drawn."""
_RANDOM_OBJECTS = 1000
_FLOORS = (
    None, "checker_blue.png", "checker_grid.jpg", "tex256.png", "table/table.png", "tray/tray.jpg",
    "roboschool/models_outdoor/stadium/stadium_grass.jpg",
)  # fmt: skip
"""Textures of the floor; None: one colour."""
_AREA_M = np.array([[0.3, 0.75], [-0.4, 0.4]])
"""Where objects stand in the base frame [m]."""
_TABLE_M = 0.625
"""Height of the top of table.urdf [m]."""
_DEPTH_M = (0.05, 60.0)
"""Least and greatest depth that is rendered [m]."""
_SAMPLE_PX = 0.5
"""Shift of TinyRenderer's samples from the centres of the pixels, to the left and down [px]."""


class BulletArm:
    """The Panda in a scene of PyBullet, with its base at the origin of the world."""

    limits = _LIMITS

    def __init__(self, rng: np.random.Generator) -> None:
        """Create the scene."""
        pybullet.resetSimulation()
        self._robot = pybullet.loadURDF("franka_panda/panda.urdf", useFixedBase=True)
        self._obstacles = [_ground(rng)]
        for _ in range(rng.integers(3, 7)):
            _add_object(rng, self._obstacles)
        _walls(rng)
        self._light = _light(rng)

    @property
    def X_BH(self) -> NDArray[Any]:
        """Pose (4, 4) of panda_hand in the base frame [m]."""
        link = pybullet.getLinkState(self._robot, _HAND, computeForwardKinematics=True)
        X = np.eye(4)
        X[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(link[5]), (3, 3))
        X[:3, 3] = link[4]
        return X

    def set(self, q: NDArray[Any], width_m: float) -> None:
        """Pose the arm (7,) [rad] and the fingers, `width_m` apart."""
        for joint, angle in enumerate(q):
            pybullet.resetJointState(self._robot, joint, angle)
        for joint in _FINGERS:
            pybullet.resetJointState(self._robot, joint, width_m / 2)
        self._positions = [*q.tolist(), width_m / 2, width_m / 2]

    def offset(self, X_BH: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the shift (3,) [m] and the rotation vector (3,) [rad] from the hand to a pose."""
        now = self.X_BH
        R = X_BH[:3, :3] @ now[:3, :3].T
        axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        sine = np.linalg.norm(axis) / 2
        angle = np.arctan2(sine, (np.trace(R) - 1) / 2)
        return X_BH[:3, 3] - now[:3, 3], axis * (angle / max(2 * sine, 1e-9))

    def jacobian(self) -> NDArray[Any]:
        """Return the Jacobian (6, 7) of the hand's position and rotation."""
        rest = [0.0] * len(self._positions)
        parts = pybullet.calculateJacobian(self._robot, _HAND, [0.0, 0.0, 0.0], self._positions, rest, rest)
        return np.vstack(parts)[:, :7]

    def is_clear(self, q: NDArray[Any], gap: NDArray[Any]) -> bool:
        """Return whether no link but the base touches floor or objects."""
        for posture, width_m in zip(q, gap, strict=True):
            self.set(posture, width_m)
            for body in self._obstacles:
                if any(contact[3] >= 0 for contact in pybullet.getClosestPoints(self._robot, body, 0.0)):
                    return False
        return True

    def render(
        self, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any], fault: str = NO_FAULT
    ) -> Iterator[tuple[NDArray[Any], int]]:
        """Yield images (H, W, 3) and the pixels of hand and fingers; the arm stays posed as the image shows."""
        for link in (_HAND, *_FINGERS):
            pybullet.changeVisualShape(self._robot, link, rgbaColor=[1.0, 1.0, 1.0, float(fault != "vanish")])
        shape = camera["height"], camera["width"]
        X_CB = np.linalg.inv(np.array(camera["base_from_camera"]))
        view = np.diag([1.0, -1.0, -1.0, 1.0]) @ X_CB  # to OpenGL axes
        gripper = [self._robot + ((link + 1) << 24) for link in (_HAND, *_FINGERS)]
        for posture, width_m in zip(q, gap, strict=True):
            self.set(posture, width_m)
            _, _, rgba, _, parts = pybullet.getCameraImage(
                camera["width"], camera["height"], view.T.ravel().tolist(), projection(camera).T.ravel().tolist(),
                shadow=True, flags=pybullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
                renderer=pybullet.ER_TINY_RENDERER, **self._light,
            )  # fmt: skip
            image = np.reshape(np.asarray(rgba, dtype=np.uint8), (*shape, 4))[..., :3]
            yield np.ascontiguousarray(image), int(np.isin(parts, gripper).sum())


def projection(camera: dict[str, Any]) -> NDArray[Any]:
    """Return OpenGL's projection (4, 4) of a camera.json object, for TinyRenderer's samples."""
    near, far = _DEPTH_M
    width = camera["width"]
    height = camera["height"]
    P = np.zeros((4, 4))
    P[0, 0] = 2 * camera["fx"] / width
    P[1, 1] = 2 * camera["fy"] / height
    P[0, 2] = 1 - 2 * (camera["cx"] - _SAMPLE_PX) / width
    P[1, 2] = 2 * (camera["cy"] + _SAMPLE_PX) / height - 1
    P[2, 2:] = -(far + near) / (far - near), -2 * far * near / (far - near)
    P[3, 2] = -1.0
    return P


def _ground(rng: np.random.Generator) -> int:
    """Load a floor, or a table on a floor, whose top is at the foot of the robot; return its number."""
    on_table = rng.random() < 0.4
    floor = pybullet.loadURDF("plane.urdf", [0.0, 0.0, -_TABLE_M if on_table else 0.0])
    _paint(floor, rng, _FLOORS[rng.integers(len(_FLOORS))])
    if not on_table:
        return int(floor)
    table = pybullet.loadURDF("table/table.urdf", [rng.uniform(0.35, 0.55), rng.uniform(-0.1, 0.1), -_TABLE_M])
    if rng.random() < 0.5:
        _paint(table, rng, None)
    return int(table)


def _paint(body: int, rng: np.random.Generator, texture: str | None) -> None:
    """Give a body a texture and a colour; strong colours only where there is no texture."""
    least = 0.25 if texture is None else 0.7
    colour = [*rng.uniform(least, 1.0, 3), 1.0]
    if texture is not None:
        pybullet.changeVisualShape(body, -1, textureUniqueId=pybullet.loadTexture(texture))
    else:
        pybullet.changeVisualShape(body, -1, textureUniqueId=-1)
    pybullet.changeVisualShape(body, -1, rgbaColor=colour)


def _add_object(rng: np.random.Generator, bodies: list[int]) -> None:
    """Load an object, and stand it on the ground, clear of the others of `bodies`, of which the first is the ground."""
    name, scale = _OBJECTS[rng.integers(len(_OBJECTS))]
    number = rng.integers(_RANDOM_OBJECTS)
    scale *= rng.uniform(0.8, 1.3)
    body = pybullet.loadURDF(name.format(number, number), useFixedBase=True, globalScaling=scale)
    if rng.random() < 0.5:
        pybullet.changeVisualShape(body, -1, rgbaColor=[*rng.uniform(0.1, 1.0, 3), 1.0])
    height_m = pybullet.getBasePositionAndOrientation(body)[0][2] - pybullet.getAABB(body)[0][2]
    while True:
        turn = pybullet.getQuaternionFromEuler([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        pybullet.resetBasePositionAndOrientation(body, [*rng.uniform(*_AREA_M.T), height_m], turn)
        if not any(pybullet.getClosestPoints(body, other, 0.0) for other in bodies[1:]):
            break
    bodies.append(body)


def _walls(rng: np.random.Generator) -> None:
    """Put walls behind and beside the robot, in most scenes."""
    for centre, half in (
        ([-rng.uniform(0.9, 2.5), 0.0, 1.0], [0.02, 14.0, 2.0]),
        ([0.0, -rng.uniform(2.4, 3.5), 1.0], [14.0, 0.02, 2.0]),
        ([0.0, rng.uniform(2.4, 3.5), 1.0], [14.0, 0.02, 2.0]),
    ):
        colour = [*rng.uniform(0.4, 1.0, 3), 1.0]
        if rng.random() < 0.6:
            shape = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, rgbaColor=colour)
            pybullet.createMultiBody(0, -1, shape, centre)


def _light(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a light for `getCameraImage`."""
    azimuth = rng.uniform(-np.pi, np.pi)
    elevation = rng.uniform(1.1, 1.45)  # below, the renderer covers the ground with false shadows
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    return {
        "lightDirection": away.tolist(), "lightDistance": rng.uniform(2.0, 3.0),
        "lightColor": rng.uniform(0.85, 1.0, 3).tolist(), "lightAmbientCoeff": rng.uniform(0.4, 0.7),
        "lightDiffuseCoeff": rng.uniform(0.25, 0.5), "lightSpecularCoeff": rng.uniform(0.0, 0.2),
    }  # fmt: skip


def main() -> None:
    """Render clips from anywhere."""
    options = clip_parser(__doc__.splitlines()[0], prefix="b", faults=_FAULTS).parse_args()
    pybullet.connect(pybullet.DIRECT)
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath())
    for _, name, (width, height), fault, rng in missing_clips(options):
        arm = BulletArm(rng)
        take = None
        while take is None or not arm.is_clear(take.q, take.gap):
            while not arm.is_clear(*(moved := motion(arm, options.frames, rng))):
                pass
            while not is_visible(arm, camera := random_camera(width, height, rng), *moved):
                pass
            take = plant(fault, arm, camera, *moved, rng)
        write_clip(options.out, name, arm, camera, take)


if __name__ == "__main__":
    main()
