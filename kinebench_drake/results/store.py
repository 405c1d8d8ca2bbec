"""The output folder: rows appended as samples end, kept across any kind of stop, summarized at the end."""

import fcntl
import os
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.atomic import disk_errors, remove, write_atomically
from kinebench_drake.io.jsonl import append_line, dump, read_lines, write_lines
from kinebench_drake.results.row import SampleRow
from kinebench_drake.types import Json

SAMPLES, TIMINGS, RESULTS, REPORT = "samples.jsonl", "timings.jsonl", "results.json", "report.html"
RUN = "run.json"
"""What `results.json` will say of the run; there as long as `results.json` is not."""
ARTIFACTS = {"tracks": "npz", "overlays": "mp4", "rollouts": "mp4", "thumbnails": "jpg", "replays": "html"}
"""Folders with a file for each sample, and the suffix of its name."""


def artifact_path(out: Path, part: str, id: str) -> Path:
    """Path of a sample's file of its own: part is "tracks", "overlays", "rollouts", "thumbnails" or "replays"."""
    return out / part / f"{id}.{ARTIFACTS[part]}"


def read_rows(out: Path) -> dict[str, SampleRow]:
    """All whole rows of an output folder by id; a torn last line is passed over, a later row of an id wins.

    Raises:
        InputError: a line other than the last is no row.
    """
    try:
        return {row.id: row for row in read_lines(out / SAMPLES, SampleRow.from_json)}
    except InputError as error:
        raise InputError(f"{error}; --overwrite starts anew") from None


class ResultStore:
    """An output folder opened for writing, by one program at a time."""

    def __init__(self, out: Path, *, overwrite: bool = False) -> None:
        """Open or make the folder.

        Args:
            out: the folder.
            overwrite: forget what it holds instead of going on from there.

        Raises:
            UsageError: the folder cannot be made, written or locked, or holds a broken file.
        """
        self.out = out
        self._lock = -1
        try:
            out.mkdir(parents=True, exist_ok=True)
            for part in ARTIFACTS:
                (out / part).mkdir(exist_ok=True)
            self._lock = os.open(out, os.O_RDONLY)
            self._claim()
            self._sweep(everything=overwrite)
            for name in (SAMPLES, TIMINGS):
                if (out / name).exists() and not (out / name).is_file():
                    raise InputError(f"--out {out}: {name} is no file; --overwrite removes it, or name another folder")
            with (out / SAMPLES).open("ab"):
                pass
            self.rows = read_rows(out)
        except OSError as error:
            self.close()
            raise UsageError(f"--out {out}: cannot be written ({error.strerror or error})") from None
        except InputError as error:
            self.close()
            raise UsageError(str(error)) from None

    def __enter__(self) -> "ResultStore":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let other programs have the folder."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def sorted_rows(self) -> list[SampleRow]:
        """All rows, by id."""
        return [self.rows[id] for id in sorted(self.rows)]

    def keep(self, wanted: Callable[[SampleRow], bool]) -> None:
        """Drop every row that is not `wanted`, with its files, and tidy the file of rows.

        Raises:
            SetupError: writing failed.
        """
        for id in [id for id, row in self.rows.items() if not wanted(row)]:
            del self.rows[id]
            for part in ARTIFACTS:
                with disk_errors(f"{part}/"):
                    artifact_path(self.out, part, id).unlink(missing_ok=True)
        self._rewrite()

    def keep_files(self, part: str, ids: Collection[str]) -> None:
        """Remove a part's files of all samples but those.

        Raises:
            SetupError: writing failed.
        """
        wanted = {artifact_path(self.out, part, id) for id in ids}
        with disk_errors(f"{part}/"):
            for path in (self.out / part).glob(f"*.{ARTIFACTS[part]}"):
                if path not in wanted:
                    path.unlink()

    def begin(self, header: Mapping[str, Json]) -> None:
        """Tell what run fills the folder from now on; `results.json`, true no more, is gone until `finish`.

        Raises:
            SetupError: writing failed.
        """
        write_atomically(self.out / RUN, dump(header, indent=1).encode())
        with disk_errors(RESULTS):
            (self.out / RESULTS).unlink(missing_ok=True)

    def append(self, row: SampleRow, wall_s: float) -> None:
        """Put a finished sample on disk for good: after this returns, no crash loses it.

        Raises:
            SetupError: writing failed; the file is as before.
        """
        row = row.slim()
        append_line(self.out / SAMPLES, row.to_json())
        self.rows[row.id] = row
        with disk_errors(TIMINGS), (self.out / TIMINGS).open("a") as file:  # no loss if a power cut takes it
            file.write(dump({"id": row.id, "wall_s": round(wall_s, 4)}))

    def finish(self, results: Mapping[str, Json]) -> None:
        """Sort the rows, remove what workers left that were lost on the way, and write `results.json`.

        Raises:
            SetupError: writing failed.
        """
        self._rewrite()
        with disk_errors("the folder"):
            self._sweep(everything=False)
        write_atomically(self.out / RESULTS, dump(results, indent=1).encode())
        with disk_errors(RUN):
            (self.out / RUN).unlink(missing_ok=True)
        for part in ARTIFACTS:
            folder = self.out / part
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    def _rewrite(self) -> None:
        write_lines(self.out / SAMPLES, (row.to_json() for row in self.sorted_rows()))

    def _claim(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise UsageError(
                f"--out {self.out}: another run writes there; wait for it, or give each its own folder"
            ) from None

    def _sweep(self, *, everything: bool) -> None:
        """Remove what killed processes left half-written, and on demand all that any run wrote."""
        doomed = [*self.out.glob(".*.part.*"), *self.out.glob("videos/.*.part.*")]
        for part, suffix in ARTIFACTS.items():
            doomed += (self.out / part).glob(".*.part.*")
            doomed += (self.out / part).glob(f"*.{suffix}") if everything else ()
        if everything:
            doomed += [self.out / name for name in (SAMPLES, TIMINGS, RUN, RESULTS, REPORT)]
        for path in doomed:  # the programs of world models are given folders to work in
            remove(path)
