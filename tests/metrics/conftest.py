import pytest

from kinebench_drake.kinematics.plant import ArmPlant


@pytest.fixture(scope="session")
def plant() -> ArmPlant:
    return ArmPlant()
