"""Format of `samples.jsonl` by its model: the JSON schema that is shipped, and the table of keys in docs/formats.md."""

import ast
import inspect
import json
import textwrap
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from kinebench_drake.anomaly import Anomaly
from kinebench_drake.results.record import UNKNOWN
from kinebench_drake.results.row import ANOMALIES, KEYS, Metrics, SampleRow

SCHEMA = Path("kinebench_drake/results/samples.schema.json")
"""JSON schema (draft 2020-12) of a line."""
_BEGIN = "<!-- keys -->\n"
_END = "<!-- end of keys -->\n"
_INTERNAL = (UNKNOWN, "keys", "line")
"""Fields of records that are no keys."""
_NUMBER: Mapping[str, Any] = {"type": ["number", "null"]}
_PLAIN: Mapping[object, Mapping[str, Any]] = {
    str: {"type": "string"},
    int: {"type": "integer"},
    bool: {"type": "boolean"},
    NoneType: {"type": "null"},
    float: _NUMBER,
}


def make_schema() -> dict[str, Any]:
    """Return the JSON schema of a line."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "samples.jsonl", **_object(SampleRow)}


def make_table() -> str:
    """Return the table of keys, in Markdown."""
    properties = _object(SampleRow)["properties"]
    rows = [f"| `{key}` | {_name_type(about)} | {about['description']} |" for key, about in properties.items()]
    return "\n".join(["| key | type | meaning |", "| --- | --- | --- |", *rows]) + "\n"


def write_files(root: Path) -> None:
    """Write schema and table of a checkout."""
    (root / SCHEMA).write_text(json.dumps(make_schema(), indent=1) + "\n")
    page = root / "docs" / "formats.md"
    before, _, rest = page.read_text().partition(_BEGIN)
    page.write_text(before + _BEGIN + "\n" + make_table() + "\n" + _END + rest.partition(_END)[2])


def _object(kind: Any) -> dict[str, Any]:
    """Return the schema of a record; its docstrings are the descriptions."""
    hints = get_type_hints(kind)
    meanings = _describe_fields(kind)
    keys = {f.name: f for f in fields(kind) if f.name not in _INTERNAL}
    properties = {key: {**_schema(hints[key]), "description": meanings.get(key, "")} for key in keys}
    required = [key for key, f in keys.items() if key in KEYS or f.default is MISSING]
    return {"type": "object", "properties": properties, "required": required}


def _schema(annotation: Any) -> Mapping[str, Any]:
    """Return the schema of a type; a number that is not finite is null."""
    arguments = get_args(annotation)
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    if get_origin(annotation) is UnionType:
        return {"anyOf": [_schema(argument) for argument in arguments]}
    if get_origin(annotation) is tuple:
        return {"type": "array", "items": _schema(arguments[0])}
    if annotation is Metrics:
        anomalies = {"type": ["array", "null"], "items": _object(Anomaly)}
        return {
            "type": "object",
            "properties": {ANOMALIES: anomalies},
            "additionalProperties": {"type": ["number", "boolean", "null"]},
        }
    if get_origin(annotation) is not None:
        return {"type": "object"}
    if is_dataclass(annotation):
        return _object(annotation)
    return {"type": "string", "enum": [member.value for member in annotation]}


def _describe_fields(kind: type) -> dict[str, str]:
    """Return the docstrings of the fields of a class in one line each."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    meanings = {}
    for statement, following in zip(tree.body, tree.body[1:], strict=False):
        match statement, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                meanings[name] = " ".join(text.split())
    return meanings


def _name_type(schema: Mapping[str, Any]) -> str:
    """Return a type in words, without null."""
    types = [each["type"] for each in schema.get("anyOf", [schema])]
    names = [name for own in types for name in ([own] if isinstance(own, str) else own) if name != "null"]
    return " or ".join(names)
