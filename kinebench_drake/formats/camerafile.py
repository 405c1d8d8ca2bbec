"""Cameras by file and by name: `camera.json`, the one that applies to the videos of a folder, and the known cameras.

The known ones stand in `cameras.json`: cameras of simulators and data sets, as the published sources state them.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

from kinebench_drake.camera import Camera, CameraSetting, benchmark_camera
from kinebench_drake.errors import UsageError, cause, suggestion
from kinebench_drake.io.jsonl import Json, read_json, write_json

CAMERA_NAME = "camera.json"
BENCHMARK = "benchmark"
"""Name of the benchmark camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedCamera:
    """Camera of a simulator or a data set."""

    name: str
    setting: CameraSetting
    """Camera with the usual size of its pictures; its field of view is vertical."""
    source: str
    """Repository and files, or package, that the numbers were derived from."""
    checked: str
    """On what the arm confirmed it: "clips" of others, own "renders", or "no"."""
    presented: tuple[str, ...] = ()
    """Other ways in which its pictures are published: "rows_reversed" (raw images of MuJoCo), "mirrored"."""
    also: tuple[str, ...] = ()
    """Further names of the same camera."""

    @property
    def fov_deg(self) -> float:
        """Vertical field of view [degrees]."""
        camera = self.setting.camera
        return round(math.degrees(2 * math.atan(camera.height / 2 / camera.fy)), 2)

    def describe(self) -> str:
        """Describe the camera in one line."""
        camera = self.setting.camera
        height_m = self.setting.table_height_m
        names = ", ".join((self.name, *self.also))
        table = "" if height_m is None else f", table {height_m:g} m"
        ways = "".join(f", also {way}" for way in self.presented)
        return (
            f"{names}: {self.fov_deg:g} degrees, {camera.width} x {camera.height}{table}, checked: {self.checked}"
            f"{ways}; {self.source}"
        )

    def to_json(self) -> dict[str, Json]:
        """Serialize for `kinebench-drake cameras --json`."""
        setting = self.setting
        camera = self.setting.camera
        return {
            "name": self.name,
            "also": list(self.also),
            "fov_deg": self.fov_deg,
            "presented": list(self.presented),
            "checked": self.checked,
            "source": self.source,
            "camera": {**camera.to_json()},
            "table_height_m": setting.table_height_m,
        }


@cache
def named_cameras() -> Mapping[str, NamedCamera]:
    """Return the known cameras by name, the benchmark camera first."""
    own = NamedCamera(
        name=BENCHMARK,
        setting=CameraSetting(camera=benchmark_camera()),
        source="kinebench-drake: the camera of its suites",
        checked="clips",
    )
    listed = json.loads(files("kinebench_drake.formats").joinpath("cameras.json").read_text(encoding="utf-8"))
    others = (
        NamedCamera(
            name=name,
            setting=CameraSetting.from_json(entry["camera"], name),
            source=entry["source"],
            checked=entry["checked"],
            presented=tuple(entry.get("presented", ())),
            also=tuple(entry.get("also", ())),
        )
        for name, entry in listed.items()
    )
    return {camera.name: camera for camera in (own, *others)}


def find_camera(name: str) -> NamedCamera | None:
    """Return the known camera of a name; None if there is none."""
    cameras = named_cameras()
    return cameras.get(name) or next((camera for camera in cameras.values() if name in camera.also), None)


def read_camera(text: str) -> CameraSetting:
    """Return the camera that a name or the path of a `camera.json` denotes.

    Raises:
        UsageError: it is neither; the message lists the nearest names.
    """
    named = find_camera(text)
    if named is not None:
        return named.setting
    path = Path(text)
    if not path.suffix and not path.exists():
        names = [name for camera in named_cameras().values() for name in (camera.name, *camera.also)]
        near = suggestion(text, names)
        raise UsageError(f"no camera {text!r}{near}; name a camera.json, or one that `kinebench-drake cameras` lists")
    return load_camera(path)


def load_camera(path: Path, name: str | None = None) -> CameraSetting:
    """Read `camera.json`; messages call it `name`, or by the last part of its path.

    Raises:
        UsageError: the file cannot be read, is not JSON, or holds no camera.
    """
    name = name or path.name
    try:
        data = read_json(path)
    except (OSError, ValueError) as error:
        raise UsageError(f"{name}: cannot be read as JSON ({cause(error)})") from None
    return CameraSetting.from_json(data, name)


def save_camera(camera: Camera, path: Path) -> None:
    """Write `camera.json`.

    Raises:
        SetupError: writing failed.
    """
    write_json(path, camera.to_json())


class CameraLookup:
    """Cameras of folders: the `camera.json` of a folder or of the nearest one above, up to the named folder."""

    def __init__(self, top: Path) -> None:
        """Start with the folder above which no file is used.

        Raises:
            UsageError: its file is unusable, which is reported even if no sample needs it.
        """
        self._top = top
        self._cameras: dict[Path, CameraSetting | None] = {}
        self.find(top)

    def find(self, folder: Path) -> CameraSetting | None:
        """Return the camera of the videos in a folder; None if there is no file."""
        if folder not in self._cameras:
            file = folder / CAMERA_NAME
            if file.exists():
                self._cameras[folder] = load_camera(file, str(file))
            else:
                within = folder != self._top and folder.is_relative_to(self._top)
                self._cameras[folder] = self.find(folder.parent) if within else None
        return self._cameras[folder]

    def assign(self, folder: Path, file: Path) -> None:
        """Use a `file` elsewhere, if it exists, for `folder` and below, unless that has its own."""
        if file.is_file() and not (folder / CAMERA_NAME).exists():
            self._cameras[folder] = load_camera(file, str(file))
