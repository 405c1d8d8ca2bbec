import pytest

from kinebench_drake.kinematics.plant import PandaPlant


@pytest.fixture(scope="session")
def plant() -> PandaPlant:
    return PandaPlant()
