import subprocess

import pytest

from benchmarks.structure import StructureCounts, count_revision, structure_table
from kinebench_drake.errors import UsageError


@pytest.fixture
def repository(tmp_path):
    def commit(files):
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)
        author = ("-c", "user.name=a", "-c", "user.email=a@b")
        for command in (["add", "-A"], [*author, "commit", "-qm", "x"]):
            subprocess.run(["git", "-C", str(tmp_path), *command], check=True)
        return tmp_path

    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    return commit


def test_files_and_lines_of_a_revision_are_counted_without_a_checkout(repository):
    files = {"kinebench_drake/a.py": "class A:\n    pass\n", "grounding/a.py": "class A:\n    found = 1\n"}
    root = repository({**files, "tests/test_a.py": "\n", "benchmarks/b.py": "\n\n", "README.md": "two words"})
    (root / "kinebench_drake" / "grounding").symlink_to("../grounding")
    (root / "kinebench_drake" / "link.py").symlink_to("a.py")
    repository({"grounding/b.py": "_A_M: Final = (0.1, 2)\nNAME, ON, size = 'x', True, 3\ndef f(told): ...\n"})
    first, second = (count_revision(root, revision) for revision in ("HEAD~1", "HEAD"))
    assert first == StructureCounts(
        shipped_files=2, shipped_lines=4, benchmark_files=1, benchmark_lines=2, test_files=1, test_lines=1,
        package_top_files=1, repeated_classes=1, repeated_modules=1, banned_bindings=1, constants=0, docs_words=2,
    )  # fmt: skip
    assert (second.shipped_files, second.banned_bindings, second.constants) == (3, 2, 1)
    assert "| shipped Python files | 2 | 3 |" in structure_table([("HEAD~1", first), ("HEAD", second)])


def test_an_unknown_revision_is_refused(repository):
    with pytest.raises(UsageError, match="git ls-tree: "):
        count_revision(repository({"a.py": ""}), "no-such-revision")
