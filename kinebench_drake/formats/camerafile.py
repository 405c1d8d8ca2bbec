"""Cameras by file: `camera.json`, and the one that applies to the videos of a folder."""

from pathlib import Path

from kinebench_drake.camera import Camera, CameraSetting
from kinebench_drake.errors import UsageError, cause, suggestion
from kinebench_drake.io.jsonl import read_json, write_json
from kinebench_drake.named_cameras import find_camera, named_cameras

CAMERA_NAME = "camera.json"


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
