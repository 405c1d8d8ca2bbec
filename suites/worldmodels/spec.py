"""How a world model is named on the command line: `KIND[:REST][?key=value&key=value]`."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar
from urllib.parse import unquote, urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kinebench_drake.errors import UsageError

OPTION = "--world-model"
"""Where a spec is given."""
SERVERS = ("http", "https")
"""Kinds that name a server by its address."""
_PAIR = r"[A-Za-z_]\w*=[^&?]*"
_OPTIONS = re.compile(rf"(.*)\?((?:{_PAIR}(?:&{_PAIR})*)?)", re.DOTALL)


class Options(BaseModel):
    """Options that every world model has; a field is a key of the spec, its description says what it does."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str | None = Field(None, pattern=r"^[^\x00-\x1f/\\]{1,80}$", description="how results call the model")


class ServiceOptions(Options):
    """Options of everything that may take long."""

    timeout: float = Field(1800.0, gt=0, allow_inf_nan=False, description="seconds for one video, all retries included")


_Model = TypeVar("_Model", bound=Options)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """A spec, taken apart."""

    text: str
    """As it was given."""
    kind: str
    """What stands before the first colon."""
    rest: str
    """What stands after it, without the options."""
    options: Mapping[str, str]
    """The options, percent signs decoded."""

    @property
    def identity(self) -> str:
        """What tells its model from others: the spec as given, of a server with a name but for where that listens."""
        url = urlsplit(self.plain)
        if self.kind not in SERVERS or "name" not in self.options:
            return self.text
        options = "&".join(f"{key}={value}" for key, value in sorted(self.options.items()))
        return f"{url.path}?{options}"

    @property
    def plain(self) -> str:
        """The spec without its options."""
        return f"{self.kind}:{self.rest}" if self.rest else self.kind

    def read(self, model: type[_Model]) -> _Model:
        """The options, checked.

        Raises:
            UsageError: a key is unknown or a value unusable; the message lists the valid keys.
        """
        try:
            return model.model_validate(self.options)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            key = str(first["loc"][0]) if first["loc"] else ""
            told = "is not an option" if first["type"] == "extra_forbidden" else f"={first['input']}: {first['msg']}"
            valid = ", ".join(model.model_fields)
            raise self.unusable(f"{key}{'' if told.startswith('=') else ' '}{told}; options are {valid}") from None

    def bare(self) -> None:
        """Make sure that nothing follows the kind.

        Raises:
            UsageError: something does.
        """
        if self.rest:
            raise self.unusable(f"expected {self.kind} by itself, found {self.rest!r} after it")

    def unusable(self, why: str) -> UsageError:
        """The error that says why the spec cannot be used."""
        return UsageError(f"{OPTION} {self.text}: {why}")


def parse(text: str) -> Spec:
    """Take a spec apart. Options begin at the last `?` that nothing but `key=value` pairs, or nothing at all, follows.

    Raises:
        UsageError: a key is given twice.
    """
    plain, pairs = text, ""
    if found := _OPTIONS.fullmatch(text):
        plain, pairs = found.groups()
    kind, _, rest = plain.partition(":")
    spec = Spec(text=text, kind=kind, rest=rest, options={})
    options: dict[str, str] = {}
    for pair in filter(None, pairs.split("&")):
        key, _, value = pair.partition("=")
        if key in options:
            raise spec.unusable(f"{key} is given twice")
        options[key] = unquote(value)
    return Spec(text=text, kind=kind, rest=rest, options=options)
