"""A bundle: the results of a run as one zip archive, with the SHA-256 of each of its files and of the videos."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.io.archive import hash_file, unpack_zip, write_zip
from kinebench_drake.io.jsonl import Json, as_object, dump, read_object
from kinebench_drake.results.metadata import read_metadata
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import RESULTS, SAMPLES, artifact_path, read_rows, require_output

MANIFEST = "bundle.json"
VERSION = 1
"""Version of the format."""
_ARTIFACTS = ("tracks", "thumbnails")
_KINDS = (MANIFEST, RESULTS, SAMPLES, "tracks/*.npz", "thumbnails/*.jpg")


@dataclass(frozen=True, slots=True, kw_only=True)
class Bundle:
    """An unpacked bundle."""

    path: Path
    """The archive."""
    folder: Path
    """Output folder of the run, as far as it is in the bundle."""
    files: Mapping[str, str]
    """SHA-256 of each file in it."""
    stated: Mapping[str, object]
    """SHA-256 that the bundle states for each file."""
    videos: Mapping[str, object]
    """SHA-256 that the bundle states for each video."""


def write_bundle(run: Path, path: Path) -> None:
    """Write the bundle of a finished run; the same output folder gives the same bytes.

    Raises:
        UsageError: the folder is no finished output folder, or is damaged.
    """
    require_output(run)
    try:
        metadata = read_metadata(run)
        rows = read_rows(run)
        if metadata is None or not metadata.finished:
            raise UsageError(f"{run}: holds no {RESULTS}; run the same command again to finish it")
        paths = [artifact_path(run, kind, id) for id in rows for kind in _ARTIFACTS]
        files = {path.relative_to(run).as_posix(): path for path in paths if path.is_file()}
        files |= {name: run / name for name in (RESULTS, SAMPLES)}
        content: dict[str, Json] = {
            "bundle_version": VERSION,
            "files": {name: hash_file(files[name]) for name in sorted(files)},
            "videos": dict(sorted(video for row in rows.values() for video in _hash_videos(run, row))),
        }
    except (InputError, OSError) as error:
        raise UsageError(f"{run}: cannot be bundled ({error})") from None
    write_zip(path, {**files, MANIFEST: dump(content, indent=1).encode()})


def _hash_videos(run: Path, row: SampleRow) -> Iterator[tuple[str, str]]:
    """Yield name and SHA-256 of the videos of a row: its input, or the clips that a world model generated."""
    if row.input_sha256 is not None:
        yield row.video, row.input_sha256
    for clip in row.videos or ():
        if (run / clip).is_file():
            yield clip, hash_file(run / clip)


@contextmanager
def open_bundle(path: Path) -> Iterator[Bundle]:
    """Unpack a bundle from an untrusted source into a temporary folder, named like it.

    Raises:
        UsageError: it is no bundle, or is not sound; nothing is left on disk.
    """
    with TemporaryDirectory(prefix="kinebench-drake-") as work:
        folder = Path(work) / path.stem
        try:
            files = unpack_zip(path, folder, _KINDS)
            if absent := [name for name in (MANIFEST, RESULTS, SAMPLES) if name not in files]:
                raise InputError(f"holds no {absent[0]}")
            content = read_object(folder / MANIFEST)
            if (version := content.get("bundle_version")) != VERSION:
                raise InputError(f"bundle_version is {version!r:.40}, this program reads {VERSION}")
        except (InputError, OSError) as error:
            reason = cause(error) if isinstance(error, OSError) else str(error)
            raise UsageError(f"{path}: cannot be read as a bundle: {reason}") from None
        stated = as_object(content.get("files"))
        videos = as_object(content.get("videos"))
        yield Bundle(path=path, folder=folder, files=files, stated=stated, videos=videos)
