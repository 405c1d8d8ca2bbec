"""Size and naming of sources and docs at revisions of the repository, read from git without a checkout."""

import ast
import subprocess
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path, PurePosixPath

from benchmarks.markdown import table
from kinebench_drake.errors import UsageError

SHIPPED = ("kinebench_drake", "grounding", "models", "suites")
"""Top folders of the package."""
NOT_SHIPPED = ("kinebench_drake/validation", "kinebench_drake/suites/samples.py", "kinebench_drake/suites/bench.py")
"""Benchmarks of earlier revisions, which stood in the package."""
BANNED_NAMES = frozenset({"found", "told", "known", "given", "seen", "held", "said"})
"""Participles that name no quantity; tests/test_language.py forbids them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StructureCounts:
    """Counts of one revision; `LABELS` says of what."""

    shipped_files: int
    shipped_lines: int
    benchmark_files: int
    benchmark_lines: int
    test_files: int
    test_lines: int
    package_top_files: int
    repeated_classes: int
    repeated_modules: int
    banned_bindings: int
    constants: int
    docs_words: int


LABELS = {
    "shipped_files": "shipped Python files",
    "shipped_lines": "lines of shipped Python files",
    "benchmark_files": "files of benchmarks",
    "benchmark_lines": "lines of benchmarks",
    "test_files": "files of tests",
    "test_lines": "lines of tests",
    "package_top_files": "Python files directly in kinebench_drake/",
    "repeated_classes": "class names used more than once in shipped files",
    "repeated_modules": "module names used more than once in shipped files",
    "banned_bindings": "bindings with banned names in shipped files",
    "constants": "numeric constants of shipped modules",
    "docs_words": "words of README and docs",
}


def count_revision(repository: Path, revision: str) -> StructureCounts:
    """Count the sources of a revision.

    Args:
        repository: root of the repository.
        revision: any name that git knows.

    Raises:
        UsageError: it is no repository or no revision of it.
    """
    files = dict(_files(repository, revision))
    sources = {name: text for name, text in files.items() if name.endswith(".py")}
    docs = [text for name, text in files.items() if name == "README.md" or PurePosixPath(name).match("docs/*.md")]
    shipped = {name: text for name, text in sources.items() if name.startswith(tuple(f"{top}/" for top in SHIPPED))}
    former = {name for name in shipped if name.startswith(NOT_SHIPPED)}
    benchmarks = [text for name, text in sources.items() if name.startswith("benchmarks/") or name in former]
    tests = [text for name, text in sources.items() if name.startswith("tests/")]
    shipped = {name: text for name, text in shipped.items() if name not in former}
    trees = [ast.parse(text) for text in shipped.values()]
    classes = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    modules = Counter(stem for name in shipped if (stem := PurePosixPath(name).stem) != "__init__")
    return StructureCounts(
        shipped_files=len(shipped),
        shipped_lines=_lines(shipped.values()),
        benchmark_files=len(benchmarks),
        benchmark_lines=_lines(benchmarks),
        test_files=len(tests),
        test_lines=_lines(tests),
        package_top_files=sum(name.count("/") == 1 and name.startswith("kinebench_drake/") for name in shipped),
        repeated_classes=sum(count > 1 for count in classes.values()),
        repeated_modules=sum(count > 1 for count in modules.values()),
        banned_bindings=sum(name.lstrip("_") in BANNED_NAMES for tree in trees for name in _bindings(tree)),
        constants=sum(map(_count_constants, trees)),
        docs_words=sum(len(text.split()) for text in docs),
    )


def _files(repository: Path, revision: str) -> Iterator[tuple[str, str]]:
    """Yield path and text of each Python or Markdown file of a revision; symbolic links are left out."""
    listing = _git(repository, "ls-tree", "-r", "-z", revision).decode(errors="replace")
    objects = []
    for entry in filter(None, listing.split("\0")):
        about, _, name = entry.partition("\t")
        mode, kind, digest = about.split()
        if kind == "blob" and mode != "120000" and name.endswith((".py", ".md")):
            objects.append((name, digest))
    blobs = _git(repository, "cat-file", "--batch", stdin="".join(f"{digest}\n" for _, digest in objects).encode())
    at = 0
    for name, _ in objects:
        header, _, _ = blobs[at:].partition(b"\n")
        begin = at + len(header) + 1
        size = int(header.split()[2])
        yield name, blobs[begin : begin + size].decode()
        at = begin + size + 1


def _git(repository: Path, *arguments: str, stdin: bytes | None = None) -> bytes:
    try:
        return subprocess.run(
            ["git", "-C", str(repository), *arguments], input=stdin, capture_output=True, check=True
        ).stdout
    except FileNotFoundError:
        raise UsageError("git is not installed") from None
    except subprocess.CalledProcessError as error:
        lines = error.stderr.decode(errors="replace").splitlines()
        raise UsageError(f"git {arguments[0]}: {lines[0] if lines else f'status {error.returncode}'}") from None


def current_revision(repository: Path) -> str:
    """Return the name of the revision checked out, -dirty if files differ; "unknown" without a repository."""
    try:
        return _git(repository, "describe", "--always", "--abbrev=12", "--dirty").decode().strip()
    except UsageError:
        return "unknown"


def _lines(texts: Iterable[str]) -> int:
    return sum(len(text.splitlines()) for text in texts)


def _bindings(tree: ast.AST) -> Iterator[str]:
    """Yield the names of variables, arguments, functions and classes that a module binds."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name


def _count_constants(tree: ast.Module) -> int:
    """Count the names in capitals to which a module binds a value with a number in it."""
    count = 0
    for statement in tree.body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        numbers = [
            node.value
            for node in ast.walk(getattr(statement, "value", None) or ast.Pass())
            if isinstance(node, ast.Constant) and type(node.value) in (int, float)
        ]
        count += sum(isinstance(t, ast.Name) and t.id.lstrip("_").isupper() and bool(numbers) for t in targets)
    return count


def structure_table(counts: Sequence[tuple[str, StructureCounts]]) -> str:
    """Return the counts of revisions, each with its name, as a Markdown table."""
    rows = [
        [LABELS[field.name], *(f"{getattr(of, field.name):,}" for _, of in counts)] for field in fields(StructureCounts)
    ]
    return "\n".join(table(("", *(name for name, _ in counts)), rows))
