"""Which changes of the code invalidate stored rows, and what a result says of the machine."""

import pytest
import torch

from kinebench_drake.plugin import BENCHMARK
from kinebench_drake.results import provenance
from kinebench_drake.results.provenance import RUNS, code_hash

ENTRY = "kinebench_drake.runs.score"
SOURCES = {
    "__init__.py": "",
    "geometry.py": "UNIT = 1",
    "stats.py": "",
    "runs/score.py": "import kinebench_drake.kinematics.ik",
    "kinematics/ik.py": "LIMIT = 3",
    "kinematics/deep/joints.py": "",
    "report/page.py": "",
    "suites/entry.py": "",
}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package in another folder, of which kinematics is a link; returns the hash of its code after a change."""
    monkeypatch.setattr(provenance, "_TOP", tmp_path / "package")
    for name, text in SOURCES.items():
        folder = tmp_path if name.startswith("kinematics/") else tmp_path / "package"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (tmp_path / "package" / "kinematics").symlink_to("../kinematics")

    def hash_with(name=None, entry=ENTRY):
        if name is not None:
            (tmp_path / "package" / name).write_text("LIMIT = 4")
        return code_hash.__wrapped__(entry)

    return hash_with


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        *[(name, True) for name in ("geometry.py", "runs/score.py", "kinematics/ik.py", "kinematics/deep/joints.py")],
        *[(name, False) for name in ("stats.py", "report/page.py", "suites/entry.py", "kinematics/notes.md")],
        ("kinematics/new.py", True),
    ],
)
def test_the_code_hash_changes_with_sources_that_measure(package, name, counts):
    before = package()
    assert package() == before
    assert (package(name) != before) is counts


def test_the_code_hash_of_episodes_depends_on_the_benchmark(package):
    before = package(entry=BENCHMARK)
    assert package("suites/entry.py", BENCHMARK) != before
    assert code_hash(*RUNS) == code_hash(BENCHMARK) != code_hash(ENTRY)


def test_the_host_record_states_whether_networks_compute_in_bfloat16():
    assert provenance.host()["bfloat16"] is torch.cpu._is_avx512_bf16_supported()
