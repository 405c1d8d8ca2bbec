"""TODO."""

from collections.abc import Mapping

from pydantic import Field

from kinebench_drake.suites.faults.fault import FaultGrade, choose
from kinebench_drake.suites.worldmodels.factory import SpecForm
from kinebench_drake.suites.worldmodels.oracle import OracleModel
from kinebench_drake.suites.worldmodels.random_policy import RandomPolicyModel
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.types import AnomalyKind

_FAULTY = "oracle+"


class OracleOptions(Options):
    """Options of the oracle."""

    told: bool = Field(False, description="tell the true track of each clip, so that nothing is read from pixels")


def _oracle(spec: Spec) -> OracleModel:
    spec.bare()
    options = spec.read(OracleOptions)
    return OracleModel(name=options.name or ("oracle, true track" if options.told else "oracle"), tells=options.told)


def _faulty_oracle(spec: Spec) -> OracleModel:
    grade = _grade(spec)
    return OracleModel(name=spec.read(Options).name or f"{_FAULTY}{grade.label}", fault=grade)


def _grade(spec: Spec) -> FaultGrade:
    """The one fault of a spec such as "oracle+teleport:0.15".

    Raises:
        UsageError: no size is given, or several.
    """
    grades = choose([AnomalyKind(spec.kind.removeprefix(_FAULTY))], spec.rest)
    if len(grades) > len({grade.form for grade in grades}):
        raise spec.unusable(f"expected one size, such as {spec.kind}:{grades[0].size:g}")
    return grades[0]


def _wanderer(spec: Spec) -> RandomPolicyModel:
    spec.bare()
    return RandomPolicyModel(name=spec.read(Options).name or "random")


_FAULTY_FORM = SpecForm(
    usage=f"{_FAULTY}KIND:SIZE (KIND: {' '.join(kind.value for kind in AnomalyKind)})", make=_faulty_oracle
)


SIMULATED: Mapping[str, SpecForm] = {
    "oracle": SpecForm(usage="oracle", make=_oracle),
    **{f"{_FAULTY}{kind.value}": _FAULTY_FORM for kind in AnomalyKind},
    "random": SpecForm(usage="random", make=_wanderer),
}
"""Forms to add to the factory's."""
