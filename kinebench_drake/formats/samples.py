"""Samples: fields common to videos and trajectories, and ids, the same for the same samples in the same order."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path
from typing import TypeVar

MIN_PERIOD_S = 1e-4
MAX_PERIOD_S = 1e3
"""Shortest and longest task time between two frames [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One input and its labels."""

    id: str
    """Unique, safe as a file name; contains the stem of the file, or the name of the dataset and of its part."""
    path: Path
    """File or frame folder that holds it, possibly with others."""
    video: str
    """Name in results: relative to the named folder or manifest, with `#` before a part of a file."""
    task: str | None = None
    model: str | None = None
    seed: int | None = None
    prompt: str | None = None
    success: bool | None = None
    """True if the task succeeded according to the file."""
    problem: str | None = None
    """Reason why it cannot be read (a broken manifest line); None if it can be tried."""


AnySample = TypeVar("AnySample", bound=Sample)


def finish_samples(
    samples: Sequence[AnySample], folders: Callable[[AnySample], tuple[str, ...]], model: str | None, task: str | None
) -> tuple[AnySample, ...]:
    """Return samples with unique ids, and with the model and task of the user where they have none.

    `folders` returns the folders that may be prepended to an id.
    """
    ids = unique_ids([(sample.id, folders(sample)) for sample in samples])
    return tuple(
        replace(sample, id=id, model=sample.model or model, task=sample.task or task)
        for sample, id in zip(samples, ids, strict=True)
    )


def unique_ids(wanted: Sequence[tuple[str, tuple[str, ...]]]) -> list[str]:
    """Return a unique id for every sample, from its preferred id and the folders that may be prepended to it.

    Ids of samples with the same preferred id contain their folders; ids that are still equal, ignoring case, are
    numbered.
    """
    counts = Counter(safe(id).casefold() for id, _ in wanted)
    candidates = [
        safe("-".join((*folders, id))) if counts[safe(id).casefold()] > 1 and folders else safe(id)
        for id, folders in wanted
    ]
    repeats = Counter[str]()
    used = {id.casefold() for id in candidates}
    unique = []
    for id in candidates:
        repeats[id.casefold()] += 1
        number = repeats[id.casefold()]
        final = id
        while number > 1 and final.casefold() in used:
            final = f"{id}-{number}"
            number += 1
        used.add(final.casefold())
        unique.append(final)
    return unique


def safe(text: str) -> str:
    """Return `text` as a file name for any system: no separators or reserved characters, not hidden, not long."""
    name = text.encode(errors="replace").decode()
    name = re.sub(r'[\x00-\x1f\x7f/\\:*?"<>|]', "_", name).rstrip(". ")
    name = f"_{name}" if name.startswith(".") or not name else name
    return shorten(name)


def shorten(text: str) -> str:
    """Return `text`, or if it is long its beginning and a digest of all of it."""
    data = text.encode(errors="replace")
    if len(data) <= 120:
        return text
    return data[:40].decode(errors="ignore") + "-" + blake2b(data, digest_size=4).hexdigest()
