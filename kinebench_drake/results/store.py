"""Output folder of a run: rows are stored as samples finish, survive any interruption and are summarized at the end."""

import os
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from itertools import accumulate
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.atomic import disk_errors, lock_folder, remove
from kinebench_drake.io.jsonl import Json, append_line, dump, parse_json, parse_lines, write_json, write_raw_lines
from kinebench_drake.results.lines import RowFile, RowLine
from kinebench_drake.results.row import SampleRow

SAMPLES = "samples.jsonl"
TIMINGS = "timings.jsonl"
RESULTS = "results.json"
REPORT = "report.html"
RUN = "run.json"
"""Metadata of a run that has no `results.json` yet."""
ARTIFACTS = {"tracks": "npz", "overlays": "mp4", "rollouts": "mp4", "thumbnails": "jpg", "replays": "html"}
"""Folders with one file per sample, and the suffix of the files."""
REQUESTS = "ask"
"""Folder with first frames and manifest of the videos that samples wait for."""


def artifact_path(out: Path, kind: str, id: str) -> Path:
    """Return the path of an artifact of a sample; `kind` is a key of `ARTIFACTS`."""
    return out / kind / f"{id}.{ARTIFACTS[kind]}"


def require_output(folder: Path) -> None:
    """Check that a folder is the output folder of a run.

    Raises:
        UsageError: it is not.
    """
    if not (folder / SAMPLES).is_file():
        raise UsageError(f"{folder}: holds no {SAMPLES}, expected the output folder of a run")


def read_rows(out: Path) -> dict[str, SampleRow]:
    """Read the rows of an output folder by id; a torn last line is ignored, of equal ids the last row is kept."""
    path = out / SAMPLES
    return _parse_rows(path, RowFile(path)) if path.is_file() else {}


def _parse_rows(path: Path, file: RowFile) -> dict[str, SampleRow]:
    try:
        rows = parse_lines(path, lambda data, start, size: SampleRow.from_json(data, RowLine(file, start, size)))
        return {row.id: row for row in rows}
    except InputError as error:
        raise InputError(f"{error}; $overwrite=True removes the earlier results") from None


def _listed_ids(path: Path) -> list[str]:
    """Return the ids of the lines that are rows; other lines are skipped."""
    if not path.is_file():
        return []
    ids = []
    with path.open("rb") as file:
        for line in file:
            with suppress(ValueError, InputError):
                ids.append(SampleRow.from_json(parse_json(line)).id)
    return ids


class ResultStore:
    """Output folder opened for writing, locked against other processes."""

    def __init__(self, out: Path, *, overwrite: bool = False) -> None:
        """Open or create the folder.

        Raises:
            UsageError: the folder cannot be created, written or locked, or holds a broken file.
        """
        self.out = out
        self._lock = -1
        self._begun = False
        try:
            self._lock = lock_folder(out)
            for name in (*ARTIFACTS, REQUESTS, "videos"):
                if (out / name).is_symlink():
                    raise InputError(f"$out {out}: {name} is a link, and a run writes and removes files there")
            self._sweep(everything=overwrite)
            for name in (SAMPLES, TIMINGS):
                if (out / name).exists() and not (out / name).is_file():
                    raise InputError(
                        f"$out {out}: {name} is no file; $overwrite=True removes it, or name another folder"
                    )
            with (out / SAMPLES).open("ab"):
                pass
            self._file = RowFile(out / SAMPLES)
            self.rows = _parse_rows(out / SAMPLES, self._file)
        except OSError as error:
            self.close()
            raise UsageError(f"$out {out}: cannot be written ({error.strerror or error})") from None
        except InputError as error:
            self.close()
            raise UsageError(str(error)) from None

    def __enter__(self) -> "ResultStore":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def sorted_rows(self) -> list[SampleRow]:
        """Return all rows, sorted by id."""
        return [self.rows[id] for id in sorted(self.rows)]

    def keep_rows(self, wanted: Callable[[SampleRow], bool]) -> None:
        """Drop every row that is not `wanted`, with its artifacts, and rewrite the file of rows."""
        for id in [id for id, row in self.rows.items() if not wanted(row)]:
            del self.rows[id]
            for kind in ARTIFACTS:
                with disk_errors(f"{kind}/"):
                    artifact_path(self.out, kind, id).unlink(missing_ok=True)
        self._rewrite()

    def keep_artifacts(self, kind: str, ids: Collection[str]) -> None:
        """Remove the artifacts of a kind of all other samples of the run."""
        with disk_errors(f"{kind}/"):
            for id in self.rows.keys() - set(ids):
                artifact_path(self.out, kind, id).unlink(missing_ok=True)

    def begin(self, metadata: Mapping[str, Json]) -> None:
        """Write the metadata of the run that fills the folder from now on, and remove the outdated `results.json`.

        Nothing happens if this run has begun already.
        """
        if self._begun:
            return
        self._begun = True
        write_json(self.out / RUN, metadata)
        with disk_errors(RESULTS):
            (self.out / RESULTS).unlink(missing_ok=True)

    def append(self, row: SampleRow, wall_s: float) -> None:
        """Store the row of a finished sample: once this returns, no crash loses it."""
        data = row.to_json()
        place = append_line(self.out / SAMPLES, data)
        self.rows[row.id] = SampleRow.from_json(data, RowLine(self._file, *place))
        with disk_errors(TIMINGS), (self.out / TIMINGS).open("a") as file:  # may be lost in a power cut
            file.write(dump({"id": row.id, "wall_s": round(wall_s, 4)}))

    def finish(self, results: Mapping[str, Json]) -> None:
        """Sort the rows, remove unfinished files of lost workers, and write `results.json`."""
        self._rewrite()
        with disk_errors("the folder"):
            self._sweep(everything=False)
        write_json(self.out / RESULTS, results)
        with disk_errors(RUN):
            (self.out / RUN).unlink(missing_ok=True)
        for kind in (*ARTIFACTS, "videos"):
            folder = self.out / kind
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    def _rewrite(self) -> None:
        """Write the lines of all rows, sorted by id, where the file holds anything else."""
        lines = [row.line for row in self.sorted_rows() if row.line is not None]
        ends = [0, *accumulate(line.size for line in lines)]
        current = all(line.file is self._file and line.start == end for line, end in zip(lines, ends, strict=False))
        if current and ends[-1] == self._file.size:
            return
        write_raw_lines(self.out / SAMPLES, (line.read() for line in lines))
        self._file = RowFile(self.out / SAMPLES)
        for line, start in zip(lines, ends, strict=False):
            line.file = self._file
            line.start = start

    def _sweep(self, *, everything: bool) -> None:
        """Remove unfinished files of killed processes, and on demand everything that the run wrote by its rows."""
        doomed = [*self.out.glob(".*.part.*"), *self.out.glob("videos/.*.part.*")]
        ids = _listed_ids(self.out / SAMPLES) if everything else ()
        for kind in ARTIFACTS:
            doomed += (self.out / kind).glob(".*.part.*")
            doomed += (artifact_path(self.out, kind, id) for id in ids)
        if everything:
            doomed += [self.out / name for name in (SAMPLES, TIMINGS, RUN, RESULTS, REPORT)]
        for path in doomed:  # world models may have left unfinished folders, too
            remove(path)
