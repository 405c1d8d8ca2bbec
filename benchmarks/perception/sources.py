"""Source files behind a result: the modules that a module reaches through its imports, read from the syntax trees."""

import ast
import hashlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import kinebench_drake
from kinebench_drake.errors import SetupError
from kinebench_drake.io.files import cache_folder
from kinebench_drake.io.jsonl import read_object, write_json

_TOP = Path(kinebench_drake.__file__).parent
_PACKAGE = "kinebench_drake"
_FOLLOWED = (_PACKAGE, "benchmarks", "training")
"""Top names of imports that are followed; the developers' tools stand beside the package in a clone alone."""
_CACHE = "sources.json"
"""File in the cache folder: code hash and imports of sources by the hash of their bytes; parsing takes a second."""
CACHED_SOURCES = 3000
"""Sources in that file; beyond, those of earlier versions are dropped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """One source file."""

    name: str
    """Full name of the module."""
    path: Path
    code: str
    """SHA-256 of its syntax tree, without docstrings and comments."""


def trace_sources(*modules: str) -> tuple[Source, ...]:
    """Return the sources of modules of this package and of all its modules that they import, sorted by name.

    Imports are followed wherever they stand, also inside functions; packages on the way count with their `__init__`.
    The top `__init__` counts, but is not followed: its function that loads the Python interface on demand would reach
    every module. Classes that a user names as `module:Class` are not reached.

    Args:
        modules: full names such as `kinebench_drake.grounding.pipeline`.

    Raises:
        ValueError: there is no such module in this package.
    """
    cache = _read_cache()
    parsed = dict[str, tuple[str, list[str]]]()
    reached: dict[str, Source] = {}
    pending = list(modules)
    while pending:
        name = pending.pop()
        if name in reached:
            continue
        path = _path(name)
        if path is None:
            raise ValueError(f"there is no module {name!r} in {_PACKAGE}")
        data = path.read_bytes()
        key = hashlib.sha256(data).hexdigest()
        code, imports = parsed[key] = cache.get(key) or _parse(data)
        reached[name] = Source(name=name, path=path, code=code)
        if name != _PACKAGE:
            pending += filter(_path, [name.rpartition(".")[0], *imports])
    if parsed.keys() - cache.keys():
        with suppress(OSError, SetupError):  # without a cache every call takes a second
            cache_folder().mkdir(parents=True, exist_ok=True)
            write_json(cache_folder() / _CACHE, {**(cache if len(cache) < CACHED_SOURCES else {}), **parsed})
    return tuple(reached[name] for name in sorted(reached))


def _read_cache() -> dict[str, tuple[str, list[str]]]:
    with suppress(OSError, ValueError, TypeError, AttributeError):
        stored = cast(Mapping[str, tuple[str, list[str]]], read_object(cache_folder() / _CACHE))
        return {key: (str(code), list(map(str, imports))) for key, (code, imports) in stored.items()}
    return {}


def _path(name: str) -> Path | None:
    """Return the file of a module, None where the name is no module of this package or of a developer's tool."""
    top, *rest = name.split(".")
    if top not in _FOLLOWED:
        return None
    base = (_TOP if top == _PACKAGE else _TOP.parent / top).joinpath(*rest)
    candidates = (base / "__init__.py", base.with_suffix(".py")) if rest else (base / "__init__.py",)
    return next((path for path in candidates if path.is_file()), None)


def _parse(data: bytes) -> tuple[str, list[str]]:
    """Return the hash of the syntax tree of a source, and the names in this package that it imports.

    A name may be a module or something inside one.
    """
    tree = ast.parse(data)
    imports = sorted(set(_imports(tree)))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            code = [statement for statement in node.body if not _is_text(statement)]
            node.body = code if code or isinstance(node, ast.Module) else [ast.Pass()]
    return hashlib.sha256(ast.unparse(tree).encode()).hexdigest(), imports


def _is_text(statement: ast.stmt) -> bool:
    """Return whether a statement is a string alone: the docstring of a module, class, function or constant."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _imports(tree: ast.Module) -> Iterator[str]:
    """Yield the names in this package that a syntax tree imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (name for name in names if name.split(".")[0] in _FOLLOWED)
