"""Files of episodes: clips, and first frames, manifest and camera of the videos that a model elsewhere is to make."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from kinebench_drake.camera import BENCHMARK_PX, benchmark_camera
from kinebench_drake.formats.camerafile import CAMERA_NAME, save_camera
from kinebench_drake.formats.manifest import NAME
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.jsonl import as_object, read_lines, write_lines
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import REQUESTS

_CLIP = re.compile(r"(?P<id>.+)_r\d+(\.[^.]+)?")
"""Names of the clips that a world model generated for an episode."""


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


def list_files(out: Path, rows: Mapping[str, SampleRow]) -> dict[str, list[Path]]:
    """List the clips of the episodes in an output folder, and the files of a video that one waits for, by its id."""
    files: dict[str, list[Path]] = {id: _pending_files(out, row) for id, row in rows.items()}
    folder = out / "videos"
    for clip in sorted(folder.iterdir()) if folder.is_dir() else ():
        match = _CLIP.fullmatch(clip.name)
        if match and match["id"] in rows:
            files[match["id"]] += sorted(clip.rglob("*")) if clip.is_dir() else [clip]
    return files


def _pending_files(out: Path, row: SampleRow) -> list[Path]:
    asked = None if row.pending is None else str(row.pending.get("id"))
    if asked is None or asked != Path(asked).name:
        return []
    image = request_path(out, asked)
    return [image, image.with_suffix(".json")]
