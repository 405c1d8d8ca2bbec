"""Videos that a `manifest.jsonl` lists."""

import os
from collections import Counter
from pathlib import Path

import numpy as np

from kinebench_drake import manifest
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import checked_pose
from kinebench_drake.grounding.known import FirstFrame
from kinebench_drake.identity import shorten
from kinebench_drake.inputs.sample import CameraSource, Sample, camera_of
from kinebench_drake.inputs.search import Search, picture_beside


def list_manifest(path: Path, search: Search) -> list[Sample]:
    """A sample a line; a line that cannot be used is one with a problem.

    Raises:
        UsageError: the file cannot be read, or a camera.json beside a video is unusable.
    """
    samples, unknown = [], Counter[str]()
    for line in manifest.read_manifest(path):
        unknown.update(line.unknown)
        samples.append(_sample(line, path.parent, search))
    if unknown:
        told = ", ".join(f"{key!r} ({n} x)" for key, n in sorted(unknown.items()))
        search.warnings.append(
            f"{path.name}: unknown keys {told} are not read; known are {', '.join(manifest.Entry.model_fields)}"
        )
    return samples


def _sample(line: manifest.Line, folder: Path, search: Search) -> Sample:
    name = line.video or f"line-{line.number}"
    stem = Path(name).name if os.path.isdir(folder / name) else Path(name).stem
    given = None if line.id is None else shorten(line.id)
    given = given if given is None or stem in given else f"{given}-{stem}"
    entry, problem, camera, path, first_frame = line.entry, line.problem, None, folder, None
    if entry is not None:
        try:
            path = manifest.inside(folder, entry.video, "video")
            camera = manifest.entry_camera(entry, folder)
            first_frame = _picture(entry, folder) or picture_beside(path)
        except InputError as error:
            problem = f"line {line.number}: {error}"
    found = search.cameras.of(path if path.is_dir() else path.parent) if problem is None else None
    taken, source = (camera, CameraSource.MANIFEST) if camera else camera_of(found)
    return Sample(
        id=given or stem,
        path=path,
        video=line.video,
        camera=taken,
        camera_source=source,
        task=entry.task if entry else None,
        model=entry.model if entry else None,
        seed=entry.seed if entry else None,
        prompt=entry.prompt if entry else None,
        fps=entry.fps if entry else None,
        frame_period_s=entry.frame_period_s if entry else None,
        first=_first(entry) if entry else None,
        first_frame=first_frame,
        problem=problem,
    )


def _picture(entry: manifest.Entry, folder: Path) -> Path | None:
    """The first frame's picture; none where it was left behind, as `suite export` names it beside every video."""
    if entry.first_frame is None:
        return None
    path = manifest.inside(folder, entry.first_frame, "first_frame")
    return path if path.is_file() else None


def _first(entry: manifest.Entry) -> FirstFrame | None:
    if entry.first_base_from_tcp is None:
        return None
    X_BG, width = checked_pose(entry.first_base_from_tcp), entry.first_finger_width_m
    if width is None:
        return FirstFrame(X_BG=X_BG)
    return FirstFrame(X_BG=X_BG, finger_width_m=float(np.clip(width, 0.0, manifest.WIDEST_M)))
