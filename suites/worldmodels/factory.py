"""From what the command line says to a world model."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import cast

from kinebench_drake.errors import UsageError
from kinebench_drake.plugin import is_class_name, load_class
from kinebench_drake.suites.worldmodels.command import CommandModel
from kinebench_drake.suites.worldmodels.dashscope import DashScopeModel
from kinebench_drake.suites.worldmodels.diffusers import DiffusersModel
from kinebench_drake.suites.worldmodels.folder import FolderModel
from kinebench_drake.suites.worldmodels.http import HttpModel
from kinebench_drake.suites.worldmodels.minimax import MiniMaxModel
from kinebench_drake.suites.worldmodels.spec import OPTION, SERVERS, Spec, parse
from kinebench_drake.suites.worldmodels.still import StillModel
from kinebench_drake.suites.worldmodels.worldmodel import WorldModel


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecForm:
    """One way of naming a world model."""

    usage: str
    """How the spec looks, such as "folder:DIR"."""
    make: Callable[[Spec], WorldModel]
    """Makes the world model; raises UsageError or SetupError."""


_HTTP = SpecForm(usage="http://HOST:PORT/PATH", make=HttpModel)
FORMS: Mapping[str, SpecForm] = {
    "folder": SpecForm(usage="folder:DIR", make=FolderModel),
    **dict.fromkeys(SERVERS, _HTTP),
    "command": SpecForm(usage="command:PROGRAM ARGUMENTS", make=CommandModel),
    "dashscope": SpecForm(usage="dashscope:[MODEL]", make=DashScopeModel),
    "minimax": SpecForm(usage="minimax:[MODEL]", make=MiniMaxModel),
    "diffusers": SpecForm(usage="diffusers:PATH_OR_ID", make=DiffusersModel),
    "still": SpecForm(usage="still", make=StillModel),
}
"""World models by the kind in their spec. Those that need the simulator are handed to `create` by who has it."""
_CLASS_USAGE = "module:Class"


def create(text: str, further: Mapping[str, SpecForm] | None = None) -> WorldModel:
    """The world model that a spec names; nothing is loaded or asked before the first video.

    Args:
        text: `KIND[:REST][?key=value&key=value]`, or `module:Class`, whose options are given to the class as keywords.
        further: forms beyond `FORMS`, by kind: those that need more than a request to answer it.

    Raises:
        UsageError: the spec cannot be used; the message lists the forms.
        SetupError: something it needs is missing on this machine, such as a key.
    """
    forms = {**FORMS, **(further or {})}
    spec = parse(text)
    if form := forms.get(spec.kind):
        return form.make(spec)
    usages = ", ".join(dict.fromkeys([*(form.usage for form in forms.values()), _CLASS_USAGE]))
    if not is_class_name(spec.plain):
        raise spec.unusable(f"expected one of {usages}, each with options ?key=value&key=value")
    try:
        return _plugin(spec)
    except UsageError as error:
        raise UsageError(f"{error}; world models are named {usages}") from None


def _plugin(spec: Spec) -> WorldModel:
    found = load_class(spec.plain, option=OPTION, method="generate", arguments="request, out")
    try:
        made = found(**spec.options)
    except TypeError as error:
        raise spec.unusable(f"the class does not take these options ({error})") from error
    if not isinstance(getattr(made, "name", None), str) or not callable(getattr(made, "close", None)):
        raise spec.unusable("expected a class whose instances have a name, a string, and a method close()")
    return cast(WorldModel, made)
