"""Names in backticks in docstrings exist: as a module, class, function, constant, parameter, field or string."""

import ast
import itertools
import re
import subprocess
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TOPS = ("kinebench_drake", "grounding", "models", "suites", "benchmarks", "training")
TREES = {
    path: ast.parse((ROOT / path).read_text())
    for path in subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True).stdout.split()
    if path.startswith(TOPS)
}
FOREIGN = {
    *("PoseBackendRequest", "RecordEpisode", "max_rollouts", "video_resize", "rate_limiting", "panda_gripper"),
    *("robotiq_gripper_85", "LICENSE", "traj_K", "X_AB", "column_0", "column_1", "_r1", "_r2", "ID_k1", "ID_k2"),
    *("end_left", "end_right", "tip_left", "tip_right", "manipulability_residual"),
    *("MUJOCO_GL", "LD_LIBRARY_PATH", "NAME_KIND", "NAME_bound"),
}
"""Names of other programs, and numbered or framed examples."""


def docstring_nodes(tree):
    statements = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
    return [v for v in statements if isinstance(v, ast.Constant) and isinstance(v.value, str)]


def names_of(path, tree):
    """All names that occur in the code of a module, and the words of its strings."""
    docstrings = set(map(id, docstring_nodes(tree)))
    names = {*Path(path).with_suffix("").parts, "py"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            names.update(re.findall(r"\w+", node.value))
        for field in ("id", "attr", "arg", "name", "asname"):
            names.update(str(getattr(node, field, "")).split("."))
    return names


NAMES = {path: names_of(path, tree) for path, tree in TREES.items()}
DEFINED = set.union(*NAMES.values()) | FOREIGN
OWNERS = defaultdict(set)
"""Names in the modules of each name, in those that define a class of that name, and in packages of that name."""
for module, tree in TREES.items():
    for owner in (Path(module).stem, *(node.name for node in tree.body if isinstance(node, ast.ClassDef))):
        OWNERS[owner] |= NAMES[module]
    for package, member in itertools.pairwise(Path(module).with_suffix("").parts):
        OWNERS[package].add(member)
FILE_ENDINGS = {"csv", "html", "json", "jsonl", "parquet", "safetensors", "txt"}


def quoted(tree):
    """Names in backticks, and constants without."""
    pattern = r"`([A-Za-z_][\w.]*)(?:\(\))?`|\b([A-Z]{2,}(?:_[A-Z]+)+)\b"
    return [a or b for node in docstring_nodes(tree) for a, b in re.findall(pattern, node.value)]


@pytest.mark.parametrize("path", TREES)
def test_names_in_docstrings_exist(path):
    assert [name for name in quoted(TREES[path]) if not DEFINED.issuperset(name.split("."))] == []


@pytest.mark.parametrize("path", TREES)
def test_members_in_docstrings_belong_to_their_module_or_class(path):
    pairs = [name.rsplit(".", 2)[-2:] for name in quoted(TREES[path]) if "." in name]
    parameters = {node.arg for node in ast.walk(TREES[path]) if isinstance(node, ast.arg)}
    wrong = [(o, m) for o, m in pairs if o not in parameters and m not in OWNERS.get(o, {m}) | FILE_ENDINGS]
    assert wrong == []
