"""Drop lists as SARIF 2.1.0, the format in which GitHub and editors show the findings of checkers.

Source: OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0", 2020.
"""

from collections.abc import Sequence
from urllib.parse import quote

from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.drops import Drop, DropReason

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"


def to_sarif(drops: Sequence[Drop], version: str) -> dict[str, Json]:
    """Return the log of a drop list; `version` is that of this program. Frames are in the messages and properties."""
    rules: list[Json] = [{"id": reason.key, "shortDescription": {"text": reason.meaning}} for reason in DropReason]
    driver: dict[str, Json] = {"name": "kinebench-drake", "semanticVersion": version, "rules": rules}
    results = list(map(_result, drops))
    return {"$schema": _SCHEMA, "version": "2.1.0", "runs": [{"tool": {"driver": driver}, "results": results}]}


def _result(drop: Drop) -> Json:
    frames = "" if drop.frame_start is None else f", frames {drop.frame_start} to {drop.frame_end}"
    path, _, part = drop.video.partition("#")
    place: dict[str, Json] = {
        "physicalLocation": {"artifactLocation": {"uri": quote(path)}},
        "logicalLocations": [{"name": part or drop.id, "kind": "resource"}],
    }
    return {
        "ruleId": drop.reason.key,
        "ruleIndex": list(DropReason).index(drop.reason),
        "level": "error" if drop.reason.drops_all else "warning",
        "message": {"text": f"{drop.id}{frames}: {drop.detail}"},
        "locations": [place],
        "properties": {"frame_start": drop.frame_start, "frame_end": drop.frame_end},
    }
