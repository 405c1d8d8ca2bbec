"""Search options and camera lookup shared by all video formats."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from kinebench_drake.camera import Camera
from kinebench_drake.datasets.videos.sample import VideoSample, camera_of
from kinebench_drake.errors import InputError
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.io.files import IMAGE_SUFFIXES, require_accessible

CAMERA_NAME = "camera.json"


class CameraLookup:
    """The `camera.json` that holds for a folder: its own or the nearest above, up to the named folder."""

    def __init__(self, top: Path) -> None:
        """Look no higher than `top`.

        Raises:
            UsageError: the file there is unusable, which is told at once, even if no sample needs it.
        """
        self._top = top
        self._known: dict[Path, Camera | None] = {}
        self.of(top)

    def of(self, folder: Path) -> Camera | None:
        """The camera of what lies in `folder`.

        Raises:
            UsageError: its file is unusable.
        """
        if folder not in self._known:
            file = folder / CAMERA_NAME
            if file.exists():
                self._known[folder] = load_camera(file, str(file))
            else:
                within = folder != self._top and folder.is_relative_to(self._top)
                self._known[folder] = self.of(folder.parent) if within else None
        return self._known[folder]

    def settle(self, folder: Path, file: Path) -> None:
        """Let a `file` elsewhere, if there is one, hold for `folder` and below, unless that has one of its own.

        Raises:
            UsageError: it is unusable.
        """
        if file.is_file() and not (folder / CAMERA_NAME).exists():
            self._known[folder] = load_camera(file, str(file))


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """Where a search began, and what it may choose."""

    top: Path
    """The folder that was named, or that holds the file that was named."""
    cameras: CameraLookup
    camera_key: str | None
    """The camera to take where a dataset has several, by name or part of it."""
    warnings: list[str] = field(default_factory=list)
    """What the user should know; formats add to it."""

    def name(self, path: Path) -> str:
        """A path as results name it."""
        return self.top.resolve().name if path == self.top else path.relative_to(self.top).as_posix()

    def choose(self, keys: Sequence[str], where: str) -> str:
        """The camera of a dataset: the one named, else the only one.

        Args:
            keys: cameras there are.
            where: the dataset, for the message.

        Raises:
            InputError: none is named and there are several, or the name fits none or several.
        """
        if not keys:
            raise InputError(f"{where} holds no video")
        wanted = self.camera_key
        if wanted is None:
            if len(keys) == 1:
                return keys[0]
            raise InputError(f"{where} has {len(keys)} cameras ({', '.join(keys)}): choose one with --camera-key NAME")
        found = [key for key in keys if key == wanted] or [key for key in keys if wanted in _parts(key)]
        if len(found) != 1:
            told = f"fits {', '.join(found)}" if found else "is none of its cameras"
            raise InputError(f"--camera-key {wanted} {told}; {where} has {', '.join(keys)}")
        return found[0]


def below(folder: Path, relative: str) -> Path:
    """A path that a dataset names. Links are followed wherever they lead: the Hub's cache consists of them.

    Raises:
        InputError: it is absolute, climbs out of the folder or cannot be followed.
    """
    pure = PurePosixPath(relative)
    if pure.is_absolute() or ".." in pure.parts or "\0" in relative:
        raise InputError(f"{relative!r} must be a relative path inside the dataset's folder")
    return require_accessible(folder / pure, repr(relative))


def plain(path: Path, search: Search) -> VideoSample:
    """A sample about which nothing is known but its file."""
    camera, source = camera_of(search.cameras.of(path if path.is_dir() else path.parent))
    return VideoSample(
        id=path.resolve().name if path.is_dir() else path.stem,
        path=path,
        video=search.name(path),
        camera=camera,
        camera_source=source,
        first_frame=picture_beside(path),
    )


def picture_beside(path: Path) -> Path | None:
    """The picture called like a video: what `suite export` wrote and a model was given; None if there is none."""
    if path.is_dir():
        return None
    beside = (path.with_suffix(suffix) for suffix in sorted(IMAGE_SUFFIXES, reverse=True))
    return next((picture for picture in beside if os.path.isfile(picture)), None)  # a longer suffix may be too long


def _parts(key: str) -> list[str]:
    return key.replace(".", "/").split("/")
