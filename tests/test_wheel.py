"""The wheel: whole, small, and described as its page will show it."""

import importlib.metadata
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGE = "kinebench_drake"
MAX_BYTES = 60_000_000
LEFT_OUT = ("__pycache__", ".pyc")

pytest.importorskip("setuptools", minversion="77.0.3")


def sources() -> Iterator[str]:
    """Every file of the package's folders, as a path in the wheel."""
    for top in (PACKAGE, "grounding", "models", "suites"):
        for path in (REPOSITORY / top).rglob("*"):
            inside = path.relative_to(REPOSITORY).as_posix()
            if path.is_file() and path.resolve() == path and not any(part in inside for part in LEFT_OUT):
                yield inside if top == PACKAGE else f"{PACKAGE}/{inside}"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Built without isolation (no network), from a copy: a build leaves folders behind."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "source"
    copy.mkdir()
    for name in (PACKAGE, "grounding", "models", "suites"):
        shutil.copytree(REPOSITORY / name, copy / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, copy)
    code = "import sys; from setuptools.build_meta import build_wheel; print(build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, str(folder)], cwd=copy, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return zipfile.ZipFile(folder / done.stdout.splitlines()[-1])


def test_the_wheel_holds_every_file_of_the_package(wheel: zipfile.ZipFile) -> None:
    """Modules, weights, calibrations, the suites' data, templates, native.sh and py.typed."""
    inside = {name for name in wheel.namelist() if not name.split("/")[0].endswith(".dist-info")}
    assert sorted(inside) == sorted(sources())
    for name in ("py.typed", "environment/native.sh", "models/perception/gripper.safetensors", "report/page.html.j2"):
        assert f"{PACKAGE}/{name}" in inside


def test_the_wheel_is_within_its_size_limit(wheel: zipfile.ZipFile) -> None:
    assert wheel.filename
    assert 1_000_000 < Path(wheel.filename).stat().st_size < MAX_BYTES


def test_the_wheel_metadata_are_complete(wheel: zipfile.ZipFile) -> None:
    (name,) = (name for name in wheel.namelist() if name.endswith("/METADATA"))
    (licence,) = (name for name in wheel.namelist() if name.endswith("/licenses/LICENSE"))
    assert wheel.read(licence) == (REPOSITORY / "LICENSE").read_bytes()
    about = importlib.metadata.PathDistribution(zipfile.Path(wheel, f"{name.split('/')[0]}/")).metadata
    assert (about["Name"], about["License-Expression"]) == ("kinebench-drake", "MIT")
    assert about["Requires-Python"] == "<3.13,>=3.11"
    assert about["Description-Content-Type"] == "text/markdown"
    assert "opencv-python-headless>=4.10" in about.get_all("Requires-Dist", [])
    (points,) = (name for name in wheel.namelist() if name.endswith("/entry_points.txt"))
    assert "kinebench-drake = kinebench_drake.cli:main" in wheel.read(points).decode()
