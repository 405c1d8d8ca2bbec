import importlib.metadata
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from kinebench_drake.environment import doctor
from kinebench_drake.environment.doctor import Check


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


def test_render_of_passed_checks_ends_with_their_number() -> None:
    assert doctor.render([Check("Drake", True, "1.51.1", "")]).endswith("All 1 checks passed.")


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
    check = doctor.check("probe", lambda: doctor.probe("import time; time.sleep(60)"), "")
    assert (check.ok, "no answer" in check.detail) == (False, True)


def test_probe_ignores_files_of_the_current_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "click.py").write_text("raise RuntimeError('shadowed')")
    monkeypatch.chdir(tmp_path)
    assert doctor.probe("import click; print('real')") == "real"


def test_probe_returns_the_last_line() -> None:
    assert doctor.probe("print('noise'); print('1.2.3')") == "1.2.3"


@pytest.mark.parametrize(
    ("version", "ok"), [((3, 10, 9), False), ((3, 11, 0), True), ((3, 12, 9), True), ((3, 13, 0), False)]
)
def test_only_python_3_11_and_3_12_pass(
    monkeypatch: pytest.MonkeyPatch, version: tuple[int, int, int], ok: bool
) -> None:
    monkeypatch.setattr(sys, "version_info", version)
    assert doctor.check("Python", doctor._python, "").ok is ok


def owned_by(monkeypatch: pytest.MonkeyPatch, owners: dict[str, list[str]]) -> None:
    def files(name: str) -> list[Path]:
        if name not in owners:
            raise importlib.metadata.PackageNotFoundError(name)
        return [Path(file) for file in owners[name]]

    monkeypatch.setattr(importlib.metadata, "files", files)


def test_cv2_installed_by_two_distributions_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    owned_by(monkeypatch, {"opencv-python": ["cv2/cv2.so"], "opencv-python-headless": ["cv2/cv2.so"]})
    check = doctor.check("cv2", doctor._cv2, "")
    assert not check.ok
    assert "opencv-python and opencv-python-headless" in check.detail


def test_the_opencv_python_shim_does_not_count_as_owner_of_cv2(monkeypatch: pytest.MonkeyPatch) -> None:
    owned_by(
        monkeypatch, {"opencv-python": ["opencv_python.dist-info/RECORD"], "opencv-python-headless": ["cv2/cv2.so"]}
    )
    assert doctor.check("cv2", doctor._cv2, "").ok


def test_cv2_of_the_full_opencv_python_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    owned_by(monkeypatch, {"opencv-python": ["cv2/cv2.so"]})
    assert not doctor.check("cv2", doctor._cv2, "").ok


def test_the_weights_check_counts_the_parameters_of_each_network(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(doctor, "WEIGHTS", tmp_path)
    save_file({"a": np.zeros((1000, 1200), np.float32), "b": np.zeros(1, np.float32)}, tmp_path / "net.safetensors")
    assert doctor._weights() == "net (1.2 M parameters)"


@pytest.mark.parametrize("content", [b"", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"])
def test_a_weights_file_that_is_empty_or_a_git_lfs_pointer_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: bytes
) -> None:
    monkeypatch.setattr(doctor, "WEIGHTS", tmp_path)
    (tmp_path / "net.safetensors").write_bytes(content)
    check = doctor.check("weights", doctor._weights, "")
    assert not check.ok
    assert "net.safetensors cannot be read" in check.detail


def test_missing_weights_fail(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(doctor, "WEIGHTS", tmp_path)
    assert not doctor.check("weights", doctor._weights, "").ok


def test_an_unwritable_cache_folder_fails_and_the_check_leaves_no_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert not doctor.check("cache", doctor._cache_folder, "").ok
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert doctor.check("cache", doctor._cache_folder, "").ok
    assert list((tmp_path / "kinebench_drake").iterdir()) == []


def test_a_missing_panda_urdf_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor.check("Panda URDF", doctor._panda, "").ok
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    check = doctor.check("Panda URDF", doctor._panda, "")
    assert not check.ok
    assert "mani_skill is not installed" in check.detail


@pytest.mark.slow
@pytest.mark.sapien
def test_all_checks_pass_after_the_set_up() -> None:
    checks = doctor.run_checks()
    assert len({check.name for check in checks}) == len(checks) == 11
    assert all(check.detail and check.fix for check in checks)
    failed = [f"{check.name}: {check.detail}" for check in checks if not check.ok]
    assert failed == []
