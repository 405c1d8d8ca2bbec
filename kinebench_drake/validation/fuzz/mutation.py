"""Folders made wrong: a file's content by what it is, or which files, links and folders there are."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath

from numpy.random import Generator

from kinebench_drake.validation.fuzz.arrays import mutate_npy, mutate_npz
from kinebench_drake.validation.fuzz.hdf5 import mutate_hdf5
from kinebench_drake.validation.fuzz.octets import mutate_bytes
from kinebench_drake.validation.fuzz.replies import mutate_reply
from kinebench_drake.validation.fuzz.tables import mutate_csv, mutate_parquet
from kinebench_drake.validation.fuzz.tree import Link, Node, Special, Tree
from kinebench_drake.validation.fuzz.values import mutate_json, mutate_lines

CONTENT: Mapping[str, Callable[[Generator, bytes], bytes]] = {
    ".json": mutate_json,
    ".jsonl": mutate_lines,
    ".npz": mutate_npz,
    ".npy": mutate_npy,
    ".csv": mutate_csv,
    ".parquet": mutate_parquet,
    ".h5": mutate_hdf5,
    ".http": mutate_reply,
}
"""What changes a file by its suffix; of others the bytes are changed."""

_NAMES = (
    *("é", "\u202egpm.exe", "a\x1b[2Jb", "two\nlines", " ", "...", "-rf", "%s%n", "<script>", "a'b\"c", "#", "x" * 200),
    *("\udcff\udcfe", "con", "\u0007", "a\\b", "$(id)", "~", "\u2028", "😀", "0", "-1", "00000000000000000000001"),
)
_DISGUISES = (
    b"",
    b"\0" * 100,
    b"ffconcat version 1.0\nfile /etc/passwd\n",
    b"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n/etc/passwd\n#EXT-X-ENDLIST\n",
    b"<svg xmlns='http://www.w3.org/2000/svg'><image href='/etc/passwd'/></svg>",
    b"PK\x05\x06" + b"\0" * 18,
    b"\x89HDF\r\n\x1a\n",
    b"PAR1PAR1",
    b"{}",
    b"\x80\x04\x95",
    b"<?xml version='1.0'?><MPD/>",
)
_OTHER_SUFFIXES = (".mp4", ".png", ".npz", ".npy", ".json", ".csv", ".h5", ".parquet", ".gif", ".MP4", "", ".jsonl")


def mutate(rng: Generator, tree: Tree) -> dict[str, Node]:
    """A tree after a change: mostly to what one of its files holds."""
    changed = dict(tree)
    if rng.random() < 0.85:
        for _ in range(1 if rng.random() < 0.85 else 2):
            name = _one(rng, list(tree))
            content, valid = changed[name], changed[name] is tree[name]
            if isinstance(content, bytes):
                how = CONTENT.get(PurePosixPath(name).suffix, mutate_bytes) if valid else mutate_bytes
                changed[name] = how(rng, content)
        return changed
    _CHANGES[int(rng.integers(len(_CHANGES)))](rng, changed)
    return changed


def _one(rng: Generator, names: Sequence[str]) -> str:
    return names[int(rng.integers(len(names)))]


def _rename(rng: Generator, tree: dict[str, Node]) -> None:
    old = PurePosixPath(_one(rng, list(tree)))
    part = _one(rng, _NAMES)
    tree[str(old.with_name(part + old.suffix))] = tree.pop(str(old))


def _rename_folder(rng: Generator, tree: dict[str, Node]) -> None:
    below = [name for name in tree if "/" in name]
    if not below:
        return _rename(rng, tree)
    top, part = _one(rng, below).split("/")[0], _one(rng, _NAMES)
    for name in [name for name in tree if name.startswith(f"{top}/")]:
        tree[part + name.removeprefix(top)] = tree.pop(name)


def _resuffix(rng: Generator, tree: dict[str, Node]) -> None:
    name = _one(rng, list(tree))
    tree[str(PurePosixPath(name).with_suffix(_one(rng, _OTHER_SUFFIXES)))] = tree.pop(name)


def _remove(rng: Generator, tree: dict[str, Node]) -> None:
    del tree[_one(rng, list(tree))]


def _replace(rng: Generator, tree: dict[str, Node]) -> None:
    name = _one(rng, list(tree))
    links = (name.rsplit("/", 1)[-1], "nowhere", "/dev/zero", "/dev/stdin", "/etc/passwd", "..", ".", "../outside")
    nodes: tuple[Node, ...] = (
        *(Special.FOLDER, Special.PIPE, Special.PIPE),
        *(Link(to) for to in links),
        *_DISGUISES,
    )
    tree[name] = nodes[int(rng.integers(len(nodes)))]


def _exchange(rng: Generator, tree: dict[str, Node]) -> None:
    one, other = _one(rng, list(tree)), _one(rng, list(tree))
    tree[one], tree[other] = tree[other], tree[one]


def _add(rng: Generator, tree: dict[str, Node]) -> None:
    name, copy = _one(rng, list(tree)), tree[_one(rng, list(tree))]
    place = PurePosixPath(name)
    names = (f"{'deep/' * 60}{place.name}", f"{name}/{place.name}", f".{place.name}", str(place.with_stem("Clip")))
    further = (
        "camera.json",
        "manifest.jsonl",
        "meta/info.json",
        "samples.jsonl",
        "loop",
        "metadata.csv",
        "results.json",
    )
    tree[_one(rng, names + further)] = Link(".") if rng.random() < 0.3 else copy


_CHANGES: tuple[Callable[[Generator, dict[str, Node]], None], ...] = (
    *(_rename, _rename_folder, _resuffix, _remove, _replace, _replace, _replace, _exchange, _add, _add),
)
