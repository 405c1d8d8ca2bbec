"""The file `camera.json`."""

from pathlib import Path

from kinebench_drake.camera import Camera, CameraSetting
from kinebench_drake.errors import UsageError, cause
from kinebench_drake.io.jsonl import read_json, write_json


def load_camera(path: Path, name: str | None = None) -> CameraSetting:
    """Read `camera.json`.

    Args:
        path: the file.
        name: name of the file in messages; None takes the last part of the path.

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
