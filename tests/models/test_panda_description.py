import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kinebench_drake.errors import SetupError
from kinebench_drake.models.arm import panda
from kinebench_drake.models.panda import description


def test_the_urdf_refers_only_to_existing_obj_files() -> None:
    urdf = panda().urdf
    names = [str(mesh.get("filename")) for mesh in ElementTree.parse(urdf).iter("mesh")]
    assert len(names) == 20  # 9 hulls of the arm's and the hand's links, and 11 visuals
    for name in names:
        assert name.endswith(".obj")
        assert (urdf.parent / name).stat().st_size > 0


def test_collision_meshes_are_the_convex_hulls_of_the_source() -> None:
    source = description.source_urdf().parent / "franka_description" / "meshes" / "collision" / "link5.stl"
    original = trimesh.load(source, force="mesh")
    hull = trimesh.load(panda().urdf.parent / "collision_link5.obj", force="mesh")
    assert hull.is_convex
    np.testing.assert_allclose(hull.bounds, original.bounds, atol=1e-6)
    assert original.volume < hull.volume == pytest.approx(original.convex_hull.volume, rel=1e-5)


def test_joints_links_and_limits_equal_those_of_the_source_urdf() -> None:
    trees = [ElementTree.parse(path).getroot() for path in (description.source_urdf(), panda().urdf)]
    for tag in ("joint/limit", "joint/origin", "link/inertial/mass", "link/inertial/inertia"):
        found = [[element.attrib for element in root.findall(tag)] for root in trees]
        assert len(found[0]) > 7
        assert all(source.items() <= own.items() for source, own in zip(*found, strict=True))
    names = {element.get("name") for element in trees[1].findall("link")}
    assert {*description.ARM_LINKS, description.HAND_LINK, description.TCP_LINK, *description.FINGER_LINKS} <= names
    assert set(description.ARM_JOINTS) <= {e.get("name") for e in trees[1].findall("joint")}


def test_two_processes_may_convert_the_urdf_at_once(tmp_path: Path) -> None:
    code = "from kinebench_drake.models.arm import panda; print(panda().urdf)"
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", code]
    running = [subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    paths = [process.communicate(timeout=120)[0].strip() for process in running]
    assert [process.returncode for process in running] == [0, 0]
    assert paths[0] == paths[1]
    left = list((tmp_path / "kinebench_drake").iterdir())
    assert left == [Path(paths[0]).parent]  # nothing half-written stays behind
    mine = panda().urdf.parent
    for file in mine.iterdir():
        assert file.read_bytes() == (left[0] / file.name).read_bytes()


def test_unwritable_cache_is_a_setup_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    panda.cache_clear()
    with pytest.raises(SetupError, match="XDG_CACHE_HOME"):
        panda()


def test_locating_the_robot_imports_no_simulator() -> None:
    code = (
        "import sys; from kinebench_drake.models.arm import panda; panda();"
        "print([m for m in ('mani_skill', 'sapien', 'torch', 'pydrake') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
