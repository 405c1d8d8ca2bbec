"""Videos that were generated elsewhere, for the episodes of `suite export`."""

import re
from pathlib import Path
from typing import Any

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import IMAGE_SUFFIXES, VIDEO_SUFFIXES, read_text
from kinebench_drake.io.jsonl import parse_json
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.suites.worldmodels.videofile import check_video
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

_MANIFEST = "manifest.jsonl"
_SEED = re.compile(r"[-_](?:seed|s)?[-_]?(\d+)", re.IGNORECASE)


class FolderModel:
    """Answers from a folder: the manifest's row of the episode, else the video that is called like it.

    A row is the episode's if its `id` is, else if its `task` and `seed` are. A video or folder of frames is called like
    the episode if its stem is the episode's id, else if it is the task and the seed, such as `StackCube-v1_seed3`.
    """

    def __init__(self, spec: Spec) -> None:
        options = spec.read(Options)
        self._folder = Path(spec.rest).resolve()
        if not spec.rest or not self._folder.is_dir():
            raise spec.unusable("expected folder:DIR with a folder that is there")
        self.name = options.name or self._folder.name or "folder"
        try:
            self._rows = _rows(self._folder / _MANIFEST)
        except InputError as error:
            raise spec.unusable(str(error)) from None

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`; the answer lies in the folder itself."""
        if request.round:
            raise WorldModelError(
                f"a folder of finished videos can answer the first round only, this is round {request.round + 1}: it "
                "would have to know what was executed; use --rounds 1"
            )
        found = self._find(request.episode, request.task)
        if not found:
            raise WorldModelError(
                f"the folder has no video of {request.episode}; expected {request.episode}.mp4 (or mov, avi, gif, "
                f"webm, mkv, a folder of frames), or a row of {_MANIFEST} with its id and video"
            )
        if len(found) > 1:
            names = ", ".join(path.name for path in found)
            raise WorldModelError(f"the folder has several videos of {request.episode} ({names}); leave one")
        return self._checked(found[0])

    def files(self, episode: str, task: str) -> list[Path]:
        """See `Offline`."""
        found = self._find(episode, task)
        return [inner for path in found for inner in (sorted(path.iterdir()) if path.is_dir() else [path])]

    def close(self) -> None:
        """Nothing is held."""

    def _find(self, episode: str, task: str) -> list[Path]:
        return self._by_manifest(episode, task) or self._by_name(episode, task)

    def _by_manifest(self, episode: str, task: str) -> list[Path]:
        """Videos of the episode's rows that are there; rows of an export whose video was never made are passed over."""
        seed = _seed_of(episode, task)
        by_id = [row for row in self._rows if row.get("id") == episode]
        nameless = [row for row in self._rows if "id" not in row and seed is not None]
        by_seed = [row for row in nameless if (row.get("task"), row.get("seed")) == (task, seed)]
        for rows in (by_id, by_seed):
            videos = [self._folder / row["video"] for row in rows if isinstance(row.get("video"), str)]
            if found := [path for path in dict.fromkeys(videos) if path.exists()]:
                return found
        return []

    def _by_name(self, episode: str, task: str) -> list[Path]:
        named = {path: path.stem if _is_film(path) else path.name for path in sorted(self._folder.iterdir())}
        videos = {path: name for path, name in named.items() if _is_film(path) or _is_frames(path)}
        if found := [path for path, name in videos.items() if name == episode]:
            return found
        seed = _seed_of(episode, task)
        return [
            path
            for path, name in videos.items()
            if name.startswith(task)
            and (told := _SEED.fullmatch(name.removeprefix(task))) is not None
            and int(told[1]) == seed
        ]

    def _checked(self, path: Path) -> Path:
        real = path.resolve()
        if not real.is_relative_to(self._folder) or real == self._folder:
            raise WorldModelError(f"the video {path.name} lies outside the folder; copy it into it")
        if real.is_dir():
            if not _is_frames(real):
                raise WorldModelError(f"{path.name} is a folder without pictures (png, jpg)")
        else:
            check_video(real)
        return real


def _seed_of(episode: str, task: str) -> int | None:
    """The episode's own seed; its id is the task, `_s` and the seed, whatever follows."""
    told = re.match(rf"{re.escape(task)}_s(\d+)", episode)
    return int(told[1]) if told else None


def _is_film(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES and not path.name.startswith(".") and path.is_file()


def _is_frames(path: Path) -> bool:
    return path.is_dir() and any(inner.suffix.lower() in IMAGE_SUFFIXES for inner in path.iterdir())


def _rows(manifest: Path) -> list[dict[str, Any]]:
    """Rows of a manifest, none if there is no manifest.

    Raises:
        InputError: a line is no JSON object.
    """
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
