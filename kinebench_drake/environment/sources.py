"""Source files behind a result: the modules that a module reaches through its imports, read from the syntax trees."""

import ast
from collections.abc import Iterator
from pathlib import Path

import kinebench_drake

_PACKAGE = "kinebench_drake"


def reachable_sources(*modules: str) -> tuple[Path, ...]:
    """Return the source files of modules of this package and of all its modules that they import, sorted.

    Imports are followed wherever they stand, also inside functions; packages on the way count with their `__init__`.
    The top `__init__` counts, but is not followed: its function that loads the Python interface on demand would reach
    every module. Classes that a user names as `module:Class` are not reached.

    Args:
        modules: full names such as `kinebench_drake.grounding.pipeline`.

    Raises:
        ValueError: there is no such module in this package.
    """
    reached: dict[str, Path] = {}
    pending = list(modules)
    while pending:
        name = pending.pop()
        if name in reached:
            continue
        path = _path(name)
        if path is None:
            raise ValueError(f"there is no module {name!r} in {_PACKAGE}")
        reached[name] = path
        if name != _PACKAGE:
            pending += [name.rpartition(".")[0], *_imports(path)]
    return tuple(sorted(reached.values()))


def _path(name: str) -> Path | None:
    """Return the file of a module of this package, None where the name is no module of it."""
    top, *rest = name.split(".")
    if top != _PACKAGE:
        return None
    base = Path(kinebench_drake.__file__).parent.joinpath(*rest)
    candidates = (base / "__init__.py", base.with_suffix(".py")) if rest else (base / "__init__.py",)
    return next((path for path in candidates if path.is_file()), None)


def _imports(path: Path) -> Iterator[str]:
    """Yield the modules of this package that a file imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [node.module, *(name for name in inner if _path(name))]
        else:
            continue
        yield from (name for name in names if name.split(".")[0] == _PACKAGE)
