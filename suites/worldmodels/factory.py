"""World models from the specs of the command line. Importing this module loads neither simulator nor network."""

import inspect
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

from pydantic import Field

from kinebench_drake.errors import KinebenchError, UsageError, cause, count_noun, suggestion
from kinebench_drake.plugin import is_class_name, load_class
from kinebench_drake.suites.worldmodels.cloud import DashScopeModel, MiniMaxModel
from kinebench_drake.suites.worldmodels.command import CommandModel
from kinebench_drake.suites.worldmodels.diffusers import DiffusersModel
from kinebench_drake.suites.worldmodels.folder import FolderModel
from kinebench_drake.suites.worldmodels.http import HttpModel
from kinebench_drake.suites.worldmodels.spec import ARGUMENT, SERVERS, Options, Spec, parse
from kinebench_drake.suites.worldmodels.worldmodel import WorldModel


class OracleOptions(Options):
    """Options of the oracle."""

    true_track: bool = Field(
        False, description="report the true track of each clip, so that no pose is read from pixels"
    )
    delay: int = Field(0, ge=0, le=48, description="frames by which the motion comes late")


_Options = TypeVar("_Options", bound=Options)


def _read_alone(spec: Spec, model: type[_Options]) -> _Options:
    """Validate the options of a spec without an argument."""
    if spec.rest:
        raise spec.unusable(f"expected {spec.kind} by itself, found {spec.rest!r} after it")
    return spec.read(model)


def _make_lower_bound(spec: Spec) -> WorldModel:
    """Create the model of "still" or "random"."""
    from kinebench_drake.suites.worldmodels.reference import RandomPolicyModel, StillModel

    name = _read_alone(spec, Options).name or spec.kind
    return StillModel(name) if spec.kind == "still" else RandomPolicyModel(name)


def _make_oracle(spec: Spec) -> WorldModel:
    from kinebench_drake.suites.worldmodels.reference import OracleModel

    options = _read_alone(spec, OracleOptions)
    late = f", {count_noun(options.delay, 'frame')} late" if options.delay else ""
    name = options.name or ("oracle, true track" if options.true_track else "oracle") + late
    return OracleModel(name, discloses=options.true_track, delay=options.delay)


class SpecForm(NamedTuple):
    """Form of a spec."""

    usage: str
    """Example, such as "folder:DIR"."""
    make: Callable[[Spec], WorldModel]
    """Creates the world model; raises UsageError or SetupError."""


FORMS: Mapping[str, SpecForm] = {
    "folder": SpecForm("folder:DIR", FolderModel),
    **dict.fromkeys(SERVERS, SpecForm("http://HOST:PORT/PATH", HttpModel)),
    "command": SpecForm("command:PROGRAM ARGUMENTS", CommandModel),
    "dashscope": SpecForm("dashscope:[MODEL]", DashScopeModel),
    "minimax": SpecForm("minimax:[MODEL]", MiniMaxModel),
    "diffusers": SpecForm("diffusers:PATH_OR_ID", DiffusersModel),
    "still": SpecForm("still", _make_lower_bound),
    "oracle": SpecForm("oracle", _make_oracle),
    "random": SpecForm("random", _make_lower_bound),
}
"""World models by the kind of their spec."""
_CLASS_USAGE = "module:Class, FILE.py:Class"


def create(text: str) -> WorldModel:
    """Create the world model of a spec; nothing is loaded or requested before the first video.

    Args:
        text: `KIND[:REST][?key=value&key=value]`, or `module:Class` or `FILE.py:Class`, whose options become keyword
            arguments.

    Raises:
        UsageError: the spec is invalid; the message lists the forms.
        SetupError: something it needs is missing on this machine, such as a key.
    """
    spec = parse(text)
    if form := FORMS.get(spec.kind):
        return form.make(spec)
    usages = ", ".join(dict.fromkeys([*(form.usage for form in FORMS.values()), _CLASS_USAGE]))
    if not is_class_name(spec.plain):
        hint = suggestion(spec.kind, FORMS)
        raise spec.unusable(
            f"no world model {spec.kind!r}{hint}; expected one of {usages}, each with options ?key=value&key=value"
        )
    try:
        plugin = load_class(spec.plain, argument=ARGUMENT, method="generate", arguments="request, out")
    except UsageError as error:
        hint = suggestion(spec.kind, FORMS)
        raise UsageError(f"{error}{hint}; world models are named {usages}") from None
    return _make_plugin(plugin, spec)


def _make_plugin(plugin: type, spec: Spec) -> WorldModel:
    """Create an instance of the user's class."""
    try:
        inspect.signature(plugin).bind(**spec.options)
    except TypeError as error:
        raise spec.unusable(f"the class does not take these options ({error})") from None
    try:
        model: Any = plugin(**spec.options)
    except KinebenchError:
        raise
    except Exception as error:  # code of the user, which may raise anything
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}, line {last.lineno}"
        raise spec.unusable(f"its __init__ raised {type(error).__name__}: {cause(error)} ({place})") from error
    if not isinstance(getattr(model, "name", None), str) or not callable(getattr(model, "close", None)):
        raise spec.unusable("expected a class whose instances have a name, a string, and a method close()")
    return cast(WorldModel, model)


class LazyWorldModel:
    """The world model of a process, created on first use. Pickled as its spec, so that each process creates its own."""

    def __init__(self, spec: str) -> None:
        """Parse the spec without creating the model.

        Raises:
            UsageError: an option is given twice.
        """
        self.spec = spec
        self.identity = parse(spec).identity
        self._model: WorldModel | None = None

    def __reduce__(self) -> tuple[type["LazyWorldModel"], tuple[str]]:
        return LazyWorldModel, (self.spec,)

    def get(self) -> WorldModel:
        """Return the world model, made by `create` the first time."""
        if self._model is None:
            self._model = create(self.spec)
        return self._model

    def close(self) -> None:
        """Release the model."""
        model, self._model = self._model, None
        if model is not None:
            model.close()
