"""Which changes of the code invalidate stored rows, and what a result says of the machine."""

import pytest
import torch

from kinebench_drake.environment.sources import reachable_sources
from kinebench_drake.models.perception.inference import supports_bfloat16
from kinebench_drake.results import provenance
from kinebench_drake.results.provenance import MEASURING, NOT_MEASURING, sources

EVALUATORS = ("evaluation.score", "evaluation.audit", "evaluation.episode")
"""Modules that measure a sample; all that shapes a row is imported below them."""


def package_names(paths):
    return {path.relative_to(provenance._TOP).as_posix() for path in paths}


def test_every_module_that_a_measurement_imports_is_listed():
    reachable = package_names(reachable_sources(*(f"kinebench_drake.{name}" for name in EVALUATORS)))
    measuring = package_names(sources(MEASURING) - sources(NOT_MEASURING))
    assert reachable - package_names(sources(MEASURING + NOT_MEASURING)) == set()
    assert measuring - reachable == set(), "no measurement uses these: name them in NOT_MEASURING"


@pytest.mark.parametrize("pattern", [*MEASURING, *NOT_MEASURING])
def test_every_pattern_matches_a_source(pattern):
    assert sources((pattern,))


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of some sources, with grounding behind a link as in the repository."""
    names = ("kinematics/ik.py", "grounding/registration/fit.py", "cli/score.py", "report/page.py", "io/figure.py")
    for name in names:
        path = tmp_path / "package" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    (tmp_path / "package" / "grounding").rename(tmp_path / "grounding")
    (tmp_path / "package" / "grounding").symlink_to(tmp_path / "grounding")
    monkeypatch.setattr(provenance, "_TOP", tmp_path / "package")
    return tmp_path / "package"


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        *(("kinematics/ik.py", True), ("grounding/registration/fit.py", True), ("kinematics/new.py", True)),
        *(("cli/score.py", False), ("report/page.py", False), ("io/figure.py", False), ("kinematics/x.pyc", False)),
    ],
)
def test_only_changes_of_measuring_code_change_the_hash(package, name, counts):
    before = provenance.code_hash.__wrapped__()
    assert provenance.code_hash.__wrapped__() == before
    (package / name).write_text("changed")
    assert (provenance.code_hash.__wrapped__() != before) is counts


def test_the_host_tells_whether_the_networks_compute_in_bfloat16():
    assert provenance.host()["bfloat16"] is supports_bfloat16(torch.device("cpu"))
