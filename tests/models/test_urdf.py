from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kinebench_drake.errors import InputError
from kinebench_drake.models.urdf import convert_urdf, find_mesh, read_allowed_pairs, read_urdf

Write = Callable[..., Path]


def _mesh(path: Path, size: float = 0.1) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.icosphere(subdivisions=1, radius=size).export(path)
    return path


def _shape(uri: str) -> str:
    return f'<mesh filename="{uri}"/>'


def test_meshes_are_found_by_relative_file_and_package_uris(tmp_path: Path) -> None:
    urdf = tmp_path / "ws" / "arm_description" / "urdf" / "arm.urdf"
    urdf.parent.mkdir(parents=True)
    mesh = _mesh(tmp_path / "ws" / "arm_description" / "meshes" / "a part.stl")
    spaced = str(mesh).replace(" ", "%20")
    for uri in (
        "../meshes/a part.stl",
        str(mesh),
        f"file://{spaced}",
        f"file://{mesh}",
        "file://../meshes/a%20part.stl",
        "package://arm_description/meshes/a part.stl",
        "package://arm_description/meshes/a%20part.stl",
        "package://under_another_name/meshes/a part.stl",
    ):
        found = find_mesh(urdf, uri)
        assert found is not None, uri
        assert found.resolve() == mesh.resolve()
    for uri in ("package://arm_description/meshes/b.stl", "b.stl", "file:///b.stl"):
        assert find_mesh(urdf, uri) is None


def test_collision_meshes_become_convex_hulls_and_visual_meshes_keep_their_surface(
    write_arm: Write, tmp_path: Path
) -> None:
    _mesh(tmp_path / "meshes" / "one" / "part.stl", 0.1)
    _mesh(tmp_path / "meshes" / "two" / "part.stl", 0.2)
    source = write_arm(
        shapes={1: _shape("package://meshes/one/part.stl"), 2: _shape("package://meshes/two/part.stl")},
        visuals={1: _shape("../meshes/one/part.stl"), 3: '<sphere radius="0.1"/>'},
    )
    urdf = convert_urdf(source, "small")
    collisions = read_urdf(urdf).findall("link/collision/geometry/mesh")
    for mesh, size in zip(collisions, (0.1, 0.2), strict=True):
        hull = trimesh.load(urdf.parent / str(mesh.get("filename")), force="mesh")
        assert hull.is_convex
        np.testing.assert_allclose(np.linalg.norm(hull.vertices, axis=-1), size, rtol=1e-5)
    visuals = read_urdf(urdf).findall("link/visual/geometry/mesh")
    assert len(visuals) == 1
    assert len(trimesh.load(urdf.parent / str(visuals[0].get("filename")), force="mesh").faces) == 80
    assert all(e.get("rgba") for e in read_urdf(urdf).findall("link/visual/material/color"))


def test_the_converted_urdf_is_cached_until_its_source_changes(write_arm: Write, tmp_path: Path) -> None:
    mesh = _mesh(tmp_path / "arm" / "part.stl", 0.1)
    source = write_arm(shapes={1: _shape("part.stl")})
    first = convert_urdf(source, "small")
    written = first.stat().st_mtime_ns
    assert convert_urdf(source, "small") == first
    assert first.stat().st_mtime_ns == written
    _mesh(mesh, 0.3)
    assert convert_urdf(source, "small") != first


def test_elements_that_drake_does_not_support_are_dropped(write_arm: Write) -> None:
    extra = (
        '<link name="finger"/><joint name="slide" type="prismatic"><parent link="l7"/><child link="finger"/>'
        '<dynamics damping="2" friction="3"/><limit lower="0" upper="0.04" velocity="1" effort="1"/>'
        '<mimic joint="j1"/><safety_controller k_velocity="1"/></joint>'
    )
    root = read_urdf(convert_urdf(write_arm(more=extra), "small"))
    assert not [*root.iter("mimic"), *root.iter("safety_controller")]
    assert [d.attrib for d in root.iter("dynamics")] == [{"damping": "2"}]


@pytest.mark.parametrize("content", [None, b"no mesh at all", b"solid a\nendsolid a"])
def test_unreadable_visual_is_left_out_and_unreadable_collision_refused(
    write_arm: Write, tmp_path: Path, content: bytes | None
) -> None:
    (tmp_path / "arm").mkdir()
    if content is not None:
        (tmp_path / "arm" / "bad.stl").write_bytes(content)
    urdf = convert_urdf(write_arm(visuals={2: _shape("bad.stl"), 3: '<sphere radius="0.1"/>'}), "small")
    assert len(read_urdf(urdf).findall("link/visual")) == 1
    with pytest.raises(InputError, match=r"^small\.urdf.*collision mesh .*bad\.stl") as caught:
        convert_urdf(write_arm(shapes={2: _shape("bad.stl")}), "small")
    assert "\n" not in str(caught.value)
    assert str(tmp_path) not in str(caught.value)


def test_flat_collision_mesh_is_refused(write_arm: Write, tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"flat\.obj cannot be read") as caught:
        convert_urdf(write_arm(shapes={2: _shape("flat.obj")}), "small")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "plain text", "<robot><link></robot>", "<sdf/>"])
def test_a_file_that_is_no_urdf_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "wrong.urdf"
    path.write_text(text)
    with pytest.raises(InputError, match=r"^wrong\.urdf: not a URDF") as caught:
        read_urdf(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="cannot be read"):
        read_urdf(tmp_path / "missing.urdf")


def test_allowed_pairs_are_the_disabled_collisions_of_the_srdf(tmp_path: Path) -> None:
    srdf = tmp_path / "a.srdf"
    srdf.write_text('<robot><disable_collisions link1="a" link2="b" reason="Never"/><group name="g"/></robot>')
    assert read_allowed_pairs(srdf) == {frozenset("ab")}
    srdf.write_text("<robot>")
    with pytest.raises(InputError, match="not an SRDF"):
        read_allowed_pairs(srdf)
