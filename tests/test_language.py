"""Plain technical English: identifiers and turns of phrase that must not come back."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SHIPPED = ("kinebench_drake", "grounding", "models", "suites", "benchmarks")

PARTICIPLES = frozenset({"found", "told", "known", "given", "seen", "held", "said"})
"""Participles that say nothing about the value they name."""
INVENTED = re.compile(r"\b(Theatre|Stagehand|TrickStage|Wanderer|HeldModel|PrivateStage|Telling|Footage|Sightings)\b")
TURNS = re.compile(
    r"^See `[^`]+`\.?$"
    r"|\bwhat (comes|became|is made) of\b"
    r"|\bis (told|handed|held against)\b|\bare (told|handed|held against)\b"
    r"|\btells? of\b|\bwho (asks|is told|wants)\b|\bby heart\b|\ball that (there )?(is|stands)\b|\bwhere nobody\b",
    re.IGNORECASE | re.MULTILINE,
)

RIDDLES = re.compile(
    r"_(told|asked|borne)(_|$)|_what_(is|are|was|were|can|cannot|would|has|does)_|_(is|are)_(said|given_up)(_|$)"
)
"""Parts of a name of a test that leave its law open."""


def modules():
    return sorted(p for top in SHIPPED for p in (ROOT / top).rglob("*.py") if p.resolve() == p)


def bindings(tree):
    """Names that a module binds: variables, arguments, functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.lineno


def docstrings(tree):
    """Docstrings of modules, classes, functions and attributes, with their lines."""
    for node in ast.walk(tree):
        for child in getattr(node, "body", ()) if isinstance(getattr(node, "body", ()), list) else ():
            if (
                isinstance(child, ast.Expr)
                and isinstance(child.value, ast.Constant)
                and isinstance(child.value.value, str)
            ):
                yield child.value.value, child.lineno


def problems(path):
    text = path.read_text()
    tree = ast.parse(text)
    for name, line in bindings(tree):
        if name.lstrip("_") in PARTICIPLES:
            yield f"{path.name}:{line}: `{name}` names no quantity"
    for number, line in enumerate(text.splitlines(), 1):
        if word := INVENTED.search(line):
            yield f"{path.name}:{number}: {word[0]} is not a term of the field"
    for doc, line in docstrings(tree):
        if turn := TURNS.search(doc):
            yield f"{path.name}:{line}: {turn[0]!r}"


@pytest.mark.parametrize("path", modules(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_identifiers_and_docstrings_are_plain(path):
    assert not list(problems(path))


@pytest.mark.parametrize("page", sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]), ids=lambda p: p.name)
def test_pages_of_the_documentation_are_plain(page):
    assert not TURNS.search(page.read_text())


def test_banned_identifiers_and_turns_of_phrase_are_detected(tmp_path):
    path = tmp_path / "a.py"
    path.write_text('class Theatre:\n    """See `X`."""\n\n\ndef f(given):\n    """What is told to f."""\n')
    assert len(list(problems(path))) == 4


def riddles(tree):
    """Names of tests, and their lines, that state no law."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_") and RIDDLES.search(node.name):
            yield node.name, node.lineno


@pytest.mark.parametrize(
    "path", sorted((ROOT / "tests").rglob("test_*.py")), ids=lambda p: p.relative_to(ROOT).as_posix()
)
def test_names_of_tests_are_plain(path):
    assert list(riddles(ast.parse(path.read_text()))) == []


def test_riddles_in_names_of_tests_are_detected():
    source = "def test_a_name_is_told(): ...\ndef test_what_is_left_over(): ...\ndef test_pages_are_plain(): ...\n"
    assert [line for _, line in riddles(ast.parse(source))] == [1, 2]
