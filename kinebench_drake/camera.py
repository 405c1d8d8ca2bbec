"""Pinhole camera: intrinsics in pixels and pose in the robot base frame."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array, checked_pose, invert, make_pose, orthonormalize

_NUMBERS = {"width": int, "height": int, "fx": float, "fy": float, "cx": float, "cy": float}
_KEYS = (*_NUMBERS, "base_from_camera")
_OPTIONAL_KEYS = ("mirrored", "table_height_m")
MAX_TABLE_HEIGHT_M = 2.0
"""Greatest distance of the table top from the robot's base, up or down [m]."""
MAX_DISTANCE_M = 20.0
"""Greatest distance of a camera of a `camera.json` from the robot's base [m]."""
BENCHMARK_PX = 384
"""Width and height of the images of the benchmark."""
CONFIRMED = 0.6
"""Share from which on the arm confirms a camera: of 30 demonstrations of unseen looks right cameras have 0.65 or more
with the postures of the track, mirrored pictures 0.59 or less, cameras with 0.7 or 1.4 times the focal length 0.51."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Pinhole camera without distortion; OpenCV axes (x right, y down, z forward), pixel centres at half-integers."""

    width: int
    """Image width [px]."""
    height: int
    """Image height [px]."""
    fx: float
    """Focal length along x [px]."""
    fy: float
    """Focal length along y [px]."""
    cx: float
    """Principal point along x [px]; width / 2 when centred."""
    cy: float
    """Principal point along y [px]; height / 2 when centred."""
    X_BC: Array
    """Pose (4, 4) of the camera in the robot base frame panda_link0 [m]; `base_from_camera` in files."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            UsageError: a size is not positive, a number is not finite, or the pose is not rigid.
        """
        if self.width < 1 or self.height < 1:
            raise UsageError(f"camera: width and height must be positive, found {self.width} x {self.height}")
        numbers = (self.fx, self.fy, self.cx, self.cy)
        if not np.isfinite(numbers).all() or self.fx <= 0 or self.fy <= 0:
            raise UsageError(f"camera: fx, fy, cx, cy must be finite and fx, fy positive, found {numbers}")
        try:
            object.__setattr__(self, "X_BC", checked_pose(self.X_BC))
        except InputError as error:
            raise UsageError(f"camera: base_from_camera {error}") from None

    @property
    def K(self) -> Array:
        """Intrinsic matrix (3, 3) [px]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def unit_px(self) -> float:
        """Length of one pixel of a benchmark image in this image [px]; limits in pixels refer to benchmark images."""
        return self.width / BENCHMARK_PX

    def project(self, p_C: ArrayLike) -> Array:
        """Project points (..., 3) in the camera frame [m], z positive, to pixel coordinates (..., 2) [px]."""
        p_C = np.asarray(p_C, dtype=np.float64)
        return np.asarray(p_C[..., :2] / p_C[..., 2:] * [self.fx, self.fy] + [self.cx, self.cy])

    def rays(self) -> Array:
        """Return directions (height, width, 3) through the pixel centres, z = 1: `depth * rays` is a point cloud."""
        u = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        v = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        grid = np.ones((self.height, self.width, 3))
        grid[..., 0], grid[..., 1] = np.meshgrid(u, v)
        return grid

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera for images scaled to `width` x `height`.

        Raises:
            UsageError: the aspect ratio differs by more than 1 % (a crop or letter-box, which is no scaling).
        """
        sx = width / self.width
        sy = height / self.height
        if abs(sx / sy - 1.0) > 0.01:
            raise UsageError(
                f"camera is {self.width} x {self.height}, the video {width} x {height}: the aspect ratios differ; "
                "give the video's own camera.json"
            )
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def to_json(self) -> dict[str, int | float | list[list[float]]]:
        """Serialize into the object of `camera.json`."""
        return {**{key: getattr(self, key) for key in _NUMBERS}, "base_from_camera": self.X_BC.tolist()}

    @classmethod
    def from_json(cls, data: object, source: str) -> "Camera":
        """Parse the object of `camera.json`, whose optional keys are left out; `source` names it in messages.

        Raises:
            UsageError: a key is missing, unknown or of the wrong type, or the values are invalid.
        """
        if not isinstance(data, dict):
            raise UsageError(f"{source}: expected an object with {', '.join(_KEYS)}, found {type(data).__name__}")
        missing = sorted(set(_KEYS) - set(data))
        unknown = sorted(map(str, set(data) - set(_KEYS) - set(_OPTIONAL_KEYS)))
        if missing or unknown:
            raise UsageError(
                f"{source}: missing keys {missing}, unknown keys {unknown}; expected {', '.join(_KEYS)}, and "
                f"optionally {', '.join(_OPTIONAL_KEYS)}"
            )
        for key, kind in _NUMBERS.items():
            value = data[key]
            # 1e9: bound of all numbers of a camera; NaN and infinity fail the comparison too
            number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9
            if not number or value != kind(value):
                raise UsageError(f"{source}: {key} must be a number, found {value!r}")
        try:
            X_BC = np.array(data["base_from_camera"], dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise UsageError(f"{source}: base_from_camera must be a 4x4 list of numbers") from None
        try:
            camera = cls(**{key: kind(data[key]) for key, kind in _NUMBERS.items()}, X_BC=X_BC)
        except UsageError as error:
            raise UsageError(f"{source}: {error}") from None
        distance_m = float(np.linalg.norm(camera.X_BC[:3, 3]))
        if distance_m > MAX_DISTANCE_M:
            raise UsageError(
                f"{source}: base_from_camera is {distance_m:.4g} m from the robot's base, at most {MAX_DISTANCE_M:g} m "
                "are accepted; if its translation is in millimetres, divide it by 1000"
            )
        return camera


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSetting:
    """What a `camera.json` states: the camera, and how the picture and the table lie to it."""

    camera: Camera
    mirrored: bool = False
    """True if the frames show the scene mirrored: they are turned left-right before they are measured."""
    table_height_m: float | None = None
    """Height of the table top in the robot base frame [m]; None if it is not stated."""

    @classmethod
    def from_json(cls, data: object, source: str) -> "CameraSetting":
        """Parse the object of `camera.json`; `source` names it in messages.

        Raises:
            UsageError: a key is missing, unknown or of the wrong type, or the values are invalid.
        """
        camera = Camera.from_json(data, source)
        assert isinstance(data, dict)
        mirrored = data.get("mirrored", False)
        height_m = data.get("table_height_m")
        if not isinstance(mirrored, bool):
            raise UsageError(f"{source}: mirrored must be true or false, found {mirrored!r}")
        is_number = isinstance(height_m, int | float) and not isinstance(height_m, bool)
        if height_m is not None and not (is_number and abs(height_m) <= MAX_TABLE_HEIGHT_M):
            raise UsageError(
                f"{source}: table_height_m must be metres from {-MAX_TABLE_HEIGHT_M:g} to {MAX_TABLE_HEIGHT_M:g}, "
                f"found {height_m!r}"
            )
        return cls(camera=camera, mirrored=mirrored, table_height_m=None if height_m is None else float(height_m))


class CameraSource(Enum):
    """Source of a sample's camera, in order of precedence."""

    ARGUMENT = "argument"
    """Argument of a function of the Python interface."""
    MANIFEST = "manifest"
    FOLDER = "folder"
    BENCHMARK = "benchmark"
    OPTION = "option"
    """File of the command line, which precedes all."""
    FITTED = "fitted"
    """Fitted to the arm where its motion is stated, or taken from the real clip of a generated one."""
    RECOGNIZED = "recognized"
    """Another one that is known by name, recognized by the arm."""
    ESTIMATED = "estimated"
    """Estimated from the arm."""
    NONE = "none"
    """None: a lens with a usual field of view is assumed, and there is no base frame."""

    @property
    def is_named(self) -> bool:
        """True if the user or the input names the camera, or determines it before the video is measured."""
        named = (CameraSource.ARGUMENT, CameraSource.MANIFEST, CameraSource.FOLDER, CameraSource.OPTION)
        return self in (*named, CameraSource.FITTED)


class CameraState(Enum):
    """How the camera behind the base frame of a track is known."""

    NAMED = "named"
    """Named by the user or the input."""
    CONFIRMED = "confirmed"
    """Assumed, and confirmed by the arm."""
    ESTIMATED = "estimated"
    """Estimated from the arm, which confirms it."""
    NONE = "none"
    """Unknown: there is no base frame."""


def benchmark_camera() -> Camera:
    """Return the benchmark camera: 384x384, field of view 60 degrees, robot base at (-0.615, 0, 0) in ManiSkill."""
    R_WC = np.array([[0.0, 0.529999, -0.847998], [1.0, 0.0, 0.0], [0.0, -0.847998, -0.529999]])
    X_WC = make_pose(orthonormalize(R_WC), [0.4, 0.0, 0.45])
    X_WB = make_pose(np.eye(3), [-0.615, 0.0, 0.0])
    focal = float(192.0 / np.tan(np.deg2rad(30.0)))
    return Camera(
        width=BENCHMARK_PX, height=BENCHMARK_PX, fx=focal, fy=focal, cx=192.0, cy=192.0, X_BC=invert(X_WB) @ X_WC
    )
