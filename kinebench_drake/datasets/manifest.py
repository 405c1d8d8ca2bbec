"""The `manifest.jsonl` format: one JSON object a line, naming a video and its metadata."""

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from kinebench_drake.camera import Camera
from kinebench_drake.datasets.ids import shorten
from kinebench_drake.datasets.videos.sample import CameraSource, VideoSample, camera_of
from kinebench_drake.datasets.videos.search import Search, picture_beside
from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.geometry import checked_pose
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.io.files import read_text, require_accessible
from kinebench_drake.io.jsonl import parse_json
from kinebench_drake.types import InitialState

NAME = "manifest.jsonl"

UNREAD = frozenset({"frames", "suite", "split"})
"""Keys that `suite export` and `suite demos` write for world models; nothing here reads them, or warns of them."""

MIN_PERIOD_S, MAX_PERIOD_S = 1e-4, 1e3
"""Shortest and longest task time between two frames [s]."""
WIDEST_M, PLAY_M = 0.08, 0.002
"""Greatest gap between the finger pads, and how far a measured one may lie outside its range [m]."""


def _rigid(rows: list[list[float]]) -> list[list[float]]:
    try:
        checked_pose(rows)
    except InputError as error:
        raise ValueError(str(error)) from None
    return rows


_Number = Annotated[float, Field(allow_inf_nan=False)]
_Row = Annotated[list[_Number], Field(min_length=4, max_length=4)]
_Pose = Annotated[list[_Row], Field(min_length=4, max_length=4), AfterValidator(_rigid)]
"""A rigid pose, 4x4 by rows."""


class ManifestEntry(BaseModel):
    """One line of a manifest: keys, types and limits."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    video: Annotated[str, Field(min_length=1)]
    """Path of the video (file, frame folder, npy or npz), relative to the manifest and inside its folder."""
    id: Annotated[str, Field(min_length=1)] | None = None
    task: str | None = None
    seed: int | None = None
    model: str | None = None
    prompt: str | None = None
    fps: Annotated[float, Field(ge=1.0 / MAX_PERIOD_S, le=1.0 / MIN_PERIOD_S, allow_inf_nan=False)] | None = None
    """Frames per second the video plays at, over what the file says [1/s]."""
    frame_period_s: Annotated[float, Field(ge=MIN_PERIOD_S, le=MAX_PERIOD_S, allow_inf_nan=False)] | None = None
    """Task time between two frames [s]."""
    camera: dict[str, object] | Annotated[str, Field(min_length=1)] | None = None
    """The camera as an object, or the relative path of its file."""
    first_base_from_tcp: _Pose | None = None
    """panda_hand_tcp in the robot base frame, in the first frame [m]."""
    first_finger_width_m: Annotated[float, Field(ge=-PLAY_M, le=WIDEST_M + PLAY_M, allow_inf_nan=False)] | None = None
    """Gap between the finger pads in the first frame; says nothing without the pose."""
    first_frame: Annotated[str, Field(min_length=1)] | None = None
    """Relative path of the picture that the video's maker was given to begin with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ManifestLine:
    """One line as read: an entry, or what is wrong with it."""

    number: int
    """Line number from 1."""
    entry: ManifestEntry | None
    """The line's content; None when it cannot be used."""
    problem: str | None
    """Why it cannot be used; None when it can."""
    video: str
    """The video as named on the line; empty when the line names none."""
    id: str | None
    """The id as named on the line, if it is a text."""
    unknown: tuple[str, ...]
    """Keys nobody reads."""


def read_manifest(path: Path) -> list[ManifestLine]:
    """Read every line; lines that cannot be used carry their problem instead of stopping the others.

    Raises:
        UsageError: the file cannot be read, or holds no line.
    """
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path.name}: cannot be read as text ({cause(error)})") from None
    lines = [_read_line(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip()]
    if not lines:
        raise UsageError(f'{path.name}: is empty, expected one JSON object a line, such as {{"video": "a.mp4"}}')
    return lines


def _read_line(number: int, text: str) -> ManifestLine:
    try:
        data = parse_json(text)
    except ValueError as error:
        return _broken(number, f"line {number} is not JSON ({error})")
    if not isinstance(data, dict):
        return _broken(number, f"line {number} is a {type(data).__name__}, expected an object with the key video")
    video, id = (data.get(key) if isinstance(data.get(key), str) else None for key in ("video", "id"))
    unknown = tuple(sorted(set(data) - set(ManifestEntry.model_fields) - UNREAD))
    try:
        entry, problem = ManifestEntry.model_validate(data), None
    except ValidationError as error:
        entry, problem = None, f"line {number}: {_explain(error)}"
    return ManifestLine(number=number, entry=entry, problem=problem, video=video or "", id=id or None, unknown=unknown)


def _broken(number: int, problem: str) -> ManifestLine:
    return ManifestLine(number=number, entry=None, problem=problem, video="", id=None, unknown=())


def _explain(error: ValidationError) -> str:
    """One clause a wrong key: its name, what was found and what was expected."""
    told: dict[str, str] = {}
    for fault in error.errors(include_url=False):
        key = str(fault["loc"][0]) if fault["loc"] else "the line"
        found = "is missing" if fault["type"] == "missing" else f"is {fault['input']!r:.60}"
        told.setdefault(key, f"{key} {found} ({fault['msg'].lower()})")
    return "; ".join(told.values())


def inside(folder: Path, relative: str, what: str) -> Path:
    """The path of `relative`, which must stay inside `folder` even after links are followed.

    Raises:
        InputError: it is absolute, climbs out by `..`, follows a link out or cannot be followed.
    """
    pure = PurePosixPath(relative)
    if pure.is_absolute() or ".." in pure.parts or "\0" in relative:
        raise InputError(f"{what} {relative!r} must be a relative path inside the manifest's folder")
    path = require_accessible(folder / pure, f"{what} {relative!r}")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{what} {relative!r} is a link that leads out of the manifest's folder")
    return path


def entry_camera(entry: ManifestEntry, folder: Path) -> Camera | None:
    """The camera a line brings along; None when it leaves that to the folder.

    Raises:
        InputError: the camera cannot be used or lies outside the manifest's folder.
    """
    if entry.camera is None:
        return None
    try:
        if isinstance(entry.camera, str):
            return load_camera(inside(folder, entry.camera, "camera"))
        return Camera.from_json(entry.camera, "camera")
    except UsageError as error:
        raise InputError(str(error)) from None


def list_manifest(path: Path, search: Search) -> list[VideoSample]:
    """A sample a line; a line that cannot be used is one with a problem.

    Raises:
        UsageError: the file cannot be read, or a camera.json beside a video is unusable.
    """
    samples, unknown = [], Counter[str]()
    for line in read_manifest(path):
        unknown.update(line.unknown)
        samples.append(_sample(line, path.parent, search))
    if unknown:
        told = ", ".join(f"{key!r} ({n} x)" for key, n in sorted(unknown.items()))
        search.warnings.append(
            f"{path.name}: unknown keys {told} are not read; known are {', '.join(ManifestEntry.model_fields)}"
        )
    return samples


def _sample(line: ManifestLine, folder: Path, search: Search) -> VideoSample:
    name = line.video or f"line-{line.number}"
    stem = Path(name).name if os.path.isdir(folder / name) else Path(name).stem
    given = None if line.id is None else shorten(line.id)
    given = given if given is None or stem in given else f"{given}-{stem}"
    entry, problem, camera, path, first_frame = line.entry, line.problem, None, folder, None
    if entry is not None:
        try:
            path = inside(folder, entry.video, "video")
            camera = entry_camera(entry, folder)
            first_frame = _picture(entry, folder) or picture_beside(path)
        except InputError as error:
            problem = f"line {line.number}: {error}"
    found = search.cameras.of(path if path.is_dir() else path.parent) if problem is None else None
    taken, source = (camera, CameraSource.MANIFEST) if camera else camera_of(found)
    return VideoSample(
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
        initial_state=_first(entry) if entry else None,
        first_frame=first_frame,
        problem=problem,
    )


def _picture(entry: ManifestEntry, folder: Path) -> Path | None:
    """The first frame's picture; none where it was left behind, as `suite export` names it beside every video."""
    if entry.first_frame is None:
        return None
    path = inside(folder, entry.first_frame, "first_frame")
    return path if path.is_file() else None


def _first(entry: ManifestEntry) -> InitialState | None:
    if entry.first_base_from_tcp is None:
        return None
    X_BG, width = checked_pose(entry.first_base_from_tcp), entry.first_finger_width_m
    if width is None:
        return InitialState(X_BG=X_BG)
    return InitialState(X_BG=X_BG, finger_width_m=float(np.clip(width, 0.0, WIDEST_M)))
