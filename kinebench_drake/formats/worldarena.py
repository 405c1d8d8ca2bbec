"""Unpacked submissions to track 1 of WorldArena 2.0: model_readme.md with the model's name, and videos/."""

import re
from dataclasses import replace
from pathlib import Path

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.io.files import VIDEO_SUFFIXES, read_text

_README = "model_readme.md"
_FIELD = re.compile(r"^(model_name|version):[ \t]*(\S.*?)[ \t]*$", re.MULTILINE)


def is_submission(folder: Path) -> bool:
    """Return whether a folder is a submission to track 1 of WorldArena 2.0."""
    return (folder / _README).is_file() and (folder / "videos").is_dir()


def list_submission(folder: Path, search: Search) -> list[VideoSample]:
    """List the videos of a submission, with the name and version of the model.

    Raises:
        InputError: model_readme.md cannot be read.
        UsageError: a camera.json is unusable.
    """
    try:
        fields = dict(_FIELD.findall(read_text(folder / _README)))
    except (OSError, ValueError) as error:
        raise InputError(f"{_README} cannot be read ({cause(error)})") from None
    model = " ".join(fields[name] for name in ("model_name", "version") if name in fields)
    return [replace(search.sample(video), model=model or None) for video in _videos(folder / "videos")]


def _videos(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir())
    return [f for f in files if f.suffix.lower() in VIDEO_SUFFIXES and f.is_file() and not f.name.startswith(".")]
