"""Errors of the simulator where the machine cannot render."""

import subprocess
import sys

import pytest

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.simulator import setup_errors


@pytest.mark.parametrize(
    "error",
    [
        RuntimeError("vk::createInstanceUnique: ErrorIncompatibleDriver"),
        RuntimeError("failed to find a rendering device"),
        ImportError("libX11.so.6: cannot open shared object file"),
    ],
)
def test_a_missing_driver_or_library_is_reported_with_its_fix(error: Exception) -> None:
    with pytest.raises(SetupError, match="doctor --fix") as caught, setup_errors():
        raise error
    assert str(error) in str(caught.value)


@pytest.mark.parametrize("error", [RuntimeError("a joint is out of range"), ValueError("no vk:: at all")])
def test_errors_unrelated_to_setup_are_passed_on(error: Exception) -> None:
    with pytest.raises(type(error)) as caught, setup_errors():
        raise error
    assert caught.value is error


@pytest.mark.sapien
def test_physics_without_images_shows_no_warning_about_vulkan() -> None:
    code = "from kinebench_drake.suites.simulator import Simulator; Simulator('PullCube-v1', renders=False).close()"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "ulkan" not in run.stderr
