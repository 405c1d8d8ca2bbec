from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest
from hypothesis import settings

pytest_plugins = ["tests.fakes.fixtures"]
settings.register_profile("quick", max_examples=25, deadline=None, derandomize=True)
settings.register_profile("soak", max_examples=5_000, deadline=None, print_blob=True)
settings.load_profile("quick")  # `make soak` asks for the other

AXES = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
BOX = '<box size="0.04 0.04 0.1"/>'
INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="2" velocity="1.5" effort="20"/>'


@pytest.fixture
def write_arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Writes the URDF of a made-up arm: links l0 .. l7 of 0.2 m, a box 0.1 m above each one's joint j1 .. j7.

    A link `tool` is fixed 0.1 m beyond the last. What is converted goes to a cache of the test's own.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def write(
        *,
        joints: int = 7,
        shapes: Mapping[int, str] | None = None,
        visuals: Mapping[int, str] | None = None,
        types: Mapping[int, str] | None = None,
        limits: Mapping[int, str] | None = None,
        more: str = "",
    ) -> Path:
        shapes, visuals, types, limits = ({} if m is None else m for m in (shapes, visuals, types, limits))
        text = ['<robot name="small">']
        for i in range(joints + 1):
            collision = f'<collision><origin xyz="0 0 0.1"/><geometry>{shapes.get(i, BOX)}</geometry></collision>'
            visual = f"<visual><geometry>{visuals[i]}</geometry></visual>" if i in visuals else ""
            text.append(f'<link name="l{i}">{INERTIAL}{collision}{visual}</link>')
        for i in range(1, joints + 1):
            text.append(
                f'<joint name="j{i}" type="{types.get(i, "revolute")}"><origin xyz="0 0 0.2"/>'
                f'<parent link="l{i - 1}"/><child link="l{i}"/><axis xyz="{AXES[(i - 1) % 7]}"/>'
                f"{limits.get(i, LIMIT)}</joint>"
            )
        text.append(
            '<link name="tool"/><joint name="tool_joint" type="fixed"><origin xyz="0 0 0.1"/>'
            f'<parent link="l{joints}"/><child link="tool"/></joint>{more}</robot>'
        )
        path = tmp_path / "arm" / "small.urdf"
        path.parent.mkdir(exist_ok=True)
        path.write_text("\n".join(text))
        return path

    return write


def pytest_collection_modifyitems(items: list[pytest.Function]) -> None:
    for item in items:
        if item.get_closest_marker("sapien"):
            item.fixturenames.insert(0, "renderer")


@pytest.fixture(scope="session")
def renderer() -> Iterator[None]:
    """A simulator that stays open: the first picture after the last one was closed takes seven seconds without a GPU.

    Tests marked `sapien` use it by themselves.
    """
    from kinebench_drake.camera import benchmark_camera
    from kinebench_drake.suites.composition import compose
    from kinebench_drake.suites.simulator import Simulator  # loads SAPIEN

    with Simulator("PullCube-v1", camera=benchmark_camera().resized(32, 32)) as simulator:
        simulator.reset(compose("PullCube-v1", 0))
        simulator.render()
        yield


@pytest.fixture(scope="session")
def cad():
    """The CAD model of the gripper."""
    from kinebench_drake.models.panda.cad import GripperCad  # loads Open3D

    return GripperCad()
