"""Videos that the episodes of a run wait for: first frames, manifest and camera, for a model that runs elsewhere."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from kinebench_drake.camera import BENCHMARK_PX, benchmark_camera
from kinebench_drake.formats.camerafile import CAMERA_NAME, save_camera
from kinebench_drake.formats.manifest import NAME
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.jsonl import as_object, read_lines, write_lines
from kinebench_drake.results.store import REQUESTS


def request_path(out: Path, id: str) -> Path:
    """Return the path of the first frame of a round that waits for its video."""
    return out / REQUESTS / f"{id}.png"


def write_requests(out: Path, requests: Sequence[Mapping[str, object]]) -> None:
    """Write manifest and camera of the rounds that wait for their videos; remove the first frames of others."""
    folder = out / REQUESTS
    wanted = _files(requests)
    with disk_errors(folder.name):
        for name in _files(read_lines(folder / NAME, as_object)) - wanted:
            if Path(name).name == name:
                (folder / name).unlink(missing_ok=True)
        if requests:
            save_camera(benchmark_camera().resized(BENCHMARK_PX, BENCHMARK_PX), folder / CAMERA_NAME)
            write_lines(folder / NAME, requests)
        elif folder.is_dir():
            for name in (CAMERA_NAME, NAME):
                (folder / name).unlink(missing_ok=True)
            if not any(folder.iterdir()):  # else videos were put beside the first frames
                folder.rmdir()


def _files(requests: Sequence[Mapping[str, object]]) -> set[str]:
    """Return the names of the files of some requests."""
    return {name for row in requests for key in ("first_frame", "actions") if isinstance(name := row.get(key), str)}
