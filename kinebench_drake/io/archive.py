"""Zip archives whose entries are stored uncompressed: equal files give equal bytes, and nothing can unpack to more."""

import hashlib
import stat
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path, PurePosixPath

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.files import open_file

_BLOCK = 2**20


def hash_file(path: Path) -> str:
    """Return the SHA-256 of the bytes of a file."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_zip(path: Path, files: Mapping[str, Path | bytes]) -> None:
    """Write an archive of files or bytes by the name of their entry, sorted; equal content gives equal bytes."""
    with atomic_path(path) as part, zipfile.ZipFile(part, "w") as archive:
        for name in sorted(files):
            # of a fixed date: clock times would change the bytes
            entry = zipfile.ZipInfo(name)
            content = files[name]
            if isinstance(content, bytes):
                archive.writestr(entry, content)
                continue
            entry.file_size = content.stat().st_size
            with open_file(content) as file, archive.open(entry, "w") as target:
                while block := file.read(_BLOCK):
                    target.write(block)


def unpack_zip(path: Path, folder: Path, kinds: Collection[str]) -> dict[str, str]:
    """Unpack an archive from an untrusted source into a folder; nothing is written unless every entry is sound.

    Args:
        kinds: patterns of the names that are accepted, such as "tracks/*.npz".

    Returns:
        SHA-256 of each file by its name.

    Raises:
        InputError: it is no zip archive, is damaged, or has an entry that is compressed, encrypted or a link, occurs
            twice, overlaps another, or has another name.
    """
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            names: set[str] = set()
            for entry in entries:
                if reason := _objection(entry, kinds) or ("occurs twice" if entry.filename in names else None):
                    raise InputError(f"entry {entry.filename!r:.80} {reason}")
                names.add(entry.filename)
            if sum(entry.file_size for entry in entries) > file.seek(0, 2):
                raise InputError("its entries overlap: they hold more bytes than the file")
            return {entry.filename: _unpack(archive, entry, folder / entry.filename) for entry in entries}
    except (zipfile.BadZipFile, EOFError, ValueError, NotImplementedError, RuntimeError) as error:
        raise InputError(f"not a sound zip archive ({cause(error)})") from None


def _objection(entry: zipfile.ZipInfo, kinds: Collection[str]) -> str | None:
    """Return why an entry is refused; None if it is sound."""
    name = PurePosixPath(entry.filename)
    if entry.filename != entry.orig_filename or str(name) != entry.filename or name.name.startswith("."):
        return "has a name that is not a plain path"
    if name.is_absolute() or ".." in name.parts or "\\" in entry.filename or not any(map(name.match, kinds)):
        return f"is not expected here; there are {', '.join(kinds)}"
    if stat.S_IFMT(entry.external_attr >> 16) not in (0, stat.S_IFREG):
        return "is a link or another special file"
    if entry.flag_bits & 1 or entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
        return "is compressed or encrypted, expected one that is stored as it is (zip -0)"
    return None


def _unpack(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> str:
    """Write the content of an entry; return its SHA-256."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256()
    with archive.open(entry) as file, target.open("xb") as copy:
        while block := file.read(_BLOCK):
            digest.update(block)
            copy.write(block)
    return digest.hexdigest()
