"""Overlay of the CAD model on frames: of the tracked gripper, and of the robot that calibrates a camera."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H, GRIPPER_RADIUS_M
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.cad import GripperCad, PartCaster, franka_hand, link_meshes
from kinebench_drake.models.panda.description import ARM, GRIPPER, RobotPart, hand_from_tcp
from kinebench_drake.track import GripperTrack

Image = NDArray[np.uint8]

_COLOURS = {RobotPart.HAND: (0, 190, 200), RobotPart.LEFT_FINGER: (255, 140, 0), RobotPart.RIGHT_FINGER: (230, 60, 160)}
_ROBOT_COLOURS = {
    **dict.fromkeys(ARM[:1], (255, 140, 0)),
    **dict.fromkeys(ARM[1:], (70, 110, 255)),
    **dict.fromkeys(GRIPPER, (0, 190, 200)),
}
_AXES = ((235, 60, 60), (60, 200, 60), (70, 110, 255))
_AXIS_M = 0.05
_OPACITY = 0.35
_LEAST_SIDE_PX = 640
"""Least side of a picture of the robot [px]."""


def _part_map(camera: Camera, X_CH: Array, finger_m: float, cad: GripperCad) -> NDArray[np.uint8]:
    """Return the part labels (H, W) of a gripper mounted on panda_hand at `X_CH` (4, 4)."""
    X_CH = X_CH @ cad.gripper.X_MH
    labels = np.zeros((camera.height, camera.width), np.uint8)
    centre = transform_points(X_CH, GRIPPER_CENTRE_H[None])[0]
    if centre[2] < GRIPPER_RADIUS_M:
        return labels
    reach = max(camera.fx, camera.fy) * GRIPPER_RADIUS_M / (centre[2] - GRIPPER_RADIUS_M) + 2
    u, v = camera.project(centre)
    left, right = (int(np.clip(x, 0, camera.width)) for x in (u - reach, u + reach))
    top, bottom = (int(np.clip(y, 0, camera.height)) for y in (v - reach, v + reach))
    if left < right and top < bottom:
        window = replace(camera, width=right - left, height=bottom - top, cx=camera.cx - left, cy=camera.cy - top)
        _, part = cad.first_hits(X_CH, window.rays().reshape(-1, 3), finger_m)
        labels[top:bottom, left:right] = part.reshape(window.height, window.width)
    return labels


def _tint(frame: Image, labels: NDArray[np.uint8], colours: Mapping[RobotPart, tuple[int, int, int]]) -> Image:
    """Return a copy of `frame` (H, W, 3) with the parts that `labels` (H, W) show tinted and outlined."""
    out = frame.astype(np.float32)
    for label, colour in colours.items():
        region = labels == label
        out[region] = (1 - _OPACITY) * out[region] + _OPACITY * np.array(colour, np.float32)
    image = np.ascontiguousarray(out.astype(np.uint8))
    for label, colour in colours.items():
        contours, _ = cv2.findContours((labels == label).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, contours, -1, colour, 1, cv2.LINE_AA)
    return image


def draw_pose(frame: Image, camera: Camera, X_CH: Array, finger_width_m: float, cad: GripperCad | None) -> Image:
    """Return `frame` (H, W, 3) with the axes of the TCP at `X_CH` (4, 4) of the hand and the gripper, tinted."""
    finger_m = finger_width_m / 2 if np.isfinite(finger_width_m) else 0.02
    labels = np.zeros(frame.shape[:2], np.uint8) if cad is None else _part_map(camera, X_CH, finger_m, cad)
    image = _tint(frame, labels, _COLOURS)
    tips = transform_points(X_CH @ hand_from_tcp(), np.vstack([np.zeros(3), _AXIS_M * np.eye(3)]))
    if (tips[:, 2] > 0.05).all():
        sixteenths = np.rint(16 * (camera.project(tips) - 0.5)).astype(int)  # OpenCV's pixel centres are integers
        origin, *ends = (tuple(pixel) for pixel in sixteenths.tolist())
        for end, colour in zip(ends, _AXES, strict=True):
            cv2.line(image, origin, end, colour, 2, cv2.LINE_AA, 4)
    return image


def draw_caption(image: Image, text: str, colour: tuple[int, int, int] = (255, 255, 255)) -> None:
    """Write `text` into the upper left corner of an image (H, W, 3), in place."""
    size = max(0.4, image.shape[0] / 900)
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    image[: height + 10, : width + 10] //= 3
    cv2.putText(image, text, (5, height + 5), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def draw_overlay(
    frames: Frames,
    camera: Camera,
    track: GripperTrack,
    zoom: Array | None = None,
    *,
    gripper: GripperModel | None,
) -> Iterator[Image]:
    """Yield each of `frames` (T, H, W, 3) with the tracked gripper, frame number, time and confidence.

    A zooming camera has the focal length of `camera` times `zoom` (T,). Without a `gripper`, as it is mounted, only the
    axes are drawn.
    """
    cad = None if gripper is None else GripperCad(gripper)
    for i, frame in enumerate(frames):
        own = camera if zoom is None else replace(camera, fx=camera.fx * zoom[i], fy=camera.fy * zoom[i])
        if track.tracked[i]:
            image = draw_pose(frame, own, track.X_CH[i], float(track.finger_width_m[i]), cad)
            draw_caption(image, f"{i}  t {track.t_s[i]:.1f} s  confidence {track.confidence[i]:.2f}")
        else:
            image = frame.copy()
            draw_caption(image, f"{i}  t {track.t_s[i]:.1f} s  not tracked", (255, 110, 110))
        yield image


def render_parts(camera: Camera, X_BP: Array, finger_m: float) -> NDArray[np.uint8]:
    """Render the CAD robot as values of `RobotPart` (H, W).

    Args:
        camera: camera with its pose.
        X_BP: (PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; parts with NaN are left out.
        finger_m: opening of each finger [m].

    Raises:
        SetupError: Open3D's native libraries or mani_skill's meshes are missing.
    """
    gripper = franka_hand()
    X_CP = gripper.open(invert(camera.X_BC) @ X_BP, finger_m)
    _, part = PartCaster(gripper, link_meshes()).first_hits(X_CP, camera.rays().reshape(-1, 3))
    return part.reshape(camera.height, camera.width)


def draw_robot(frame: Image, camera: Camera, X_BP: Array, finger_m: float) -> Image:
    """Return a copy of `frame` (H, W, 3), enlarged if small, with the CAD robot tinted and outlined.

    Other arguments and errors as of `render_parts`.
    """
    times = max(1, -(-_LEAST_SIDE_PX // min(camera.width, camera.height)))
    camera = camera.resized(times * camera.width, times * camera.height)
    image = np.asarray(cv2.resize(frame, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC), np.uint8)
    return _tint(image, render_parts(camera, X_BP, finger_m), _ROBOT_COLOURS)


def save_image(image: Image, path: Path) -> None:
    """Write an image as png, atomically.

    Raises:
        SetupError: writing failed.
    """
    with atomic_path(path) as part:
        PIL.Image.fromarray(image).save(part, format="png")
