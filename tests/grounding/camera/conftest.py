import pytest

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.grounding.registration.arm_model import ArmModel


@pytest.fixture(scope="session")
def model() -> ArmModel:
    return ArmModel()


@pytest.fixture
def camera() -> Camera:
    return benchmark_camera()
