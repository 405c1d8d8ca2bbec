"""What the documentation names exists: links and their headings, commands and options, modules."""

import re
import shlex
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import click
import pytest

from benchmarks.__main__ import main as validation
from kinebench_drake.cli import cli
from training.__main__ import main as training

ROOT = Path(__file__).parent.parent
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "examples").rglob("*.md")),
    ROOT / "models" / "perception" / "MODEL_CARD.md",
]
SCRIPTS = [*sorted((ROOT / "examples").glob("*.py")), *sorted((ROOT / "examples" / "cluster").iterdir())]
PROGRAM = "kinebench-drake"


@pytest.fixture
def anywhere(monkeypatch):
    """Paths that the documentation names need not be there."""
    monkeypatch.setattr(click.Path, "convert", lambda self, value, param, ctx: value)


def name(path):
    return path.relative_to(ROOT).as_posix()


def prose(text):
    """The text without blocks of code."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(page):
    """Names of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", prose(page.read_text()), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def command_lines(text):
    """Calls of the program in blocks of code, continued lines joined, comments left out."""
    for line in re.sub(r"\\\n\s*", " ", text).splitlines():
        found = re.match(rf"(?: {{4}}\s*|\s*)(?:\.venv/bin/)?{PROGRAM}( .*)$", line)
        if found:
            yield re.sub(r"\s#.*$", "", found[1])


def spans(text):
    """Pieces of code within prose."""
    return re.findall(r"`([^`\n]+)`", prose(text))


def find_command(words):
    """The command that the first of some words name, its name, and the words that follow."""
    found = cli
    path = [PROGRAM]
    while isinstance(found, click.Group) and words and not words[0].startswith("-"):
        deeper = found.get_command(click.Context(found), words[0])
        assert deeper is not None, f"{' '.join(path)} has no command {words[0]!r}"
        found = deeper
        path = [*path, words[0]]
        words = words[1:]
    return found, " ".join(path), words


def options(command):
    return {option for param in command.params for option in (*param.opts, *param.secondary_opts)} | {"--help", "-h"}


@cache
def all_options(command=cli):
    found = options(command)
    if isinstance(command, click.Group):
        for one in command.list_commands(click.Context(command)):
            found |= all_options(command.get_command(click.Context(command), one))
    return found


def refused(line):
    """What is wrong with a call of the program, which is parsed but not run; None if nothing is."""
    try:
        command, path, words = find_command(shlex.split(line))
        if isinstance(command, click.Group) and not {"--help", "--version", "-h"} & set(words):
            return f"{path} is a group of commands, none is named"
        command.make_context(path, words)
    except click.exceptions.Exit:  # --help and --version
        return None
    except (AssertionError, click.ClickException) as error:
        return str(error)
    return None


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_existing_files_and_headings(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page.read_text())):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        linked = (page.parent / file) if file else page
        assert linked.exists(), f"{name(page)} links to {target}"
        if anchor:
            assert anchor in anchors(linked), f"{name(page)} links to {target}; there is {sorted(anchors(linked))}"


@pytest.mark.usefixtures("anywhere")
@pytest.mark.parametrize("page", [*PAGES, *SCRIPTS], ids=name)
def test_command_lines_can_be_parsed(page):
    for line in command_lines(page.read_text()):
        told = refused(line)
        assert told is None, f"{name(page)}: {PROGRAM}{line}: {told}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_and_options_in_prose_exist(page):
    known = all_options() | all_options(validation) | all_options(training)
    for span in spans(page.read_text()):
        words = re.findall(r"[^\s=\[\]|/]+", span)
        if span.startswith(PROGRAM):
            command, path, words = find_command([w for w in words[1:] if w != "..."])
            unknown = {w for w in words if w.startswith("--")} - options(command)
            assert not unknown, f"{name(page)}: {path} has no {unknown} (`{span}`)"
        elif span.startswith("--"):
            unknown = {w for w in words if w.startswith("--")} - known
            assert not unknown, f"{name(page)}: no command has {unknown} (`{span}`)"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_modules_of_python_m_commands_exist(page):
    for module in re.findall(r"python -m (kinebench_drake[\w.]*)", page.read_text()):
        found = find_spec(module)
        assert found is not None, f"{name(page)}: no module {module}"
        assert not found.submodule_search_locations or find_spec(f"{module}.__main__"), f"{module} cannot be run"


def test_modules_that_the_architecture_names_exist():
    for path in re.findall(r"`([a-z_]+/[a-z_/*]+)(?:\.py)?`", (ROOT / "docs" / "architecture.md").read_text()):
        places = [*ROOT.glob(f"{path}*"), *(ROOT / "kinebench_drake").glob(f"{path}*")]
        assert places, f"docs/architecture.md names {path}"


def test_the_indexes_name_every_page_and_example():
    index = (ROOT / "docs" / "README.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "README.md" or f"({page.name})" in index, f"docs/README.md does not name {page.name}"
    listed = (ROOT / "examples" / "README.md").read_text()
    for script in (ROOT / "examples").glob("*.py"):
        assert f"({script.name})" in listed, f"examples/README.md does not name {script.name}"


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("score videos/", "out"),
        ("score videos/ --out x --overlap", "--overlap"),
        ("scores videos/ --out x", "no command 'scores'"),
        ("suite run --suite 4 --world-model still --out x", "4"),
        ("suite", "group of commands"),
    ],
)
def test_wrong_command_lines_are_detected(line, told):
    assert told in str(refused(line))
    assert refused("score videos/ --out results --jobs 2 --tag a=b") is None
