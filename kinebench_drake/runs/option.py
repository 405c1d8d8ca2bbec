"""Options of runs, declared once.

An annotated field of a configuration is an option of the command line, an argument in Python and an entry of
results.json: `limit: Annotated[int | None, Option("Process only the first N samples.", least=1)] = None`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from enum import Enum
from os import PathLike, fspath
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, cast, get_args, get_origin

from kinebench_drake.errors import UsageError, member_of, option_of
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.metadata import Shard


@dataclass(frozen=True, slots=True)
class Option:
    """Declaration of an option; name, type and default are those of the field."""

    help: str
    """Meaning, in which "$name" stands for another option."""
    metavar: str | None = None
    """Placeholder of the value in help texts."""
    least: int | None = None
    most: int | None = None
    choices: Sequence[str] = ()
    """Valid texts, besides the values of an enumeration."""
    also: str | None = None
    """Another name on the command line; of a truth value the one that sets it to false."""
    key: str | None = ""
    """Key in the configuration of results.json: "" for the name, None if it is not recorded."""
    name: str = ""
    """Name of the argument; that on the command line follows from it (`errors.option_of`)."""
    kind: type = str
    """Type of its values, besides None."""
    default: Any = None
    """Value if it is not given."""
    required: bool = False
    """True if it must be given."""

    @property
    def flags(self) -> tuple[str, ...]:
        """Names on the command line."""
        name = option_of(self.name)
        if self.kind is bool:
            return (name if self.also is None else f"{name}/{self.also}",)
        return (name,) if self.also is None else (name, self.also)

    def parse(self, value: Any) -> Any:
        """Return the value of the field for a value from the command line or from Python.

        Raises:
            UsageError: it is invalid.
        """
        if value is None:
            return None
        if issubclass(self.kind, Enum):
            return member_of(self.kind, value, self.name)
        if self.kind is Shard:
            return value if isinstance(value, Shard) else Shard.parse(value)
        if self.kind is Path:
            return Path(value) if isinstance(value, str | PathLike) else value
        if self.kind is str:
            return fspath(value) if isinstance(value, PathLike) else value
        low = self.least
        high = self.most
        if (low is not None and value < low) or (high is not None and value > high):
            raise UsageError(f"${self.name} is {value}, expected {low}{' or more' if high is None else f' to {high}'}")
        return value


def options_of(config: type[Any]) -> Mapping[str, Option]:
    """Return the options of a configuration by name, in the order of its fields."""
    options = {}
    for field in fields(config):
        if get_origin(field.type) is Annotated:
            kind, declared = get_args(field.type)
            required = field.default is MISSING and field.default_factory is MISSING
            default = None if field.default is MISSING else field.default
            options[field.name] = replace(
                declared, name=field.name, kind=_first_type(kind), default=default, required=required
            )
    return options


def _first_type(annotation: Any) -> type:
    """Return the first type of an annotation such as `int | None`."""
    first = get_args(annotation)[0] if isinstance(annotation, UnionType) else annotation
    return cast(type, get_origin(first) or first)


def parse_options(config: Any) -> None:
    """Convert the options of a configuration from what callers give; for its `__post_init__`."""
    for name, declared in options_of(type(config)).items():
        object.__setattr__(config, name, declared.parse(getattr(config, name)))


def options_json(config: Any) -> dict[str, Json]:
    """Return the recorded options of a configuration by key; of paths their last name."""
    return {
        declared.key or name: _to_json(getattr(config, name))
        for name, declared in options_of(type(config)).items()
        if declared.key is not None
    }


def _to_json(value: Any) -> Json:
    if isinstance(value, Enum):
        return cast(Json, value.value)
    if isinstance(value, Path):
        return value.resolve().name
    if isinstance(value, tuple):
        return list(value)
    return str(value) if isinstance(value, Shard) else cast(Json, value)
