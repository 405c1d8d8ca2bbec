import ctypes.util
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest

from kinebench_drake.environment import native
from kinebench_drake.errors import SetupError

NEEDS_COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder in place of the unpacked libraries, on a machine without an NVIDIA driver or chosen driver."""
    monkeypatch.setattr(native, "ROOT", tmp_path)
    monkeypatch.setattr(native, "NVIDIA_CONTROL", tmp_path / "nvidiactl")
    monkeypatch.setattr(native, "DRIVER_FOLDERS", (tmp_path / "icd.d",))
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", native.RENDER_VARIABLE):
        monkeypatch.setenv(name, "")  # so that what the code sets is undone too
        monkeypatch.delenv(name)
    native.prepare_vulkan.cache_clear()
    yield tmp_path
    native.prepare_vulkan.cache_clear()


def install_nvidia(root: Path) -> None:
    (root / "nvidiactl").touch()
    (root / "icd.d").mkdir()
    (root / "icd.d" / "nvidia_icd.x86_64.json").touch()


def test_without_unpacked_libraries_the_environment_stays_unchanged(root: Path) -> None:
    assert native.prepare_vulkan() == "cpu"
    assert "VK_DRIVER_FILES" not in os.environ


def test_the_unpacked_vulkan_driver_is_selected(root: Path) -> None:
    driver = root / "lavapipe.json"
    driver.touch()
    assert native.prepare_vulkan() == "cpu"
    assert os.environ["VK_DRIVER_FILES"] == os.environ["VK_ICD_FILENAMES"] == str(driver)


def test_the_nvidia_driver_has_precedence_over_the_software_driver(root: Path) -> None:
    (root / "lavapipe.json").touch()
    install_nvidia(root)
    assert native.prepare_vulkan() == "gpu"
    assert "VK_DRIVER_FILES" not in os.environ


def test_the_render_variable_selects_the_software_driver(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (root / "lavapipe.json").touch()
    install_nvidia(root)
    monkeypatch.setenv(native.RENDER_VARIABLE, "cpu")
    assert native.prepare_vulkan() == "cpu"
    assert os.environ["VK_DRIVER_FILES"] == str(root / "lavapipe.json")


@pytest.mark.parametrize(
    ("file", "backend"), [("/opt/mesa/lvp_icd.json", "cpu"), ("/etc/vulkan/nvidia_icd.json", "gpu")]
)
@pytest.mark.parametrize("variable", ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"])
def test_a_vulkan_driver_set_by_the_user_is_kept(
    root: Path, monkeypatch: pytest.MonkeyPatch, variable: str, file: str, backend: str
) -> None:
    (root / "lavapipe.json").touch()
    monkeypatch.setenv(variable, file)
    assert native.prepare_vulkan() == backend
    assert os.environ[variable] == file


def test_nvidia_driver_without_a_device_is_not_used(root: Path) -> None:
    install_nvidia(root)
    (root / "nvidiactl").unlink()
    assert not native.has_nvidia_vulkan()


def test_unloadable_library_names_the_library_and_the_fix(root: Path) -> None:
    (root / "libbroken.so").write_bytes(b"not a library")
    (root / "vulkan.txt").write_text("libbroken.so\n")
    with pytest.raises(SetupError, match=r"libbroken\.so.*doctor --fix"):
        native.prepare_vulkan()


@NEEDS_COMPILER
def test_listed_libraries_are_preloaded_in_any_order_of_their_dependencies(root: Path) -> None:
    """libuser needs libbase, which lies in no folder that the linker searches, and stands first in the list."""
    (root / "base.c").write_text("int base(void) { return 41; }")
    (root / "user.c").write_text("int base(void); int user(void) { return base() + 1; }")
    build = ["cc", "-shared", "-fPIC"]
    subprocess.run([*build, "base.c", "-Wl,-soname,libkbbase.so.1", "-o", "libkbbase.so.1"], cwd=root, check=True)
    subprocess.run([*build, "user.c", "./libkbbase.so.1", "-o", "libkbuser.so"], cwd=root, check=True)
    (root / "vulkan.txt").write_text("libkbuser.so\nlibkbbase.so.1\n")
    with pytest.raises(OSError, match=r"libkbbase\.so\.1"):
        ctypes.CDLL(str(root / "libkbuser.so"))
    native.prepare_vulkan()
    assert "libkbuser.so" in Path("/proc/self/maps").read_text()
    assert ctypes.CDLL(str(root / "libkbuser.so")).user() == 42


@pytest.fixture
def unpacked(root: Path) -> Path:
    """What native.sh leaves where only the driver is missing; here the driver is a library that can be loaded."""
    (root / "driver.c").write_text("int driver(void) { return 1; }")
    subprocess.run(["cc", "-shared", "-fPIC", "driver.c", "-o", "libdriver.so"], cwd=root, check=True)
    (root / "vulkan.txt").write_text("libdriver.so\n")
    return root


def test_an_absent_library_folder_is_not_reported_as_damaged(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "ROOT", root / "none")
    assert native.damage() is None


@NEEDS_COMPILER
def test_an_undamaged_library_folder_is_not_reported_as_damaged(unpacked: Path) -> None:
    assert native.damage() is None


@NEEDS_COMPILER
@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("libdriver.so", None, "cannot load libdriver.so"),
        ("libdriver.so", "torn", "cannot load libdriver.so"),
        ("vulkan.txt", "usr/libvulkan.so", "cannot load libvulkan.so"),
    ],
)
def test_damage_names_the_missing_or_broken_file(unpacked: Path, file: str, content: str | None, message: str) -> None:
    (unpacked / file).unlink(missing_ok=True)
    if content is not None:
        (unpacked / file).write_text(content)
    assert message in (native.damage() or "whole")


def test_importing_native_loads_no_heavy_module() -> None:
    heavy = "{'torch', 'open3d', 'sapien', 'pydrake'}"
    code = f"import sys, kinebench_drake.environment.native; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_drake_open3d_and_sapien_load_in_one_process() -> None:
    """The modules load in a fresh process after their prepare function, in one process together."""
    code = (
        "from kinebench_drake.environment import native\n"
        "native.prepare_drake(), native.load_open3d(), native.prepare_vulkan()\n"
        "import pydrake.multibody.plant, open3d, sapien\n"
    )
    assert Path(sysconfig.get_path("platlib")).is_dir()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "libvulkan" not in done.stderr


def test_open3d_registration_runs_in_one_thread() -> None:
    """Its thread pool has the size of the machine otherwise, and sums depend on who finishes first."""
    code = (
        "import os\n"
        "from kinebench_drake.environment import native\n"
        "cores = os.sched_getaffinity(0)\n"
        "open3d = native.load_open3d()\n"
        "assert os.sched_getaffinity(0) == cores\n"
        "before = len(os.listdir('/proc/self/task'))\n"
        "points = open3d.utility.Vector3dVector([[i % 7, i % 11, i % 13] for i in range(2000)])\n"
        "cloud = open3d.geometry.PointCloud(points)\n"
        "open3d.pipelines.registration.registration_icp(cloud, cloud, 1.0)\n"
        "print(len(os.listdir('/proc/self/task')) - before)\n"
    )
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.strip() == "0"
