"""`doctor --fix`, with an imitated pip and script: what is announced, what is done, what is left alone."""

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


class Machine:
    """Records what would be run; commands that contain a word of `fails` fail with its text."""

    def __init__(self) -> None:
        self.ran: list[list[str]] = []
        self.fails: dict[str, str] = {}

    def run(self, command: list[str], say: repair.Say) -> None:
        self.ran.append(command)
        for word, reason in self.fails.items():
            if any(word in part for part in command):
                raise SetupError(reason)
        if "--plan" in command:
            say("unpack mesa")
        if "download" in command:
            folder = Path(command[command.index("--dest") + 1])
            folder.mkdir(exist_ok=True)
            (folder / "opencv_python_headless-5.0-cp37.whl").touch()

    def pip(self) -> list[list[str]]:
        """What pip was asked for, without its general options."""
        return [c[c.index("--quiet") + 1 :] for c in self.ran if "pip" in c]


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Machine:
    machine = Machine()
    monkeypatch.setattr(repair, "_run", machine.run)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: ["click>=8", "opencv-python-headless>=4.10"])
    owned(monkeypatch, opencv_python="4.13", opencv_python_headless="5.0")
    return machine


def owned(monkeypatch: pytest.MonkeyPatch, **versions: str) -> None:
    """These distributions own a cv2 and lie in the environment; a shim alone owns none."""
    names = {name.replace("_", "-"): version for name, version in versions.items()}
    monkeypatch.setattr(repair, "_version", names.get)
    monkeypatch.setattr(doctor, "cv2_owners", lambda: [n for n, v in names.items() if v != cv2_shim.VERSION])
    monkeypatch.setattr(repair, "_removable", lambda: doctor.cv2_owners())


def checks(*failed: str) -> list[Check]:
    names = (*doctor.NATIVE_CHECKS, doctor.CV2_CHECK, "torch")
    return [Check(name, name not in failed, "", "") for name in names]


def mend(*failed: str, dry_run: bool = False) -> tuple[bool, list[str]]:
    lines: list[str] = []
    return repair.repair_environment(checks(*failed), lines.append, dry_run=dry_run), lines


def test_without_a_repairable_failure_nothing_is_run(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    owned(monkeypatch, opencv_python=cv2_shim.VERSION, opencv_python_headless="5.0")
    assert mend("torch") == (False, [])
    assert machine.ran == []


@pytest.mark.parametrize("name", doctor.NATIVE_CHECKS)
def test_each_failed_native_check_reinstalls_the_native_libraries(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    owned(monkeypatch, opencv_python=cv2_shim.VERSION, opencv_python_headless="5.0")
    changed, lines = mend(name)
    assert changed
    assert lines == [f"==> Native libraries, in {sys.prefix}", "    unpack mesa"]
    script = str(repair.NATIVE_SCRIPT)
    assert machine.ran == [["bash", script, sys.executable, option] for option in ("--plan", "--anew")]
    assert Path(script).is_file()


def test_repairable_checks_exist_and_their_fix_names_doctor_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_check", lambda name, look, fix: Check(name, True, "", fix))
    names = {check.name: check.fix for check in doctor.run_checks()}
    assert {*doctor.NATIVE_CHECKS, doctor.CV2_CHECK} <= set(names)
    assert all("doctor --fix" in names[name] for name in (*doctor.NATIVE_CHECKS, doctor.CV2_CHECK))


def test_the_cv2_clash_is_repaired_by_downloading_before_uninstalling(machine: Machine) -> None:
    changed, lines = mend("cv2")
    assert changed
    assert lines[1:] == [
        "    remove opencv-python 4.13",
        "    remove opencv-python-headless 5.0",
        "    install opencv-python-headless>=4.10,==5.0, downloaded before anything is removed",
        "    install a shim for opencv-python 4.99.0: metadata, no code",
    ]
    download, uninstall, install = machine.pip()
    assert download[0] == "download"
    assert download[-1] == "opencv-python-headless>=4.10,==5.0"
    assert uninstall == ["uninstall", "--yes", "opencv-python", "opencv-python-headless"]
    assert install[:4] == ["install", "--no-index", "--no-deps", "--force-reinstall"]
    assert [Path(wheel).name.split("-")[0] for wheel in install[4:]] == ["opencv_python", "opencv_python_headless"]


def test_an_unavailable_version_of_opencv_is_replaced_by_the_newest_one(machine: Machine) -> None:
    machine.fails = {"==5.0": "No matching distribution found"}
    assert mend("cv2")[0]
    assert [c[-1] for c in machine.pip() if c[0] == "download"][1:] == ["opencv-python-headless>=4.10"]
    assert machine.pip()[-1][0] == "install"


def test_without_network_nothing_is_uninstalled(machine: Machine) -> None:
    machine.fails = {"download": "Could not find a version"}
    _, lines = mend("cv2")
    assert {c[0] for c in machine.pip()} == {"download"}
    assert "nothing was changed" in lines[-1]
    assert "network" in lines[-1]


def test_a_missing_opencv_python_shim_is_installed_without_network(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    owned(monkeypatch, opencv_python_headless="5.0")
    assert mend() == (
        True,
        [
            f"==> cv2 from opencv-python-headless alone, in {sys.prefix}",
            "    install a shim for opencv-python 4.99.0: metadata, no code",
        ],
    )
    (install,) = machine.pip()
    assert "--no-index" in install


def test_an_environment_without_pip_is_referred_to_ensurepip(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repair, "find_spec", lambda name: None)
    _, lines = mend("cv2")
    assert "-m ensurepip` installs it" in lines[-1]
    assert machine.ran == []


def test_dry_run_prints_both_repairs_and_changes_nothing(machine: Machine) -> None:
    changed, lines = mend("cv2", "Open3D", dry_run=True)
    assert not changed
    assert [line[0] for line in lines].count("=") == 2
    assert [c[-1] for c in machine.ran] == ["--plan"]


def test_a_failed_repair_does_not_prevent_the_other(machine: Machine) -> None:
    machine.fails = {"native.sh": "this system has no apt-get; install by other means: mesa"}
    changed, lines = mend("Vulkan device", "cv2")
    assert changed
    assert lines[1] == "    not repaired: this system has no apt-get; install by other means: mesa"
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


def test_run_forwards_output_lines_and_raises_with_the_last_one() -> None:
    lines: list[str] = []
    repair._run(["bash", "-c", "echo '==> one'; echo two >&2"], lines.append)
    assert lines == ["one", "two"]
    with pytest.raises(SetupError, match=r"^no apt-get$"):
        repair._run(["bash", "-c", "echo said; echo 'setup: no apt-get' >&2; exit 1"], lines.append)
    assert lines == ["one", "two", "said"]
    with pytest.raises(SetupError, match="exit status 3"):
        repair._run(["bash", "-c", "exit 3"], lines.append)
    with pytest.raises(SetupError, match="/no/bash cannot be started"):
        repair._run(["/no/bash"], lines.append)


def test_pip_environment_variables_of_the_user_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_TARGET", "/elsewhere")
    lines: list[str] = []
    repair._run(["bash", "-c", "echo ${PIP_TARGET:-here}"], lines.append)
    assert lines == ["here"]


def test_distributions_outside_of_the_environment_are_not_uninstalled(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A full opencv-python that the environment borrows from its base Python is not this environment's."""
    for place in ("env", "usr"):
        info = tmp_path / place / f"opencv_{'python' if place == 'usr' else 'contrib_python'}-4.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {info.name.split('-')[0]}\nVersion: 4.0\n")
        (info / "RECORD").write_text("cv2/cv2.so,,\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path / "env"), str(tmp_path / "usr")])
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "env"))
    assert doctor.cv2_owners() == ["opencv-python", "opencv-contrib-python"]
    assert repair._removable() == ["opencv-contrib-python"]


def test_the_shim_is_a_wheel_that_pip_accepts(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    wheel, again = cv2_shim.write_wheel(tmp_path), cv2_shim.write_wheel(tmp_path / "other")
    assert wheel.read_bytes() == again.read_bytes()
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q", "install", "--no-index", "--no-deps"]
    subprocess.run([*pip, "--target", str(tmp_path / "site"), str(wheel)], check=True)
    (found,) = importlib.metadata.distributions(path=[str(tmp_path / "site")])
    assert (found.name, found.version, found.requires) == ("opencv-python", "4.99.0", ["opencv-python-headless"])
    assert [f for f in found.files or [] if ".dist-info" not in str(f)] == []


@pytest.mark.parametrize(
    ("arguments", "after", "code"), [(["--fix"], True, 0), (["--fix"], False, 1), (["--fix", "--dry-run"], True, 1)]
)
def test_the_exit_status_is_that_of_the_checks_after_the_repair(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, arguments: list[str], after: bool, code: int
) -> None:
    found = iter([checks("cv2"), checks() if after else checks("cv2")])
    monkeypatch.setattr(doctor, "run_checks", lambda: next(found))
    done = CliRunner().invoke(command, arguments)
    assert done.exit_code == code
    assert "remove opencv-python 4.13" in done.output
    assert done.output.count("checks failed") + done.output.count("checks passed") == (
        1 if "--dry-run" in arguments else 2
    )


def test_dry_run_without_fix_is_refused() -> None:
    done = CliRunner().invoke(command, ["--dry-run"])
    assert done.exit_code == 2
    assert "--dry-run goes with --fix" in done.output
