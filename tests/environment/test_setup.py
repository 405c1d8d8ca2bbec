"""The set-up script, on an imitated machine: what it asks of apt and what it makes of the answers."""

import itertools
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from kinebench_drake.environment import cv2_shim

REPOSITORY = Path(__file__).parents[2]
SCRIPT = REPOSITORY / "setup" / "install.sh"
NATIVE = REPOSITORY / "kinebench_drake" / "environment" / "native.sh"


def pinned() -> dict[str, str]:
    lines = (REPOSITORY / "setup" / "constraints.txt").read_text().splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {normal(name): version for name, version in pairs}


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def run_functions(
    code: str, *, folder: Path, path: str = "", script: Path = SCRIPT
) -> subprocess.CompletedProcess[str]:
    """Run code with a script's functions, but not its steps, in a folder of its own."""
    functions = script.read_text().split("\n# --- Steps ---")[0]
    functions = functions.replace('cd "$(dirname "${BASH_SOURCE[0]}")/.."', f'cd "{folder}"')
    return subprocess.run(
        ["bash", "-c", f"{functions}\n{code}"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PATH": f"{path}:{os.environ['PATH']}" if path else os.environ["PATH"]},
    )


def command(folder: Path, name: str, body: str) -> None:
    folder.mkdir(exist_ok=True)
    file = folder / name
    file.write_text(f"#!/bin/bash\n{body}\n")
    file.chmod(0o755)


def test_every_dependency_is_pinned() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    requirements = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    names = [normal(re.split(r"[\s\[<>=!~;]", requirement)[0]) for requirement in requirements]
    assert [name for name in names if name not in pinned()] == []


def test_pins_are_release_versions_without_local_parts() -> None:
    versions = pinned()
    assert len(versions) > 50
    assert [name for name, version in versions.items() if not re.fullmatch(r"[0-9][0-9a-z.]*", version)] == []


def test_the_pin_of_opencv_python_is_the_version_of_the_shim() -> None:
    """No index has the shim's version."""
    assert pinned()["opencv-python"] == cv2_shim.VERSION == "4.99.0"
    assert f"opencv-python=={cv2_shim.VERSION}" in (REPOSITORY / "setup" / "freeze.sh").read_text()


@pytest.mark.parametrize("script", [SCRIPT, NATIVE, REPOSITORY / "setup" / "freeze.sh", REPOSITORY / ".ci" / "run"])
def test_scripts_are_executable_and_parse(script: Path) -> None:
    assert os.access(script, os.X_OK)
    subprocess.run(["bash", "-n", str(script)], check=True)


def test_ci_runs_the_command_of_the_readme_and_the_gate() -> None:
    lines = (REPOSITORY / ".ci" / "run").read_text().splitlines()
    assert lines[-2:] == ["make test", "make gate"]
    readme = (REPOSITORY / "README.md").read_text()
    assert re.search(r"^make test\b", readme, re.MULTILINE)
    assert re.search(r"^make demo\b", readme, re.MULTILINE)


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_test_sets_up_and_runs_every_check() -> None:
    done = subprocess.run(["make", "-n", "test"], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    steps = ["setup/install.sh", "ruff format --check .", "ruff check .", "mypy", "pytest"]
    found = [done.stdout.find(step) for step in steps]
    assert -1 not in found
    assert found == sorted(found)


@pytest.mark.parametrize(("version", "fit"), [("3.10", False), ("3.11", True), ("3.12", True), ("3.13", False)])
def test_python_is_chosen_by_version(tmp_path: Path, version: str, fit: bool) -> None:
    major, minor = version.split(".")
    command(tmp_path / "bin", "fake", f'exec python3 -c "import sys; sys.version_info=({major},{minor},0); $2"')
    done = run_functions("is_fit fake && echo fit || echo unfit", folder=tmp_path, path=str(tmp_path / "bin"))
    assert done.stdout.strip() == ("fit" if fit else "unfit")


def test_a_machine_without_a_supported_python_is_refused_in_one_line(tmp_path: Path) -> None:
    done = run_functions("PYTHON=/nonexistent; make_venv", folder=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("setup: no Python 3.11 or 3.12 found")
    assert len(done.stderr.splitlines()) == 1


ONE_LINE = (
    "deb [signed-by=/k.gpg] http://mirror.example/debian bookworm main\ndeb http://s.example/ bookworm-security main\n"
)
DEB822 = """\
Types: deb
URIs: http://mirror.example/debian
Suites: bookworm bookworm-updates
Components: main
Signed-By: /k.gpg
"""


@pytest.mark.parametrize(
    ("name", "text", "added"),
    [
        ("a.list", ONE_LINE, "deb [signed-by=/k.gpg] http://mirror.example/debian bookworm-backports main"),
        ("a.sources", DEB822, "Suites: bookworm bookworm-backports bookworm-updates"),
        ("b.sources", DEB822.replace("bookworm bookworm-updates", "bookworm"), "Suites: bookworm bookworm-backports"),
    ],
)
def test_backports_are_added_on_the_configured_mirror(tmp_path: Path, name: str, text: str, added: str) -> None:
    (tmp_path / name).write_text(text)
    done = run_functions(
        f"cd {tmp_path}; with_suite bookworm bookworm-backports {name}", folder=tmp_path, script=NATIVE
    )
    assert done.stdout.splitlines().count(added) == 1, done
    kept = [line for line in done.stdout.splitlines() if line != added]
    assert kept == [line for line in text.splitlines() if not (name.endswith("sources") and line.startswith("Suites"))]


def test_sources_with_backports_are_unchanged(tmp_path: Path) -> None:
    text = ONE_LINE + "deb http://mirror.example/debian bookworm-backports main\n"
    (tmp_path / "a.list").write_text(text)
    code = f"cd {tmp_path}; with_suite bookworm bookworm-backports a.list"
    assert run_functions(code, folder=tmp_path, script=NATIVE).stdout == text


APT_CACHE = """
case "$*" in
*"policy mesa-vulkan-drivers"*) echo "  Candidate: {mesa}" ;;
*"policy libusb-1.0-0"*) echo "  Candidate: 2:1.0.26-1" ;;
*) echo "  Candidate: (none)" ;;
esac
"""


def fetch(tmp_path: Path, mesa: str, names: str) -> subprocess.CompletedProcess[str]:
    command(tmp_path / "bin", "apt-get", f'echo "$*" >>"{tmp_path}/asked"')
    command(tmp_path / "bin", "apt-cache", APT_CACHE.format(mesa=mesa))
    command(tmp_path / "bin", "dpkg", '[ "$1" != --compare-versions ] || exec /usr/bin/dpkg "$@"')
    code = f"work={tmp_path}/work; fetch_libraries {names}"
    return run_functions(code, folder=tmp_path, path=str(tmp_path / "bin"), script=NATIVE)


@pytest.mark.skipif(not Path("/usr/bin/dpkg").exists(), reason="needs a Debian family system")
def test_packages_are_downloaded_and_never_installed(tmp_path: Path) -> None:
    done = fetch(tmp_path, "25.0.7-2~bpo12+1", "libusb-1.0.so.0 mesa")
    assert done.returncode == 0, done.stderr
    update, install = (tmp_path / "asked").read_text().splitlines()
    assert update.endswith("update")
    assert "--download-only" in install
    assert install.endswith("libusb-1.0-0 mesa-vulkan-drivers")


@pytest.mark.skipif(not Path("/usr/bin/dpkg").exists(), reason="needs a Debian family system")
@pytest.mark.parametrize(
    ("mesa", "names", "message"),
    [
        ("22.3.6-1", "mesa", "needs Mesa 24.3 or newer, this system's newest is 22.3.6-1"),
        ("(none)", "mesa", "the package for mesa is not available"),
        ("25.0.7-2", "libnovel.so.7", "no package is known for libnovel.so.7"),
    ],
)
def test_unavailable_packages_are_named_and_nothing_is_downloaded(
    tmp_path: Path, mesa: str, names: str, message: str
) -> None:
    done = fetch(tmp_path, mesa, names)
    assert done.returncode == 1
    assert message in done.stderr
    assert "--download-only" not in (tmp_path / "asked").read_text()


def test_set_up_files_name_no_host_and_no_home_folder() -> None:
    """Set-up files hold no mirror, no registry host and no absolute home path."""
    for file in (
        SCRIPT,
        NATIVE,
        REPOSITORY / "setup" / "freeze.sh",
        REPOSITORY / "setup" / "constraints.txt",
        REPOSITORY / "Makefile",
    ):
        assert not re.search(r"https?://|/root/|/home/", file.read_text()), file


LACKS = """
site={folder}/site prefix={folder}/env python=python3
native=$prefix/share/kinebench_drake/native
mkdir -p $prefix $site
roots() {{ :; }}
missing() {{ [ -n "$1" ] || printf '{missing}'; }}
has_vulkan_driver() {{ true; }}
damage() {{ [ ! -e $native/torn ] || echo "it is torn"; }}
ldd() {{ :; }}
fetch_libraries() {{
    echo "fetched $*"
    mkdir -p "$root"/usr/x86_64-linux-gnu
    touch "$root"/usr/x86_64-linux-gnu/lib.so
}}
"""


def install_native(folder: Path, missing: str, option: str = "", before: str = "") -> subprocess.CompletedProcess[str]:
    """Run native.sh's main step on a system that lacks some libraries, its downloads imitated."""
    code = f"{LACKS.format(folder=folder, missing=missing)}{before}\ninstall_native '{option}'"
    return run_functions(code, folder=folder, script=NATIVE)


def unpacked(folder: Path, *names: str) -> Path:
    native = folder / "env" / "share" / "kinebench_drake" / "native"
    native.mkdir(parents=True)
    (native / "wanted.txt").write_text("".join(f"{name}\n" for name in names))
    (native / "old").touch()
    return native


def test_missing_libraries_are_unpacked_once(tmp_path: Path) -> None:
    done = install_native(tmp_path, "libusb-1.0.so.0")
    assert done.returncode == 0, done.stderr
    assert "fetched libusb-1.0.so.0" in done.stdout
    native = tmp_path / "env" / "share" / "kinebench_drake" / "native"
    assert (native / "wanted.txt").read_text() == "libusb-1.0.so.0\n"
    assert [p.name for p in (tmp_path / "env").iterdir()] == ["share"]  # no temporary folder is left
    assert install_native(tmp_path, "libusb-1.0.so.0").stdout == "==> Native libraries: all there, nothing to do\n"


@pytest.mark.parametrize(("option", "torn"), [("", True), ("--anew", False)])
def test_damaged_libraries_are_replaced(tmp_path: Path, option: str, torn: bool) -> None:
    native = unpacked(tmp_path, "libusb-1.0.so.0")
    if torn:
        (native / "torn").touch()
    done = install_native(tmp_path, "libusb-1.0.so.0", option)
    assert f"Replacing {native}" in done.stdout
    assert "fetched" in done.stdout
    assert not (native / "old").exists()


def test_old_libraries_stay_when_their_replacement_fails(tmp_path: Path) -> None:
    native = unpacked(tmp_path, "libusb-1.0.so.0")
    done = install_native(tmp_path, "libusb-1.0.so.0", "--anew", "fetch_libraries() { stop 'no network'; }")
    assert (done.returncode, done.stderr) == (1, "setup: no network\n")
    assert (native / "old").exists()


def test_a_damaged_library_folder_that_is_not_needed_is_deleted(tmp_path: Path) -> None:
    native = unpacked(tmp_path, "libusb-1.0.so.0")
    (native / "torn").touch()
    done = install_native(tmp_path, "")
    assert (done.returncode, native.exists(), "fetched" in done.stdout) == (0, False, False)


def test_a_system_without_apt_fails_with_the_list_of_libraries_to_install(tmp_path: Path) -> None:
    before = 'command() { [ "$2" != apt-get ] && builtin command "$@"; }'
    done = install_native(tmp_path, "libusb-1.0.so.0", "--anew", before)
    assert done.returncode == 1
    assert done.stderr.startswith("setup: this system has no apt-get; install by other means")
    assert done.stderr.endswith("libusb-1.0.so.0\n")


def test_native_sh_names_missing_python_packages_and_the_pip_command(tmp_path: Path) -> None:
    command(tmp_path / "bin", "python", f"echo {tmp_path}/env; echo {tmp_path}/site")
    done = subprocess.run([NATIVE, tmp_path / "bin" / "python"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "holds no pydrake" in done.stderr
    assert "-m pip install kinebench-drake" in done.stderr
