"""The format `manifest.jsonl`: one JSON object per line with a video and its metadata."""

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from kinebench_drake.camera import CameraSetting, CameraSource
from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.formats.folders import join_relative
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S, shorten
from kinebench_drake.formats.videos.sample import Search, VideoSample, image_beside
from kinebench_drake.geometry import checked_pose
from kinebench_drake.io.files import read_text
from kinebench_drake.io.jsonl import as_type, parse_json
from kinebench_drake.named_cameras import find_camera
from kinebench_drake.track import MAX_WIDTH_M, InitialState
from kinebench_drake.view_name import check_view

NAME = "manifest.jsonl"

UNREAD = frozenset({"frames", "suite", "split", "negative_prompt"})
"""Keys that `suite export` and `suite demos` write for world models: ignored without a warning."""

WIDTH_TOLERANCE_M = 0.002
"""How far a measured gap between the pads may lie outside its range [m]."""


def _rigid(rows: list[list[float]]) -> list[list[float]]:
    try:
        checked_pose(rows)
    except InputError as error:
        raise ValueError(str(error)) from None
    return rows


def _view_text(value: object) -> object:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


_LABELS = {"task", "model", "seed", "prompt", "fps", "frame_period_s", "view"}
"""Keys that a sample takes over unchanged."""

_Number = Annotated[float, Field(allow_inf_nan=False)]
_Row = Annotated[list[_Number], Field(min_length=4, max_length=4)]
_Pose = Annotated[list[_Row], Field(min_length=4, max_length=4), AfterValidator(_rigid)]
"""Rigid pose, 4x4 row-major."""


class ManifestEntry(BaseModel):
    """Keys, types and limits of a line."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    video: Annotated[str, Field(min_length=1)]
    """Path of the video (file, frame folder, npy or npz), relative to the manifest and inside its folder."""
    id: Annotated[str, Field(min_length=1)] | None = None
    task: str | None = None
    seed: int | None = None
    model: str | None = None
    prompt: str | None = None
    fps: Annotated[float, Field(ge=1.0 / MAX_PERIOD_S, le=1.0 / MIN_PERIOD_S, allow_inf_nan=False)] | None = None
    """Frames per second, overriding the file [1/s]."""
    frame_period_s: Annotated[float, Field(ge=MIN_PERIOD_S, le=MAX_PERIOD_S, allow_inf_nan=False)] | None = None
    """Task time between two frames [s]."""
    camera: dict[str, object] | Annotated[str, Field(min_length=1)] | None = None
    """Camera as an object, or the relative path of its file."""
    first_base_from_tcp: _Pose | None = None
    """Pose of panda_hand_tcp in the robot base frame in the first frame [m]."""
    first_finger_width_m: (
        Annotated[float, Field(ge=-WIDTH_TOLERANCE_M, le=MAX_WIDTH_M + WIDTH_TOLERANCE_M, allow_inf_nan=False)] | None
    ) = None
    """Gap between the finger pads in the first frame [m]; ignored without the pose."""
    first_frame: Annotated[str, Field(min_length=1)] | None = None
    """Relative path of the conditioning image of the video model."""
    view: Annotated[str, BeforeValidator(_view_text), AfterValidator(check_view)] | None = None
    """Panel of tiled frames: its number in reading order, its place, or `auto`."""
    actions: object | None = None
    """Relative path of the file of the actions that the clip should show, which `follow` reads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ManifestLine:
    """One line: an entry, or the problem with it."""

    number: int
    """Line number from 1."""
    data: Mapping[str, object] = field(default_factory=dict)
    """Object on the line; empty if there is none."""
    entry: ManifestEntry | None = None
    """Content of the line; None if it cannot be used."""
    problem: str | None = None
    """Reason why it cannot be used; None if it can."""


def read_manifest(path: Path) -> list[ManifestLine]:
    """Read all lines; a line that cannot be used has a problem and does not affect the others.

    Raises:
        UsageError: the file cannot be read, or holds no line.
    """
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path.name}: cannot be read as text ({cause(error)})") from None
    lines = [_read_line(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip()]
    if not lines:
        raise UsageError(f'{path.name}: is empty, expected one JSON object per line, such as {{"video": "a.mp4"}}')
    return lines


def _read_line(number: int, text: str) -> ManifestLine:
    try:
        data = parse_json(text)
    except ValueError as error:
        return ManifestLine(number=number, problem=f"line {number} is not JSON ({error})")
    if not isinstance(data, dict):
        message = f"line {number} is a {type(data).__name__}, expected an object with the key video"
        return ManifestLine(number=number, problem=message)
    try:
        return ManifestLine(number=number, data=data, entry=ManifestEntry.model_validate(data))
    except ValidationError as error:
        return ManifestLine(number=number, data=data, problem=f"line {number}: {_explain(error)}")


def _explain(error: ValidationError) -> str:
    """Return one clause per wrong key: its name, its value and what was expected."""
    clauses: dict[str, str] = {}
    for fault in error.errors(include_url=False):
        key = str(fault["loc"][0]) if fault["loc"] else "the line"
        value = "is missing" if fault["type"] == "missing" else f"is {fault['input']!r:.60}"
        clauses.setdefault(key, f"{key} {value} ({fault['msg'].lower()})")
    return "; ".join(clauses.values())


def entry_camera(entry: ManifestEntry, folder: Path) -> CameraSetting | None:
    """Return the camera of a line; None if it names none.

    Raises:
        InputError: the camera cannot be used or lies outside the manifest's folder.
    """
    if entry.camera is None:
        return None
    try:
        if isinstance(entry.camera, str):
            named = find_camera(entry.camera)
            if named is not None:
                return named.setting
            return load_camera(join_relative(folder, entry.camera, "camera", links_out=False))
        return CameraSetting.from_json(entry.camera, "camera")
    except UsageError as error:
        raise InputError(str(error)) from None


def list_manifest(path: Path, search: Search) -> list[VideoSample]:
    """List one sample per line; a line that cannot be used becomes a sample with a problem."""
    lines = read_manifest(path)
    unknown = Counter(key for line in lines for key in {*line.data} - {*ManifestEntry.model_fields} - UNREAD)
    if unknown:
        keys = ", ".join(f"{key!r} ({n} x)" for key, n in sorted(unknown.items()))
        search.warnings.append(
            f"{path.name}: unknown keys {keys} are not read; known are {', '.join(ManifestEntry.model_fields)}"
        )
    return [_sample(line, path.parent, search) for line in lines]


def _sample(line: ManifestLine, folder: Path, search: Search) -> VideoSample:
    video = as_type(line.data.get("video"), str) or ""
    id = as_type(line.data.get("id"), str)
    name = video or f"line-{line.number}"
    stem = Path(name).name if os.path.isdir(folder / name) else Path(name).stem
    id = shorten(id) if id else stem
    id = id if stem in id else f"{id}-{stem}"
    entry = line.entry
    problem = line.problem
    camera = None
    path = folder
    first_frame = None
    actions = None
    if entry is not None:
        try:
            path = join_relative(folder, entry.video, "video", links_out=False)
            camera = entry_camera(entry, folder)
            first_frame = _conditioning_image(entry, folder) or image_beside(path)
            if isinstance(entry.actions, str):
                actions = join_relative(folder, entry.actions, "actions", links_out=False)
        except InputError as error:
            problem = f"line {line.number}: {error}"
    sample = VideoSample(
        id=id,
        path=path,
        video=video,
        initial_state=_initial_state(entry) if entry else None,
        first_frame=first_frame,
        actions=actions,
        problem=problem,
        **(entry.model_dump(include=_LABELS) if entry else {}),
    )
    if camera is not None:
        return sample.filmed_by(camera, CameraSource.MANIFEST)
    if problem is not None:
        return sample
    return sample.filmed_by(search.cameras.find(path if path.is_dir() else path.parent), CameraSource.FOLDER)


def _conditioning_image(entry: ManifestEntry, folder: Path) -> Path | None:
    """Return the conditioning image; None if the file is absent, as `suite export` names one for every video."""
    if entry.first_frame is None:
        return None
    path = join_relative(folder, entry.first_frame, "first_frame", links_out=False)
    return path if path.is_file() else None


def _initial_state(entry: ManifestEntry) -> InitialState | None:
    if entry.first_base_from_tcp is None:
        return None
    width_m = np.nan if entry.first_finger_width_m is None else entry.first_finger_width_m
    width_m = float(np.clip(width_m, 0.0, MAX_WIDTH_M))
    return InitialState(X_BG=checked_pose(entry.first_base_from_tcp), finger_width_m=width_m)
