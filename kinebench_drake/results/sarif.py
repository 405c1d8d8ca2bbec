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
    reasons = list(DropReason)
    rules: list[Json] = [
        {
            "id": reason.value,
            "shortDescription": {"text": reason.meaning},
            "defaultConfiguration": {"level": _level(reason)},
        }
        for reason in reasons
    ]
    driver: dict[str, Json] = {"name": "kinebench-drake", "semanticVersion": version, "rules": rules}
    results: list[Json] = [_result(drop, reasons.index(drop.reason)) for drop in drops]
    return {"$schema": _SCHEMA, "version": "2.1.0", "runs": [{"tool": {"driver": driver}, "results": results}]}


def _result(drop: Drop, rule: int) -> Json:
    frames = "" if drop.frames is None else f", frames {drop.frames[0]} to {drop.frames[1]}"
    path, _, part = drop.video.partition("#")
    return {
        "ruleId": drop.reason.value,
        "ruleIndex": rule,
        "level": _level(drop.reason),
        "message": {"text": f"{drop.id}{frames}: {drop.detail}"},
        "locations": [
            {
                "physicalLocation": {"artifactLocation": {"uri": quote(path)}},
                "logicalLocations": [{"name": part or drop.id, "kind": "resource"}],
            }
        ],
        "properties": {} if drop.frames is None else {"frame_start": drop.frames[0], "frame_end": drop.frames[1]},
    }


def _level(reason: DropReason) -> str:
    return "error" if reason.drops_all else "warning"
