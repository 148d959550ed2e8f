"""Images of a level of detail around the asset, lit so that lost shape shows, and their PSNR."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msb.errors import MeshFileError
from msb.meshes.assets import asset_from_mesh, without_bad_faces
from msb.meshes.colors import as_floats
from msb.meshes.gltf import Document, list_placed_meshes, parse_accessor, place_nodes
from msb.meshes.gltf_parts import parse_primitives, read_numbers
from msb.meshes.gltf_scene import read_scene
from msb.meshes.mesh import Mesh
from msb.meshes.normals import with_smooth_normals
from msb.scenes import Camera
from msb.scenes.around import make_turntable
from msb.views import render_standard

# Views around the asset: half of them look down, half of them look up. Size of an image in pixels, and
# samples per pixel along each axis.
VIEWS, _SIZE, _SAMPLES = 8, (480, 360), 2
_ELEVATIONS = (25.0, -15.0)
# The light: its direction, and the brightness of a surface that faces it or faces away.
_LIGHT, _BRIGHT, _DARK = np.array((0.4, 0.8, 0.45)), 1.0, 0.25
_BACKGROUND = (0.5, 0.5, 0.5)


def place_views(mesh: Mesh) -> list[Camera]:
    """Return the cameras around a mesh that all its levels are compared in."""
    asset = asset_from_mesh(mesh)
    rings = [
        make_turntable(asset, VIEWS // len(_ELEVATIONS), *_SIZE, elevation=height) for height in _ELEVATIONS
    ]
    return [camera for ring in rings for camera in ring]


def draw(mesh: Mesh, cameras: list[Camera], device: str | None = None) -> list[NDArray[np.float32]]:
    """Return the images of a lit mesh."""
    return render_standard(mesh, cameras, _BACKGROUND, device, _SAMPLES)


def read_lit(document: Document) -> Mesh:
    """Return the mesh of a document. Its vertex colours contain the light.

    The light follows the stored normals, so that a level with wrong normals differs in the images. Parts
    without normals get smooth ones.
    """
    mesh = read_scene(document)
    normals = _read_normals(document, len(mesh.vertices))
    mesh, _ = without_bad_faces(mesh) if not np.isfinite(mesh.vertices).all() else (mesh, 0)
    if normals is None or len(normals) != len(mesh.vertices):
        corner = with_smooth_normals(mesh).corner_normals
        assert corner is not None
        normals = np.zeros((len(mesh.vertices), 3))
        normals[mesh.faces.reshape(-1)] = corner
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    facing = (normals / np.maximum(length, 1e-12)) @ (_LIGHT / np.linalg.norm(_LIGHT))
    light = (_DARK + (_BRIGHT - _DARK) * (facing + 1) / 2).astype(np.float32)[:, None]
    if mesh.vertex_colors is None:
        return replace(mesh, vertex_colors=np.repeat(light, 3, axis=1))
    colors = as_floats(mesh.vertex_colors).copy()
    colors[:, :3] *= light
    return replace(mesh, vertex_colors=colors)


def _read_normals(document: Document, count: int) -> NDArray[np.float64] | None:
    """Return the normals (V, 3) of the vertices of `read_scene`; None unless all parts have them."""
    rows = []
    for placed, is_hidden in list_placed_meshes(document, place_nodes(document)):
        for primitive in () if is_hidden else parse_primitives(document, placed.mesh):
            number = primitive.entry["attributes"].get("NORMAL")
            if not isinstance(number, int):
                return None
            unpacked = document.packed.get(primitive.pointer, {}).get("NORMAL")
            try:
                stored = parse_accessor(
                    document, number, kinds="VEC3", components="i1 i2 f4", unpacked=unpacked
                )
            except MeshFileError:
                return None
            # Normals are transformed by the inverse transpose of the linear part; the cofactor matrix is a
            # multiple of it, also for a singular matrix.
            a, b, c = placed.world[:3, :3].T
            turn = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
            rows.append(read_numbers(stored) @ turn)
    normals: NDArray[np.float64] = np.concatenate(rows) if rows else np.zeros((0, 3))
    return normals if len(normals) == count else None
