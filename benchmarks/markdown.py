"""Markdown pages with generated sections."""

from collections.abc import Iterable, Sequence
from math import isfinite

_MARK = "\n## "


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def percent(value: object) -> str:
    """Return a share as a percentage; "-" if it is no finite number."""
    return f"{100 * value:.1f} %" if isinstance(value, int | float) and isfinite(value) else "-"


def section(heading: str, *blocks: str | Iterable[str]) -> str:
    """Return a section of paragraphs and of blocks of lines, such as tables; empty ones are left out."""
    texts = (block if isinstance(block, str) else "\n".join(block) for block in blocks)
    return "\n\n".join([f"## {heading}", *filter(None, texts)])


def replace_section(document: str, section: str) -> str:
    """Replace the section with the same heading, or append the section.

    Args:
        document: Markdown page.
        section: text that starts with a line "## HEADING".
    """
    top, *others = _split(document)
    same = [k for k, other in enumerate(others) if _heading(other) == _heading(section)]
    if same:
        others[same[0]] = section
    else:
        others.append(section)
    return _join([top, *others])


def _split(document: str) -> list[str]:
    """Split a page into the text before the first section and the sections."""
    top, *others = f"\n{document}".split(_MARK)
    return [top, *(f"## {other}" for other in others)]


def _heading(section: str) -> str:
    return section.partition("\n")[0].strip()


def _join(parts: Iterable[str]) -> str:
    return "\n\n".join(text for part in parts if (text := part.strip())) + "\n"
