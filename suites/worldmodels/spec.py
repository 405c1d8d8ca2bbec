"""Spec of a world model on the command line: `KIND[:REST][?key=value&key=value]`."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar
from urllib.parse import unquote, urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kinebench_drake.errors import UsageError, suggestion

ARGUMENT = "world_model"
"""Argument that holds a spec."""
SERVERS = ("http", "https")
"""Kinds that name a server by its address."""
_PAIR = r"[A-Za-z_]\w*=[^&?]*"
_OPTIONS = re.compile(rf"(.*)\?((?:{_PAIR}(?:&{_PAIR})*)?)", re.DOTALL)


class Options(BaseModel):
    """Options of every world model; a field is a key of the spec, its description the help text."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str | None = Field(
        None, pattern=r"^[^\x00-\x1f/\\]{1,80}$", description="1 to 80 characters without / or \\, the name in results"
    )


class TimeoutOptions(Options):
    """Options of world models that may take long."""

    timeout: float = Field(1800.0, gt=0, allow_inf_nan=False, description="seconds for one video, all retries included")


_Model = TypeVar("_Model", bound=Options)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """Parsed spec."""

    text: str
    """The whole spec."""
    kind: str
    """Text before the first colon."""
    rest: str
    """Text after it, without the options."""
    options: Mapping[str, str]
    """Options, percent-decoded."""

    @property
    def identity(self) -> str:
        """Text that identifies the model: the spec, but for a server with a name without scheme, host and port."""
        if self.kind not in SERVERS or "name" not in self.options:
            return self.text
        options = "&".join(f"{key}={value}" for key, value in sorted(self.options.items()))
        return f"{urlsplit(self.address).path}?{options}"

    @property
    def address(self) -> str:
        """Address of a server: "http://...", or what follows the kind in "http:http://..."."""
        return self.plain if self.rest.startswith("//") else self.rest

    @property
    def plain(self) -> str:
        """Spec without options."""
        return f"{self.kind}:{self.rest}" if self.rest else self.kind

    def read(self, model: type[_Model]) -> _Model:
        """Validate the options.

        Raises:
            UsageError: a key is unknown or a value invalid; the message lists the valid keys.
        """
        try:
            return model.model_validate(self.options)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            key = str(first["loc"][0])
            valid = model.model_fields
            match first["type"]:
                case "extra_forbidden":
                    problem = f"{key} is not an option{suggestion(key, valid)}"
                case "string_pattern_mismatch":
                    problem = f"{key}={first['input']} must be {valid[key].description}"
                case _:
                    problem = f"{key}={first['input']}: {first['msg']}"
            raise self.unusable(f"{problem}; options are {', '.join(valid)}") from None

    def unusable(self, why: str) -> UsageError:
        """Return the error for an invalid spec."""
        return UsageError(f"${ARGUMENT} {self.text}: {why}")


def parse(text: str) -> Spec:
    """Parse a spec. Options begin at the last `?` that is followed by `key=value` pairs only, or by nothing.

    Raises:
        UsageError: a key is given twice.
    """
    match = _OPTIONS.fullmatch(text)
    plain, pairs = match.groups() if match else (text, "")
    kind, _, rest = plain.partition(":")
    spec = Spec(text=text, kind=kind, rest=rest, options={})
    options: dict[str, str] = {}
    for pair in filter(None, pairs.split("&")):
        key, _, value = pair.partition("=")
        if key in options:
            raise spec.unusable(f"{key} is given twice")
        options[key] = unquote(value)
    return Spec(text=text, kind=kind, rest=rest, options=options)
