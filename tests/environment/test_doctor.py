import importlib.metadata
import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from kinebench_drake.environment import doctor
from kinebench_drake.environment.doctor import Check
from kinebench_drake.suites.vulkan import check_vulkan


def test_render_shows_every_check_and_the_fix_of_failures_only() -> None:
    text = doctor.render(
        [Check("Drake", True, "1.51.1", "mend Drake"), Check("Vulkan device", False, "no device", "mend Vulkan")]
    )
    assert text.splitlines() == [
        "ok    Drake          1.51.1",
        "FAIL  Vulkan device  no device",
        "                     fix: mend Vulkan",
        "1 of 2 checks failed.",
    ]

    assert doctor.render([Check("Drake", True, "1.51.1", "")]).endswith("All 1 checks passed.")


Outcome = Callable[[str], Check]


@pytest.fixture
def outcome(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Outcome:
    """Runs the checks, whose processes answer at once, and returns that of a name."""
    monkeypatch.setattr(doctor, "probe", lambda code: "1.2.3")
    monkeypatch.setattr(doctor, "WEIGHTS", tmp_path)
    return lambda name: {check.name: check for check in doctor.run_checks()}[name]


def test_a_check_that_raises_fails_with_the_first_line_of_its_error() -> None:
    def look() -> str:
        raise ImportError("libEGL.so.1: cannot open\nmore")

    assert doctor.check("Open3D", look, "again") == Check("Open3D", False, "libEGL.so.1: cannot open", "again")


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "crashed with signal 11"),
        ("raise ValueError('no such device')", "ValueError: no such device"),
        ("import sys; sys.exit(3)", "exit status 3"),
    ],
)
def test_a_crash_of_the_probed_process_is_a_failed_check_with_its_reason(code: str, reason: str) -> None:
    check = doctor.check("probe", lambda: doctor.probe(code), "")
    assert (check.ok, check.detail) == (False, reason)


def test_a_probe_without_an_answer_fails_after_its_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "PROBE_TIMEOUT_S", 0.2)
    check = doctor.check("probe", lambda: doctor.probe("import signal; signal.pause()"), "")
    assert (check.ok, "no answer" in check.detail) == (False, True)


def test_probe_returns_the_last_line_and_ignores_files_of_the_current_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "click.py").write_text("raise RuntimeError('shadowed')")
    monkeypatch.chdir(tmp_path)
    assert doctor.probe("import click; print('noise'); print('1.2.3')") == "1.2.3"


@pytest.mark.parametrize(
    ("owners", "ok"),
    [
        ({"opencv-python": "cv2/cv2.so", "opencv-python-headless": "cv2/cv2.so"}, False),
        ({"opencv-python": "opencv_python.dist-info/RECORD", "opencv-python-headless": "cv2/cv2.so"}, True),  # the shim
        ({"opencv-python": "cv2/cv2.so"}, False),
    ],
)
def test_cv2_passes_only_if_the_headless_distribution_alone_owns_it(
    monkeypatch: pytest.MonkeyPatch, outcome: Outcome, owners: dict[str, str], ok: bool
) -> None:
    def files(name: str) -> list[Path]:
        if name not in owners:
            raise importlib.metadata.PackageNotFoundError(name)
        return [Path(owners[name])]

    monkeypatch.setattr(importlib.metadata, "files", files)
    assert outcome("cv2").ok is ok
    assert ok or f"cv2 comes from {' and '.join(owners)}" in outcome("cv2").detail


def test_the_weights_check_counts_the_parameters_of_each_network(outcome: Outcome, tmp_path: Path) -> None:
    assert not outcome("perception weights").ok
    save_file({"a": np.zeros((1000, 1200), np.float32), "b": np.zeros(1, np.float32)}, tmp_path / "net.safetensors")
    assert outcome("perception weights").detail == "net (1.2 M parameters)"


@pytest.mark.parametrize("content", [b"", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"])
def test_a_weights_file_that_is_empty_or_a_git_lfs_pointer_is_named(
    outcome: Outcome, tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "net.safetensors").write_bytes(content)
    check = outcome("perception weights")
    assert not check.ok
    assert "net.safetensors cannot be read" in check.detail


def test_an_unwritable_cache_folder_fails_and_the_check_leaves_no_file(
    monkeypatch: pytest.MonkeyPatch, outcome: Outcome, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert not outcome("cache folder").ok
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert outcome("cache folder").ok
    assert list((tmp_path / "kinebench_drake").iterdir()) == []


@pytest.mark.slow
@pytest.mark.sapien
def test_all_checks_pass_after_the_set_up() -> None:
    checks = [*doctor.run_checks(), check_vulkan()]
    assert len({check.name for check in checks}) == len(checks) == 8
    assert all(check.detail and check.fix for check in checks)
    failed = [f"{check.name}: {check.detail}" for check in checks if not check.ok]
    assert failed == []
