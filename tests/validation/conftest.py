import pytest

from kinebench_drake.validation.motion import Arm


@pytest.fixture(scope="session")
def arm() -> Arm:
    return Arm()
