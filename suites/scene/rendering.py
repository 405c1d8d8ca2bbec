"""Rendering by a software driver in half the time: shaders without needless work, an arm of fewer triangles.

The shaders give the same images to the bit. Without an environment map they need not sample one, and the 25 overlapping
squares of 2 x 2 texels that smooth a shadow are 6 x 6 texels, which nine squares cover. ManiSkill's Panda has 127,000
triangles in the links of its arm, nearly all of them smaller than a pixel of the benchmark camera; simplified meshes
change the shade of some pixels along edges.
"""

import hashlib
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import sapien
from mani_skill.render import PREBUILT_SHADER_CONFIGS, ShaderConfig, set_shader_pack
from numpy.typing import NDArray

from kinebench_drake.environment import native
from kinebench_drake.io.atomic import atomic_folder, disk_errors
from kinebench_drake.io.files import cache_folder
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.models.panda.cad import simplify
from kinebench_drake.models.panda.description import ARM, LINK_OF

_VERSION = b"1"  # of shaders and meshes; increment it with every change to invalidate caches
_SHADOW = """float ShadowMapPCF(
    sampler2D depths, vec3 point, float resolution, float texel, float spacing)
{
  vec2 part = fract(point.xy * resolution + 0.5f);
  float lit = 0.0f;
  for (int y = -2; y <= 2; y += 2) {
    vec2 row = vec2(y == -2 ? 1.0f - part.y : 1.0f, y == 2 ? part.y : 1.0f);
    for (int x = -2; x <= 2; x += 2) {
      vec2 column = vec2(x == -2 ? 1.0f - part.x : 1.0f, x == 2 ? part.x : 1.0f);
      vec4 free = step(point.z, textureGather(depths, point.xy + spacing * texel * vec2(x, y)));
      lit += dot(free, vec4(column.xyy * row.yyx, column.x * row.x));
    }
  }
  return lit / 25.0f;
}"""  # weights of the gathered texels, (0, 1), (1, 1), (1, 0), (0, 0): sums of those of 25 bilinear squares
_SHADOW_PATTERN = re.compile(r"float ShadowMapPCF\(.*?\n}", re.DOTALL)
_ENVIRONMENT_PATTERN = re.compile(r"  color \+= (diffuse|specular)IBL\(.*?\);\n", re.DOTALL)
_INWARDS = 0.1
"""Share of the way from a corner to the middle of its triangle, where its normal is looked up."""


def software_shaders() -> ShaderConfig:
    """Return ManiSkill's "minimal" shaders without needless work, for scenes without an environment map.

    Where SAPIEN's files are not as expected they stay as they are.
    """
    minimal = PREBUILT_SHADER_CONFIGS["minimal"]
    set_shader_pack(minimal)  # it sets the formats of the images, which another scene of the process may have changed
    pack = _lean_pack()
    return minimal if pack is None else replace(minimal, shader_pack=str(pack))


@cache
def _lean_pack() -> Path | None:
    """Return the folder of the shaders, written once into the cache folder; None where SAPIEN's are not as expected."""
    packs = Path(sapien.__file__).parent / "vulkan_shader"
    sources = (path for name in ("common", "minimal") for path in sorted((packs / name).iterdir()))
    files = {path.relative_to(packs): path.read_text() for path in sources}
    shadow = Path("common/shadow.glsl")
    color = Path("minimal/gbuffer.frag")
    if "PCF_SampleCount = 25;" not in files.get(shadow, "") or color not in files:
        return None
    files[shadow] = _SHADOW_PATTERN.sub(_SHADOW, files[shadow])
    files[color] = _ENVIRONMENT_PATTERN.sub("", files[color])
    digest = hashlib.sha256("".join(files.values()).encode()).hexdigest()[:16]
    folder = cache_folder() / f"shaders-{digest}"
    if not folder.is_dir():
        with disk_errors(folder.name), atomic_folder(folder) as work:
            for name, text in files.items():
                (work / name).parent.mkdir(exist_ok=True)
                (work / name).write_text(text)
    return folder / color.parent


def simplify_arm(robot: Any) -> None:
    """Replace the visual meshes of a ManiSkill Panda's arm; hand and fingers, which are measured, keep theirs.

    Meshes are simplified once into the cache folder.
    """
    for part in ARM:
        for link in robot.links_map[LINK_OF[part]]._objs:
            full = link.entity.find_component_by_type(sapien.render.RenderBodyComponent)
            body = sapien.render.RenderBodyComponent()
            body.name = full.name
            for shape in full.render_shapes:
                for (corners, normals), source in zip(_surfaces(shape.filename), shape.parts, strict=True):
                    mesh = sapien.render.RenderShapeTriangleMesh(
                        corners * np.float32(shape.scale),
                        np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
                        normals,
                        np.zeros((0, 2), dtype=np.float32),
                        source.material,
                    )
                    mesh.local_pose = shape.local_pose
                    body.attach(mesh)
            link.entity.remove_component(full)
            link.entity.add_component(body)


@cache
def _surfaces(file: str) -> tuple[NDArray[np.float32], ...]:
    """Return the simplified surfaces of a mesh file, one a material, from the cache folder if they are there.

    Each is (2, 3 N, 3): corners of one triangle after the other, and the unit normals there.
    """
    digest = hashlib.sha256(_VERSION + Path(file).read_bytes()).hexdigest()[:16]
    path = cache_folder() / f"visuals-{Path(file).stem}-{digest}.npz"
    if not path.is_file():
        parts = sapien.render.RenderShapeTriangleMesh(file).parts
        surfaces = [_simplify(part.vertices, part.triangles.reshape(-1, 3), part.get_vertex_normal()) for part in parts]
        write_arrays(path, {f"part_{k}": surface for k, surface in enumerate(surfaces)})
    with np.load(path, allow_pickle=False) as stored:
        return tuple(stored[name] for name in stored.files)


def _simplify(
    vertices: NDArray[np.float32], triangles: NDArray[np.uint32], normals: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Simplify a mesh to a quarter of its triangles; normals are those of the original at the nearest point."""
    points, faces = simplify(
        vertices.astype(np.float64),
        triangles.astype(np.int32),
        int(0.25 * len(triangles)),  # of the triangles that are kept: surfaces move by 0.1 mm at most places
        border_weight=10.0,  # of the borders between two materials, against gaps
    )
    corners = points[faces]  # (N, 3, 3)
    inside = corners + _INWARDS * (corners.mean(axis=1, keepdims=True) - corners)
    o3d = native.load_open3d()
    original = o3d.t.geometry.RaycastingScene()
    original.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles))
    nearest = original.compute_closest_points(o3d.core.Tensor(inside.reshape(-1, 3).astype(np.float32)))
    uv = nearest["primitive_uvs"].numpy()
    weights = np.column_stack([1.0 - uv.sum(axis=1), uv])
    normal = (normals[triangles[nearest["primitive_ids"].numpy()]] * weights[:, :, None]).sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([corners.reshape(-1, 3), normal]).astype(np.float32)
