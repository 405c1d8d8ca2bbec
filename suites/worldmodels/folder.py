"""Folder of finished videos as a world model, for the episodes of `suite export`."""

from pathlib import Path

from kinebench_drake.io.files import IMAGE_SUFFIXES, VIDEO_SUFFIXES
from kinebench_drake.suites.worldmodels.media import check_video
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModel, WorldModelError


class FolderModel(WorldModel):
    """World model that looks up videos in a folder by file name.

    A video or folder of frames has the episode's id as its stem. Later rounds have it followed by `_r1`, `_r2`, ...;
    the first one may have `_r0`. Further samples of an episode have ids of their own, `ID_k1`, `ID_k2`, ....
    """

    def __init__(self, spec: Spec) -> None:
        options = spec.read(Options)
        self._folder = Path(spec.rest).resolve()
        if not spec.rest or not self._folder.is_dir():
            raise spec.unusable("expected folder:DIR with a folder that is there")
        self.name = options.name or self._folder.name or "folder"

    chooses_length = True
    """The videos are finished."""

    def generate(self, request: Request, out: Path) -> Path:
        """Return the video of the episode and round, which stays in its folder."""
        matches = self._find(request.episode, request.round)
        name = f"{request.episode}_r{request.round}" if request.round else request.episode
        if not matches:
            raise WorldModelError(
                f"the folder has no video of {name}; expected {name}.mp4 (or mov, avi, gif, "
                "webm, mkv, a folder of frames)"
            )
        if len(matches) > 1:
            names = ", ".join(path.name for path in matches)
            raise WorldModelError(f"the folder has several videos of {name} ({names}); leave one")
        return self._check(matches[0])

    def files(self, episode: str, task: str, round: int) -> list[Path]:
        """Return the files of a round's video, or of its folder of frames."""
        matches = self._find(episode, round)
        return [inner for path in matches for inner in (sorted(path.iterdir()) if path.is_dir() else [path])]

    def _find(self, episode: str, number: int) -> list[Path]:
        """Return the videos of a round."""
        for name in [f"{episode}_r{number}"] if number else [episode, f"{episode}_r0"]:
            files = (self._folder / f"{name}{suffix}" for suffix in sorted(VIDEO_SUFFIXES))
            if matches := [path for path in (*files, self._folder / name) if path.is_file() or _is_frames(path)]:
                return matches
        return []

    def _check(self, path: Path) -> Path:
        real = path.resolve()
        if not real.is_relative_to(self._folder) or real == self._folder:
            raise WorldModelError(f"the video {path.name} lies outside the folder; copy it into it")
        if not real.is_dir():
            check_video(real)
        return real


def _is_frames(path: Path) -> bool:
    return path.is_dir() and any(inner.suffix.lower() in IMAGE_SUFFIXES for inner in path.iterdir())
