"""Typed records and their JSON objects: the fields of a frozen dataclass are the keys.

A field without a default is a key of every object; one with a default is a key of those in which its value differs.
Keys that a class does not have, those of newer versions, are its field `unknown`, where it has one.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, Field, is_dataclass
from enum import Enum
from functools import lru_cache
from types import NoneType, UnionType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

from kinebench_drake.errors import InputError
from kinebench_drake.io.jsonl import Json, dump, intern_text, parse_json

Record = TypeVar("Record")
Converter = Callable[[Any], Any]
UNKNOWN = "unknown"
"""Name of the field with the keys that a class does not have."""
_CONVERTERS: dict[Any, Mapping[str, Converter]] = {}
"""Converters of the keys of each class, made when it is first read."""
_SHARED_LENGTH = 200
"""Longest JSON text of an object that equal objects share: many samples have the same camera or framing."""


def read_record(kind: type[Record], data: object) -> Record:
    """Convert a JSON object to a record.

    Raises:
        InputError: it is no object, lacks a key, or a value is of another type.
    """
    if isinstance(data, kind):
        return data
    if not isinstance(data, Mapping):
        raise InputError(f"expected an object, found {type(data).__name__}")
    converters = field_converters(kind)
    values = {key: convert(converters, key, value) for key, value in data.items() if key in converters}
    unknown = {key: intern_text(value) for key, value in data.items() if key not in converters}
    if unknown and UNKNOWN in _fields(kind):
        values[UNKNOWN] = unknown
    try:
        return kind(**values)
    except TypeError as error:
        raise InputError(f"a key is missing ({error})") from None


def convert(converters: Mapping[str, Converter], key: str, value: object) -> Any:
    """Convert the value of a key.

    Raises:
        InputError: it is of another type.
    """
    try:
        return converters[key](value)
    except (InputError, TypeError, ValueError):
        raise InputError(f"{key} is {value!r:.60}") from None


def to_json(value: Any) -> Json:
    """Convert a value of a record, or a record, to JSON; null takes the place of NaN and infinity."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Enum):
        return cast(Json, value.value)
    if is_dataclass(value):
        present = [f.name for f in _fields(type(value)).values() if _is_present(f, getattr(value, f.name))]
        own = {name: getattr(value, name) for name in present}
        return {key: to_json(inner) for key, inner in {**own, **getattr(value, UNKNOWN, {})}.items()}
    if isinstance(value, Mapping):
        return {key: to_json(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [to_json(inner) for inner in value]
    return cast(Json, value)


def _is_present(field: Field[Any], value: object) -> bool:
    return field.name != UNKNOWN and (field.default is MISSING or value != field.default)


def _fields(kind: Any) -> Mapping[str, Field[Any]]:
    return cast(Mapping[str, Field[Any]], kind.__dataclass_fields__)


def field_converters(kind: Any) -> Mapping[str, Converter]:
    """Return the function that converts a JSON value, or raises, for each key of a class."""
    if kind not in _CONVERTERS:
        hints = get_type_hints(kind)
        _CONVERTERS[kind] = {name: _converter(hints[name]) for name in _fields(kind) if name != UNKNOWN}
    return _CONVERTERS[kind]


def _converter(annotation: Any) -> Converter:
    """Return the function that converts a JSON value to a type, or raises InputError, TypeError or ValueError."""
    origin = get_origin(annotation)
    arguments = get_args(annotation)
    if origin is UnionType:
        return _union_converter([_converter(argument) for argument in arguments if argument is not NoneType])
    if origin is tuple:
        inner = _converter(arguments[0])
        return lambda value: tuple(map(inner, _checked(value, list, tuple)))
    if origin is not None and is_dataclass(arguments[1]):
        entry = _converter(arguments[1])
        return lambda value: {name: entry(own) for name, own in _checked(value, Mapping).items()}
    if origin is not None:
        return lambda value: share(_checked(value, Mapping))
    if issubclass(annotation, Enum):
        return cast(Converter, annotation)
    if hasattr(annotation, "from_json"):
        return cast(Converter, annotation.from_json)
    if is_dataclass(annotation):
        return lambda value: read_record(cast(type, annotation), value)
    if annotation is float:
        return lambda value: math.nan if value is None else _checked(value, float, int)
    return lambda value: intern_text(_checked(value, annotation))


def _union_converter(inner: Sequence[Converter]) -> Converter:
    """Return the converter to the first type that fits; None is None."""

    def convert_first(value: Any) -> Any:
        if value is None:
            return None
        for attempt in inner:
            with suppress(TypeError):
                return attempt(value)
        raise TypeError

    return convert_first


def _checked(value: Any, *kinds: type) -> Any:
    """Return the value if it is of one of the types; a boolean is no number."""
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        raise TypeError
    return value


def share(value: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return an object in which equal texts are one object; a short one is shared as a whole."""
    text = dump(to_json(value))
    return cast(Mapping[str, Any], _parse_shared(text) if len(text) <= _SHARED_LENGTH else intern_text(value))


@lru_cache(maxsize=4096)
def _parse_shared(text: str) -> Json:
    return cast(Json, intern_text(parse_json(text)))
