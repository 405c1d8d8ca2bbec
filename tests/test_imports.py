"""The architecture: imports follow the layers, importing the package is cheap, every package is shipped."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = "kinebench_drake"

LEAF = {
    "__init__",
    "errors",
    "geometry",
    "camera",
    "named_cameras",
    "track",
    "anomaly",
    "violation",
    "segments",
    "stats",
} | {
    "plugin",
    "clip_timing",
    "view_name",
}
IO = LEAF | {"io", "environment"}
KINEMATICS = IO | {"models", "kinematics"}
MAIN = KINEMATICS | {"metrics", "formats", "results", "executors", "grounding", "report", "runs"}
MAY_IMPORT = {
    **dict.fromkeys(LEAF, LEAF),
    "__init__": LEAF | {"api"},
    "io": IO,
    "environment": IO,
    "results": IO,
    "formats": IO | {"results"},
    "executors": IO | {"results"},
    "models": IO,
    "kinematics": KINEMATICS,
    "metrics": KINEMATICS | {"results"},
    "grounding": KINEMATICS | {"formats", "executors"},
    "report": KINEMATICS | {"metrics", "formats", "results", "executors"},
    "runs": MAIN,
    "api": MAIN,
    "integrations": MAIN | {"api"},
    "cli": MAIN | {"api", "integrations"},
    "__main__": {"cli"},
    "suites": MAIN | {"api"},
    "suites.commands": MAIN | {"api", "cli", "suites"},
}
"""What each folder may import besides itself; `suites` is loaded by name, through `runs.benchmark_registry`."""
OF_THE_BENCHMARK = {"sapien", "mani_skill", "gymnasium", "httpx", "tenacity"}
"""Packages that only `suites` imports."""
NOT_SHIPPED = {"training", "benchmarks"}
"""Developers' tools at the top; nothing of the package imports them."""


def modules():
    folders = [ROOT / PACKAGE, *(ROOT / name for name in ("grounding", "models", "suites"))]
    return sorted({p for folder in folders for p in folder.rglob("*.py") if not linked(p)})


def linked(path):
    return path.resolve() != path


def part_of(path):
    first, *rest = path.relative_to(ROOT).parts
    if first == PACKAGE:
        return rest[0].removesuffix(".py")
    return "suites.commands" if [first, rest[0]] == ["suites", "commands"] else first


def imports_of(path):
    """Full names of the modules that a module imports anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module.split(".")[0] not in NOT_SHIPPED, f"{path}: imports a developer's tool"
            names = [node.module] if node.module != PACKAGE else [f"{PACKAGE}.{a.name}" for a in node.names]
        elif isinstance(node, ast.Import):
            names = [a.name for a in node.names]
        else:
            continue
        yield from names


def imported_parts(path):
    """First names below the package that a module imports anywhere in it."""
    for name in imports_of(path):
        if name.split(".")[0] == PACKAGE:
            part = name.split(".")[1] if "." in name else "__init__"
            yield part if part != "__version__" else "__init__"


@pytest.mark.parametrize("path", modules(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_follow_the_layers(path):
    part = part_of(path)
    for target in set(imported_parts(path)) - {part}:
        assert target in MAY_IMPORT[part], f"{part} may not import {target}"
    if not part.startswith("suites"):
        foreign = {name.split(".")[0] for name in imports_of(path)} & OF_THE_BENCHMARK
        assert not foreign, f"{part} imports {foreign}, which only suites may"


def test_imports_inside_functions_are_detected(tmp_path):
    path = tmp_path / "a.py"
    path.write_text("def f():\n    from kinebench_drake.suites.x import y\n    import kinebench_drake.cli\n")
    assert set(imported_parts(path)) == {"suites", "cli"}


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts if parts[0] == PACKAGE else (PACKAGE, *parts)).removesuffix(".__init__")


def module_level_imports(tree, names):
    """Those of `names`, modules, that a module imports outside its functions, also for type checking alone."""
    nodes = list(tree.body)
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.ImportFrom):
            members = [f"{node.module}.{a.name}" for a in node.names]
            yield from {member if member in names else node.module for member in members} & names
        elif isinstance(node, ast.Import):
            yield from {a.name for a in node.names} & names
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            nodes.extend(ast.iter_child_nodes(node))


def import_cycles(sources):
    """Cycles of imports among modules, from their source texts by name."""
    imports = {
        name: set(module_level_imports(ast.parse(text), sources.keys())) - {name} for name, text in sources.items()
    }
    done = set()
    cycles = []

    def visit(name, path):
        if name in path:
            cycles.append([*path[path.index(name) :], name])
        elif name not in done:
            for target in sorted(imports[name]):
                visit(target, [*path, name])
            done.add(name)

    for name in sorted(imports):
        visit(name, [])
    return cycles


def test_modules_have_no_import_cycle():
    assert import_cycles({module_name(path): path.read_text() for path in modules()}) == []


def test_import_cycles_are_detected():
    sources = {
        "a": "if TYPE_CHECKING:\n    from b import f",
        "b": "class B:\n    import c",
        "c": "import a",
        "d": "def f():\n    import a\nfrom a import x",
    }
    assert import_cycles(sources) == [["a", "b", "c", "a"]]


def modules_loaded_by(statement):
    code = f"import sys\n{statement}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.split())


def loaded_by(statement):
    return {name.split(".")[0] for name in modules_loaded_by(statement)}


HEAVY = {"torch", "open3d", "sapien", "mani_skill", "pydrake", "matplotlib", "cv2", "diffusers", "transformers"}


def test_importing_the_package_loads_nothing_heavy():
    assert not loaded_by("import kinebench_drake") & (HEAVY | {"numpy", "click"})


@pytest.mark.parametrize(
    "module",
    [
        *(
            "api",
            "runs.score",
            "runs.audit",
            "formats.videos.find",
            "results.store",
            "runs.evaluator",
            "runs.benchmark_registry",
            "suites.entry",
        ),
        *("report", "runs.merge", "cli.score", "cli.progress"),
        *("suites.start", "suites.worldmodels.factory"),
    ],
)
def test_importing_modules_of_a_run_loads_nothing_heavy(module):
    assert not loaded_by(f"import kinebench_drake.{module}") & HEAVY


WORK = """
from pathlib import Path

import numpy as np

from kinebench_drake.cli import cli
from kinebench_drake.runs.config import ScoreConfig
from kinebench_drake.runs.score import score_videos
from tests.fakes.resources import FakeResources

folder = Path({folder!r})
config = ScoreConfig(source=folder / "a.mp4", out=folder / "scored", make_resources=FakeResources, replays=None)
[row] = score_videos(config).rows
assert row.status.value == "ok", row
q = [0.0, 0.3, 0.0, -2.0, 0.0, 2.0, 0.8]
times = np.arange(12) / 10
np.savez(folder / "track.npz", t_s=times, q=q + 0.05 * np.sin(times)[:, None])
audit = ["audit", str(folder / "track.npz"), "--out", str(folder / "audited"), "--replays", "0"]
assert cli.main(audit, standalone_mode=False) == 0
"""


def test_scoring_and_auditing_load_nothing_of_the_benchmark(film, tmp_path):
    film("a.mp4")
    loaded = modules_loaded_by(WORK.format(folder=str(tmp_path)))
    assert "kinebench_drake.metrics.judge" in loaded
    assert not {name for name in loaded if name.startswith(f"{PACKAGE}.suites")}
    assert not {name.split(".")[0] for name in loaded} & OF_THE_BENCHMARK


def test_help_loads_no_numerical_library():
    code = "from kinebench_drake.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass"
    assert not loaded_by(code) & (HEAVY | {"numpy", "scipy", "av", "rich", "pydantic"})


def test_every_package_and_data_file_is_shipped():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = {PACKAGE}
    for path in modules():
        first, *rest = path.relative_to(ROOT).parent.parts
        found.add(".".join([PACKAGE, *([] if first == PACKAGE else [first]), *rest]))
    assert sorted(settings["packages"]) == sorted(found)
    for template in (ROOT / PACKAGE / "report").glob("*.j2"):
        assert any(template.match(pattern) for pattern in settings["package-data"][f"{PACKAGE}.report"])


def test_top_level_packages_are_relative_links_within_the_package():
    for name in ("grounding", "models", "suites"):
        link = ROOT / PACKAGE / name
        assert link.is_symlink()
        assert not link.readlink().is_absolute()
        assert link.resolve() == (ROOT / name).resolve()
