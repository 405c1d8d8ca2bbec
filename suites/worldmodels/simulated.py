"""World models that need the simulator, by the kind in their spec."""

from collections.abc import Mapping

from pydantic import Field

from kinebench_drake.products import AnomalyKind
from kinebench_drake.suites.faults.fault import Grade, choose
from kinebench_drake.suites.worldmodels.factory import Form
from kinebench_drake.suites.worldmodels.oracle import Oracle
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.suites.worldmodels.wanderer import Wanderer

_FAULTY = "oracle+"


class OracleOptions(Options):
    """Options of the oracle."""

    told: bool = Field(False, description="tell the true track of each clip, so that nothing is read from pixels")


def _oracle(spec: Spec) -> Oracle:
    spec.bare()
    options = spec.read(OracleOptions)
    return Oracle(name=options.name or ("oracle, true track" if options.told else "oracle"), tells=options.told)


def _faulty_oracle(spec: Spec) -> Oracle:
    grade = _grade(spec)
    return Oracle(name=spec.read(Options).name or f"{_FAULTY}{grade.label}", fault=grade)


def _grade(spec: Spec) -> Grade:
    """The one fault of a spec such as "oracle+teleport:0.15".

    Raises:
        UsageError: no size is given, or several.
    """
    grades = choose([AnomalyKind(spec.kind.removeprefix(_FAULTY))], spec.rest)
    if len(grades) > len({grade.form for grade in grades}):
        raise spec.unusable(f"expected one size, such as {spec.kind}:{grades[0].size:g}")
    return grades[0]


def _wanderer(spec: Spec) -> Wanderer:
    spec.bare()
    return Wanderer(name=spec.read(Options).name or "random")


_FAULTY_FORM = Form(
    usage=f"{_FAULTY}KIND:SIZE (KIND: {' '.join(kind.value for kind in AnomalyKind)})", make=_faulty_oracle
)
SIMULATED: Mapping[str, Form] = {
    "oracle": Form(usage="oracle", make=_oracle),
    **{f"{_FAULTY}{kind.value}": _FAULTY_FORM for kind in AnomalyKind},
    "random": Form(usage="random", make=_wanderer),
}
"""Forms to add to the factory's."""
