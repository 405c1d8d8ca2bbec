"""Sample ids: unique, safe as file names, reproducible for the same samples in the same order."""

import re
from collections import Counter
from collections.abc import Sequence
from hashlib import blake2b

_ID_BYTES = 120


def unique_ids(wanted: Sequence[tuple[str, tuple[str, ...]]]) -> list[str]:
    """An id of its own for every sample.

    Args:
        wanted: the id each sample would like, and the folders that it may take along.

    Returns:
        Samples that want the same id take their folders along; what is still equal, upper and lower case not told
        apart, is numbered.
    """
    shared = Counter(safe(id).casefold() for id, _ in wanted)
    named = [
        safe("-".join((*folders, id))) if shared[safe(id).casefold()] > 1 and folders else safe(id)
        for id, folders in wanted
    ]
    counts, taken = Counter[str](), {id.casefold() for id in named}
    unique = []
    for id in named:
        counts[id.casefold()] += 1
        number, final = counts[id.casefold()], id
        while number > 1 and final.casefold() in taken:
            final = f"{id}-{number}"
            number += 1
        taken.add(final.casefold())
        unique.append(final)
    return unique


def safe(text: str) -> str:
    """`text` as a file name on any system: no separators, controls or reserved signs, not hidden, not too long."""
    name = text.encode(errors="replace").decode()
    name = re.sub(r'[\x00-\x1f\x7f/\\:*?"<>|]', "_", name).rstrip(". ")
    name = f"_{name}" if name.startswith(".") or not name else name
    return shorten(name)


def shorten(text: str) -> str:
    """`text`, or its beginning and a digest of all of it where it is long."""
    data = text.encode(errors="replace")
    if len(data) <= _ID_BYTES:
        return text
    return data[:40].decode(errors="ignore") + "-" + blake2b(data, digest_size=4).hexdigest()
