"""Which changes of the code invalidate stored rows, and what a result says of the machine."""

import pytest
import torch

from kinebench_drake.environment import sources
from kinebench_drake.results import provenance
from kinebench_drake.results.provenance import RUNS, code_hash

ENTRY = "kinebench_drake.runs.score"
SOURCES = {
    "__init__.py": "",
    "runs/__init__.py": "",
    "runs/score.py": "import kinebench_drake.kinematics.ik\nimport kinebench_drake.report.page\n",
    "kinematics/__init__.py": "",
    "kinematics/ik.py": """'Solve.'
LIMIT = 3
'Bound.'
def f():
    'Solve it.'
    return 1  # at once
""",
    "kinematics/unused.py": "",
    "report/__init__.py": "",
    "report/page.py": "",
}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of the same name in another folder; returns the hash of its code after a file was changed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sources, "_TOP", tmp_path / "package")
    for name, text in SOURCES.items():
        path = tmp_path / "package" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def hash_with(name=None, text=None):
        if name is not None:
            (tmp_path / "package" / name).write_text(text)
        return code_hash.__wrapped__(ENTRY)

    return hash_with


@pytest.mark.parametrize(
    ("name", "old", "new", "counts"),
    [
        ("kinematics/ik.py", "LIMIT = 3", "LIMIT = 4", True),
        ("kinematics/ik.py", "Solve it", "Solve it well", False),
        ("kinematics/ik.py", "# at once", "# immediately", False),
        ("kinematics/ik.py", "Bound.", "Upper bound.", False),
        ("kinematics/__init__.py", "", "import os", True),
        ("kinematics/unused.py", "", "LIMIT = 4", False),
        ("report/page.py", "", "WIDTH = 3", False),
    ],
)
def test_the_code_hash_changes_with_code_and_not_with_comments_or_docstrings(package, name, old, new, counts):
    before = package()
    assert package() == before
    text = SOURCES[name].replace(old, new) if old else new
    assert (package(name, text) != before) is counts


def test_the_code_hash_changes_with_a_new_import(package):
    before = package()
    assert package("runs/score.py", SOURCES["runs/score.py"] + "import kinebench_drake.kinematics.unused\n") != before


def test_the_code_hash_is_the_same_with_a_damaged_cache(package, tmp_path):
    before = package()
    (tmp_path / "cache" / "kinebench_drake" / "sources.json").write_text('{"a": 3}')
    assert package() == before


def test_each_run_kind_has_its_own_code_hash():
    assert len({code_hash(run) for run in RUNS}) == len(RUNS)
    names = {source.name for source in provenance.trace_sources("kinebench_drake.runs.audit")}
    assert "kinebench_drake.kinematics.ik" in names
    assert "kinebench_drake.grounding.pipeline" not in {
        source.name for source in provenance.trace_sources("kinebench_drake.metrics.judge")
    }


def test_the_host_record_states_whether_networks_compute_in_bfloat16():
    assert provenance.host()["bfloat16"] is torch.cpu._is_avx512_bf16_supported()
