import pytest

from benchmarks.motion import Arm


@pytest.fixture(scope="session")
def arm() -> Arm:
    return Arm()
