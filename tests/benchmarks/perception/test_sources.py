"""Source files that a module reaches through its imports."""

import subprocess
import sys
from pathlib import Path

import pytest

import kinebench_drake
from benchmarks.perception import sources
from benchmarks.perception.sources import trace_sources

TOP = Path(kinebench_drake.__file__).parent


def names(*modules):
    return sorted(source.path.relative_to(TOP).as_posix() for source in trace_sources(*modules))


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of the same name in another folder; returns a function that writes a module of it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sources, "_TOP", tmp_path)
    monkeypatch.setattr(sys.modules[__name__], "TOP", tmp_path)

    def write(name, text=""):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    write("__init__.py", "def f():\n    from kinebench_drake import unrelated\n")
    write("unrelated.py")
    return write


def test_all_forms_of_import_are_followed(package):
    package("a.py", "import numpy\nfrom kinebench_drake.b import x\n\ndef f():\n    import kinebench_drake.c.deep\n")
    package(
        "b.py", "from kinebench_drake import d, __version__\nif TYPE_CHECKING:\n    from kinebench_drake.e import E\n"
    )
    package("c/__init__.py", "from kinebench_drake.c import other\n")
    for name in ("c/deep.py", "c/other.py", "d.py", "e.py"):
        package(name, "from kinebench_drake import a\n")
    assert names("kinebench_drake.a") == ["__init__.py", "a.py", "b.py", "c/__init__.py", "c/deep.py", "c/other.py",
                                          "d.py", "e.py"]  # fmt: skip
    assert names("kinebench_drake.unrelated") == ["__init__.py", "unrelated.py"]
    assert names("kinebench_drake.unrelated", "kinebench_drake.a") == sorted(
        [*names("kinebench_drake.a"), "unrelated.py"]
    )


@pytest.mark.parametrize("name", ["kinebench_drake.nothing", "numpy", "kinebench_drake.a.x"])
def test_a_missing_module_is_refused(package, name):
    package("a.py")
    with pytest.raises(ValueError, match=name):
        trace_sources(name)


@pytest.mark.parametrize("module", ["kinebench_drake.grounding.pipeline", "kinebench_drake.report.page"])
def test_every_module_that_an_import_loads_is_reached(module):
    code = f"import sys, {module}\nprint(*(m for m in sys.modules if m.split('.')[0] == 'kinebench_drake'), sep='\\n')"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert len(loaded) > 10
    stems = {name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for name in names(module)}
    assert {m.partition(".")[2] or "__init__" for m in loaded} <= stems
