"""What the sources never do: load pickles, run what an input says, measure time by a clock that jumps."""

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = sorted(
    path
    for folder in ("kinebench_drake", "grounding", "models", "suites", "examples")
    for path in (ROOT / folder).rglob("*.py")
    if path.resolve() == path
)


@cache
def syntax(path: Path) -> ast.Module:
    """The syntax tree of a source."""
    return ast.parse(path.read_text())


def dotted(node: ast.expr) -> str:
    """The name that is called, such as `os.system`."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


def literal(call: ast.Call, name: str) -> object:
    """The constant given for a keyword; None where there is none."""
    found = next((k.value for k in call.keywords if k.arg == name), None)
    return found.value if isinstance(found, ast.Constant) else None


FORBIDDEN = {
    *("eval", "exec", "compile", "__import__", "os.system", "os.popen", "os.execv", "os.execvp", "os.spawnl"),
    *("subprocess.getoutput", "subprocess.getstatusoutput", "torch.load", "torch.save", "torch.jit.load"),
    *(
        "joblib.load",
        "yaml.load",
        "yaml.unsafe_load",
        "marshal.loads",
        "marshal.load",
        "np.fromregex",
        "tempfile.mktemp",
    ),
    *("zipfile.ZipFile.extractall", "shutil.unpack_archive", "pandas.read_pickle", "pd.read_pickle"),
}
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "yaml"}


def faults(tree: ast.AST):
    """What a module does that may run or load what an input says."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (f"imports {a.name}" for a in node.names if a.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            yield f"imports {node.module}"
        elif isinstance(node, ast.Call):
            name = dotted(node.func)
            if name in FORBIDDEN or name.rsplit(".", 1)[-1] == "extractall":
                yield f"calls {name}"
            if literal(node, "shell"):
                yield f"calls {name} with a shell"
            if literal(node, "allow_pickle") and not name.startswith("np.lib.format.write_array"):
                yield f"calls {name} with allow_pickle"


@pytest.mark.parametrize(
    "text",
    [
        *("import pickle", "from pickle import loads", "eval('1')", "os.system('ls')", "torch.load('a.pt')"),
        *("subprocess.run('ls', shell=True)", "np.load('a', allow_pickle=True)", "archive.extractall()"),
    ],
)
def test_unsafe_calls_are_detected(text):
    assert list(faults(ast.parse(text)))


def test_no_source_loads_pickles_or_executes_input():
    found = {path.relative_to(ROOT).as_posix(): list(faults(syntax(path))) for path in SOURCES}
    assert {name: told for name, told in found.items() if told} == {}


def test_weights_are_safetensors_only():
    kept = [
        p.name for p in (ROOT / "models").rglob("*") if p.suffix in (".pt", ".pth", ".pkl", ".ckpt", ".bin", ".npy")
    ]
    assert kept == []
    assert list((ROOT / "models").rglob("*.safetensors"))


def test_durations_are_measured_by_monotonic_clocks():
    """No source measures with the clock on the wall."""
    for path in SOURCES:
        called = {dotted(node.func) for node in ast.walk(syntax(path)) if isinstance(node, ast.Call)}
        assert "time.time" not in called, path
