"""Overlay of the CAD robot on a frame with a calibrated camera, for visual inspection of the calibration."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.environment import native
from kinebench_drake.geometry import Array, invert, make_pose, transform_points
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.models.panda.cad import link_meshes, part_meshes
from kinebench_drake.models.panda.robot import ARM, GRIPPER, OPENING_SIGN, RobotPart

Image = NDArray[np.uint8]

_OPACITY = 0.3
_COLOURS = {"gripper": (0, 190, 200), "arm": (70, 110, 255), "base": (255, 140, 0)}
_LEAST_SIDE_PX = 640


def render_part_map(camera: Camera, X_BP: Array, finger_m: float) -> NDArray[np.uint8]:
    """Render the CAD robot as values of `RobotPart` (H, W).

    Args:
        camera: camera with its pose.
        X_BP: (PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; parts with NaN are left out.
        finger_m: opening of each finger [m].

    Raises:
        SetupError: Open3D's native libraries or mani_skill's meshes are missing.
    """
    open3d = native.load_open3d()
    core: Any = open3d.core
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    part_of_mesh = {}
    X_CB = invert(camera.X_BC)
    for part, mesh in {**part_meshes(), **link_meshes()}.items():
        if not np.isfinite(X_BP[part]).all():
            continue
        opening = make_pose(np.eye(3), [0.0, OPENING_SIGN.get(part, 0.0) * finger_m, 0.0])
        vertices = transform_points(X_CB @ X_BP[part] @ opening, np.asarray(mesh.vertices))
        number = scene.add_triangles(
            core.Tensor(vertices.astype(np.float32)), core.Tensor(np.asarray(mesh.faces, np.uint32))
        )
        part_of_mesh[int(number)] = part
    rays = np.zeros((camera.height, camera.width, 6), np.float32)
    rays[..., 3:] = camera.rays()
    hit = scene.cast_rays(core.Tensor(rays), nthreads=1)["geometry_ids"].numpy()
    labels = np.zeros(hit.shape, np.uint8)
    for number, part in part_of_mesh.items():
        labels[hit == number] = part
    return labels


def draw_robot(frame: Image, camera: Camera, X_BP: Array, finger_m: float) -> Image:
    """Return a copy of `frame` (H, W, 3), enlarged if small, with the CAD robot tinted and outlined.

    Args:
        frame: image.
        camera: camera with its pose.
        X_BP: (PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; parts with NaN are left out.
        finger_m: opening of each finger [m].

    Raises:
        SetupError: Open3D's native libraries or mani_skill's meshes are missing.
    """
    times = max(1, -(-_LEAST_SIDE_PX // min(camera.width, camera.height)))
    camera = camera.resized(times * camera.width, times * camera.height)
    image = np.asarray(cv2.resize(frame, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC), np.uint8)
    labels = render_part_map(camera, X_BP, finger_m)
    for name, parts in (("base", (RobotPart.LINK0,)), ("arm", ARM[1:]), ("gripper", GRIPPER)):
        colour = np.array(_COLOURS[name])
        shown = np.isin(labels, parts)
        image[shown] = ((1 - _OPACITY) * image[shown] + _OPACITY * colour).astype(np.uint8)
        for part in parts:
            contours, _ = cv2.findContours((labels == part).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(image, contours, -1, _COLOURS[name], 1, cv2.LINE_AA)
    return image


def save_image(image: Image, path: Path) -> None:
    """Write an image as png, atomically.

    Raises:
        SetupError: writing failed.
    """
    with atomic_path(path) as part:
        PIL.Image.fromarray(image).save(part, format="png")
