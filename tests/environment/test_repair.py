"""`doctor --fix`: which commands it runs, and what it leaves alone."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from kinebench_drake.cli.doctor import doctor as command
from kinebench_drake.environment import cv2_shim, doctor, repair
from kinebench_drake.environment.doctor import Check
from kinebench_drake.errors import SetupError
from kinebench_drake.suites import vulkan


class Machine:
    """Records the commands that would be run; those that contain a word of `fails` fail."""

    def __init__(self) -> None:
        self.ran: list[list[str]] = []
        self.fails: tuple[str, ...] = ()

    def run(self, command: list[str], env: dict[str, str]) -> subprocess.CompletedProcess[bytes]:
        assert "PIP_TARGET" not in env
        self.ran.append(command)
        failed = any(word in part for word in self.fails for part in command)
        return subprocess.CompletedProcess(command, int(failed))

    def pip(self) -> list[list[str]]:
        """What pip was asked for, without its general options."""
        return [c[c.index("--quiet") + 1 :] for c in self.ran if "pip" in c]


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Machine:
    machine = Machine()
    monkeypatch.setenv("PIP_TARGET", "/elsewhere")
    monkeypatch.setattr(repair.subprocess, "run", machine.run)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: ["click>=8", "opencv-python-headless>=4.10"])
    return machine


def checks(*failed: str) -> list[Check]:
    names = (*doctor.NATIVE_CHECKS, doctor.CV2_CHECK, "torch")
    return [Check(name, name not in failed, "", "") for name in names]


def mend(*failed: str) -> tuple[bool, list[str]]:
    lines: list[str] = []
    return repair.repair_environment(checks(*failed), lines.append), lines


def test_without_a_repairable_failure_nothing_is_run(machine: Machine) -> None:
    assert mend("torch") == (False, [])
    assert machine.ran == []


@pytest.mark.parametrize("name", doctor.NATIVE_CHECKS)
def test_each_failed_native_check_reinstalls_the_native_libraries(machine: Machine, name: str) -> None:
    changed, [line] = mend(name)
    assert changed
    assert line.endswith("native.sh " + sys.executable + " --anew")
    assert machine.ran == [["bash", str(repair.NATIVE_SCRIPT), sys.executable, "--anew"]]
    assert repair.NATIVE_SCRIPT.is_file()


def test_repairable_checks_exist_and_their_fix_names_doctor_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "check", lambda name, look, fix: Check(name, True, "", fix))
    monkeypatch.setattr(vulkan, "check", lambda name, look, fix: Check(name, True, "", fix))
    names = {check.name: check.fix for check in (*doctor.run_checks(), vulkan.check_vulkan())}
    assert {*doctor.NATIVE_CHECKS, doctor.CV2_CHECK} <= set(names)
    assert all("doctor --fix" in names[name] for name in (*doctor.NATIVE_CHECKS, doctor.CV2_CHECK))


def test_the_cv2_clash_is_repaired_by_downloading_before_uninstalling(machine: Machine) -> None:
    assert mend("cv2")[0]
    download, uninstall, install = machine.pip()
    assert (download[0], download[-1]) == ("download", "opencv-python-headless>=4.10")
    assert uninstall == ["uninstall", "--yes", *doctor.CV2_OWNERS]
    assert (install[0], install[-2:]) == ("install", ["opencv-python-headless", "opencv-python"])
    assert "--no-index" in install
    assert download[download.index("--dest") + 1] == install[install.index("--find-links") + 1]


def test_without_network_nothing_is_uninstalled(machine: Machine) -> None:
    machine.fails = ("download",)
    _, lines = mend("cv2")
    assert [c[0] for c in machine.pip()] == ["download"]
    assert lines[-1] == "    failed"


def test_a_failed_repair_does_not_prevent_the_other(machine: Machine) -> None:
    machine.fails = ("native.sh",)
    changed, lines = mend("Vulkan device", "cv2")
    assert changed
    assert lines[1] == "    failed"
    assert machine.pip()[-1][0] == "install"


@pytest.mark.parametrize(
    ("base", "writable", "message"), [("same", True, "no virtual environment"), ("/usr", False, "cannot be written to")]
)
def test_only_a_writable_virtual_environment_is_repaired(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, base: str, writable: bool, message: str
) -> None:
    if base == "same":
        monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    monkeypatch.setattr("os.access", lambda path, mode: writable)
    with pytest.raises(SetupError, match=message):
        mend("cv2")
    assert machine.ran == []


def test_a_conda_environment_is_repaired_and_a_conda_base_is_not(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    (tmp_path / "conda-meta").mkdir()
    assert mend("cv2")[0]
    (tmp_path / "condabin").mkdir()
    with pytest.raises(SetupError, match="no virtual environment"):
        mend("cv2")


def test_the_shim_is_a_wheel_that_pip_accepts(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    wheel = cv2_shim.write_wheel(tmp_path)
    again = cv2_shim.write_wheel(tmp_path / "other")
    assert wheel.read_bytes() == again.read_bytes()
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q", "install", "--no-index", "--no-deps"]
    subprocess.run([*pip, "--target", str(tmp_path / "site"), str(wheel)], check=True)
    (found,) = importlib.metadata.distributions(path=[str(tmp_path / "site")])
    assert (found.name, found.version, found.requires) == ("opencv-python", "4.99.0", ["opencv-python-headless"])
    assert [f for f in found.files or [] if ".dist-info" not in str(f)] == []


@pytest.mark.parametrize(("after", "code"), [(True, 0), (False, 1)])
def test_the_exit_status_is_that_of_the_checks_after_the_repair(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, after: bool, code: int
) -> None:
    found = iter([checks("cv2"), checks() if after else checks("cv2")])
    monkeypatch.setattr(doctor, "run_checks", lambda: next(found))
    monkeypatch.setattr(vulkan, "check_vulkan", lambda: Check("Vulkan device", True, "", ""))
    done = CliRunner().invoke(command, ["--fix"])
    assert done.exit_code == code
    assert "uninstall --yes opencv-python" in done.output
    assert done.output.count("checks failed") + done.output.count("checks passed") == 2
