"""Cameras of simulators and data sets by name, as their published sources state them (`cameras.json`)."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from kinebench_drake.camera import CameraSetting, benchmark_camera

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

    def to_json(self) -> dict[str, str | float | list[str] | dict[str, int | float | list[list[float]]] | None]:
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
            "camera": camera.to_json(),
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
    listed = json.loads(files("kinebench_drake").joinpath("cameras.json").read_text(encoding="utf-8"))
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
