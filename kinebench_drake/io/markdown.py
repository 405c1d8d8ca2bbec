"""Markdown pages with generated sections."""

from collections.abc import Iterable, Sequence

_MARK = "\n## "


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def replace_section(document: str, section: str) -> str:
    """The document with its section of the same heading replaced, or the section added at its end.

    Args:
        document: a page of Markdown.
        section: text that begins with a line "## HEADING".
    """
    top, *others = _split(document)
    found = [k for k, other in enumerate(others) if _heading(other) == _heading(section)]
    if found:
        others[found[0]] = section
    else:
        others.append(section)
    return _join([top, *others])


def keep_sections(document: str, earlier: str) -> str:
    """A page written anew, and after it those sections of its earlier state that it does not have itself."""
    parts = _split(document)
    own = {_heading(part) for part in parts[1:]}
    return _join([*parts, *(part for part in _split(earlier)[1:] if _heading(part) not in own)])


def _split(document: str) -> list[str]:
    """What stands before the first section, and the sections."""
    top, *others = f"\n{document}".split(_MARK)
    return [top, *(f"## {other}" for other in others)]


def _heading(section: str) -> str:
    return section.partition("\n")[0].strip()


def _join(parts: Iterable[str]) -> str:
    return "\n\n".join(text for part in parts if (text := part.strip())) + "\n"
