"""Folder of finished videos as a world model, for the episodes of `suite export`."""

import re
from pathlib import Path
from typing import Any

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import IMAGE_SUFFIXES, VIDEO_SUFFIXES, read_text
from kinebench_drake.io.jsonl import parse_json
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.suites.worldmodels.media import check_video
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModel, WorldModelError

_MANIFEST = "manifest.jsonl"
_SAMPLE = re.compile(r"_k\d+")
_SEED = re.compile(r"[-_](?:seed|s)?[-_]?(\d+)", re.IGNORECASE)


class FolderModel(WorldModel):
    """World model that looks up videos in a folder, by manifest row or else by file name.

    A row matches the first round of an episode by its `id`, else by its `task` and `seed`. A video or folder of frames
    matches if its stem is the episode's id, else if it is the task and the seed, such as `StackCube-v1_seed3`. Later
    rounds have the episode's id followed by `_r1`, `_r2`, ...; the first one may have `_r0`. Further samples of an
    episode are found by their ids, `ID_k1`, `ID_k2`, ..., alone.
    """

    def __init__(self, spec: Spec) -> None:
        options = spec.read(Options)
        self._folder = Path(spec.rest).resolve()
        if not spec.rest or not self._folder.is_dir():
            raise spec.unusable("expected folder:DIR with a folder that is there")
        self.name = options.name or self._folder.name or "folder"
        self._stems: dict[str, list[Path]] = {}
        self._listed_ns = -1
        try:
            self._rows = _rows(self._folder / _MANIFEST)
        except InputError as error:
            raise spec.unusable(str(error)) from None

    chooses_length = True
    """The videos are finished."""

    def generate(self, request: Request, out: Path) -> Path:
        """Return the video of the episode and round, which stays in its folder."""
        matches = self._find(request.episode, request.task, request.round)
        name = _round_id(request.episode, request.round) if request.round else request.episode
        if not matches:
            raise WorldModelError(
                f"the folder has no video of {name}; expected {name}.mp4 (or mov, avi, gif, "
                f"webm, mkv, a folder of frames), or a row of {_MANIFEST} with its id and video"
            )
        if len(matches) > 1:
            names = ", ".join(path.name for path in matches)
            raise WorldModelError(f"the folder has several videos of {name} ({names}); leave one")
        return self._check(matches[0])

    def files(self, episode: str, task: str, round: int) -> list[Path]:
        """Return the files of a round's video, or of its folder of frames."""
        matches = self._find(episode, task, round)
        return [inner for path in matches for inner in (sorted(path.iterdir()) if path.is_dir() else [path])]

    def _find(self, episode: str, task: str, number: int) -> list[Path]:
        """Return the videos of a round; task and seed name that of the first one only."""
        seed = None if number else _seed_of(episode, task)
        names = [_round_id(episode, number)] if number else [episode, _round_id(episode, 0)]
        for name in names:
            if matches := self._by_manifest(name, task, seed) or self._by_name(name, task, seed):
                return matches
        return []

    def _by_manifest(self, name: str, task: str, seed: int | None) -> list[Path]:
        """Return existing videos of matching rows; an export has rows without a video."""
        by_id = [row for row in self._rows if row.get("id") == name]
        nameless = [row for row in self._rows if "id" not in row and seed is not None]
        by_seed = [row for row in nameless if (row.get("task"), row.get("seed")) == (task, seed)]
        for rows in (by_id, by_seed):
            videos = [self._folder / row["video"] for row in rows if isinstance(row.get("video"), str)]
            if matches := [path for path in dict.fromkeys(videos) if path.exists()]:
                return matches
        return []

    def _by_name(self, name: str, task: str, seed: int | None) -> list[Path]:
        """Return the videos whose stem is the name, else those whose stem is the task and the seed."""

        def has_seed(stem: str) -> bool:
            match = _SEED.fullmatch(stem.removeprefix(task)) if stem.startswith(task) else None
            return match is not None and int(match[1]) == seed

        entries = self._entries()
        by_seed = (path for stem, paths in entries.items() if has_seed(stem) for path in paths)
        for paths in (entries.get(name, ()), by_seed):
            if matches := [path for path in paths if _is_video(path) or _is_frames(path)]:
                return matches
        return []

    def _entries(self) -> dict[str, list[Path]]:
        """Return the videos and folders by their stems, listed again when the folder has changed."""
        changed_ns = self._folder.stat().st_mtime_ns
        if changed_ns != self._listed_ns:
            self._listed_ns = changed_ns
            entries = [p for p in sorted(self._folder.iterdir()) if p.is_dir() or p.suffix.lower() in VIDEO_SUFFIXES]
            self._stems = group_by(entries, lambda path: path.name if path.is_dir() else path.stem)
        return self._stems

    def _check(self, path: Path) -> Path:
        real = path.resolve()
        if not real.is_relative_to(self._folder) or real == self._folder:
            raise WorldModelError(f"the video {path.name} lies outside the folder; copy it into it")
        if real.is_dir():
            if not _is_frames(real):
                raise WorldModelError(f"{path.name} is a folder without images (png, jpg)")
        else:
            check_video(real)
        return real


def _round_id(episode: str, number: int) -> str:
    return f"{episode}_r{number}"


def _seed_of(episode: str, task: str) -> int | None:
    """Return the seed in an episode's id, which begins with the task, `_s` and the seed; None of a further sample."""
    match = re.match(rf"{re.escape(task)}_s(\d+)(?P<rest>.*)", episode)
    return int(match[1]) if match and not _SAMPLE.search(match["rest"]) else None


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES and not path.name.startswith(".") and path.is_file()


def _is_frames(path: Path) -> bool:
    return path.is_dir() and any(inner.suffix.lower() in IMAGE_SUFFIXES for inner in path.iterdir())


def _rows(manifest: Path) -> list[dict[str, Any]]:
    """Read the rows of a manifest, JSON objects; none if there is no manifest."""
    if not manifest.is_file():
        return []
    try:
        lines = read_text(manifest).splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{_MANIFEST} cannot be read ({cause(error)})") from None
    rows = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            row = parse_json(line)
        except ValueError:
            row = None
        if not isinstance(row, dict):
            raise InputError(f"line {number} of {_MANIFEST} is not a JSON object")
        rows.append(row)
    return rows
