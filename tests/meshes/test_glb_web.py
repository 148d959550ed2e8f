"""Web GLB files read back as the same mesh in another order, within the requested precision."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset.texture import Sampler
from msb.base import extras
from msb.errors import UsageError
from msb.meshes import Mesh, read_mesh, write_mesh
from msb.meshes.assets import fit_to_format
from msb.meshes.formats import Style, Web
from msb.meshes.glb_web import Grid

from .test_glb_write import CORNERS, FACES, UVS, opened

SIDE = 40


def wavy() -> Mesh:
    """Return a sheet with a hole, a flipped face, a duplicate face, an unused vertex and dark colours."""
    x, y = (axis.ravel() for axis in np.mgrid[:SIDE, :SIDE])
    corner = (x * SIDE + y).reshape(SIDE, SIDE)
    low, right, up = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[:-1, 1:].ravel()
    faces = np.stack((low, right, up), 1)
    faces = np.concatenate((faces, np.stack((up, right, corner[1:, 1:].ravel()), 1)))
    faces[7] = faces[7, ::-1]
    faces = np.concatenate((np.delete(faces, [500, 501, 502], 0), faces[:1]))
    vertices = np.stack((x, y, np.sin(x / 5) * np.cos(y / 7)), 1) - 17.3
    colors = np.stack((x * 6, y * 6, 0 * x + 9), 1).astype(np.uint8)
    unused = np.full((1, 3), 3.0)
    vertices = np.concatenate((vertices, unused)).astype(np.float32)
    return Mesh(vertices, faces.astype(np.int64), np.concatenate((colors, colors[:1])))


def corners_of(mesh: Mesh) -> Any:
    """Return the positions and colours of all corners, in an order that is independent of the row numbers."""
    levels = mesh.vertex_colors[:, :3] * (1.0 if mesh.vertex_colors.dtype == np.uint8 else 255.0)
    values = np.concatenate((mesh.vertices[mesh.faces], levels[mesh.faces]), axis=2)
    first = values[..., 0] * 1e4 + values[..., 1] * 1e2 + values[..., 2]
    turned = np.take_along_axis(
        values, (first.argmin(1)[:, None] + np.arange(3))[..., None] % 3, axis=1
    ).reshape(len(values), -1)
    return turned[np.lexsort(np.round(turned, 1).T[::-1])]


@pytest.mark.slow
@pytest.mark.parametrize(("web", "levels"), [(Web(56, None), 6), (Web(80, 1.0), 1)])
def test_the_audit_is_unchanged_and_errors_are_bounded(web: Web, levels: int, tmp_path: Path) -> None:
    mesh, files = wavy(), [tmp_path / "plain.glb", tmp_path / "web.glb"]
    write_mesh(mesh, files[0], suffix=".glb")
    write_mesh(mesh, files[1], suffix=".glb", style=Style(web=web))
    assert files[1].stat().st_size < files[0].stat().st_size * 0.5
    assert msb.audit(files[0]).counts == msb.audit(files[1]).counts
    plain, again = (corners_of(read_mesh(file)) for file in files)
    step = 64 / 2 ** (web.quarters // 4)
    assert np.abs(plain - again).reshape(-1, 3, 6)[..., :3].max() <= step / 2 + 1e-6
    assert np.abs(plain - again).reshape(-1, 3, 6)[..., 3:].max() <= levels + 0.05
    root = opened(files[1].read_bytes())[0]
    short = ["KHR_mesh_quantization"] if web.quarters < 64 else []
    assert root["extensionsRequired"] == ["EXT_meshopt_compression", *short]


def soup() -> Mesh:
    """Return the sheet as a triangle soup with uniform face colours and some distant faces."""
    mesh = wavy()
    vertices = mesh.vertices[mesh.faces]
    vertices[::9] *= 20
    colors = np.repeat(mesh.vertex_colors[mesh.faces[:, 0]], 3, axis=0)
    return Mesh(vertices.reshape(-1, 3), np.arange(3 * len(vertices)).reshape(-1, 3), colors)


@pytest.mark.slow
def test_a_soup_has_no_indices_and_a_finer_grid_near_its_centre(tmp_path: Path) -> None:
    mesh = soup()
    write_mesh(mesh, tmp_path / "plain.glb", suffix=".glb")
    for by_distance in (False, True):
        path = tmp_path / f"{by_distance}.glb"
        write_mesh(mesh, path, suffix=".glb", style=Style(web=Web(76, by_distance=by_distance)))
        assert "indices" not in opened(path.read_bytes())[0]["meshes"][0]["primitives"][0]
        # Rounding can separate vertices at one place, which are seams of the plain file.
        counts = [msb.audit(file).counts for file in (path, tmp_path / "plain.glb")]
        assert replace(counts[0], seam_vertices=0) == replace(counts[1], seam_vertices=0)
        again, grid = read_mesh(path), Grid.of(mesh, Web(76, by_distance=by_distance))
        vertices = np.sort(again.vertices.astype(np.float32).view("f4,f4,f4"), axis=0)
        assert np.array_equal(vertices, np.sort(grid.positions.view("f4,f4,f4"), axis=0))
        error = np.abs(grid.positions - mesh.vertices).max(axis=1)
        step = grid.step * 2.0**grid.exponents
        assert (error <= step / 2 + 1e-4 * grid.step).all()
        assert bool(grid.exponents.any()) == by_distance
    far = np.linalg.norm(mesh.vertices - np.median(mesh.vertices, axis=0), axis=1) > 200
    assert step[far].min() > step[~far].min()


def test_web_textures_are_webp_and_uvs_are_precise_to_a_sixteenth_of_a_texel(tmp_path: Path) -> None:
    ramp = np.arange(0, 256, 8, dtype=np.uint8)[:, None, None].repeat(16, 1).repeat(3, 2)
    textures = np.array([1, 0, 1], np.uint32)
    mesh = Mesh(
        CORNERS, FACES, corner_uvs=UVS, textures=(ramp, ramp[::-1]), face_textures=textures, sampler=Sampler()
    )
    write_mesh(mesh, tmp_path / "a.glb", suffix=".glb", style=Style(texture="webp", web=Web()))
    again = read_mesh(tmp_path / "a.glb")
    assert len(again.textures) == 2
    for texture, image in enumerate(mesh.textures):
        faces = again.faces[again.face_textures == texture]
        assert np.abs(again.textures[texture].astype(int) - image).max() < 8
        uvs = again.vertex_uvs[faces].reshape(-1, 2)
        expected = mesh.corner_uvs.reshape(3, 3, 2)[textures == texture].reshape(-1, 2)
        near = np.abs(uvs[:, None] - expected).max(axis=2).min(axis=0)
        assert (near < 1 / 32 / 16).all()


@pytest.mark.parametrize("most", [255.9, 255.99998, 256.0, 511.99997, 3000.0])
def test_large_tiled_uvs_do_not_overflow(most: float, tmp_path: Path) -> None:
    image = np.zeros((16, 4096, 3), np.uint8)
    mesh = Mesh(CORNERS, FACES, corner_uvs=UVS * np.float32(most), textures=(image,), sampler=Sampler())
    write_mesh(fit_to_format(mesh, ".glb"), tmp_path / "a.glb", suffix=".glb", style=Style(web=Web()))
    again = read_mesh(tmp_path / "a.glb").vertex_uvs
    assert again is not None
    assert abs(again.max() - mesh.corner_uvs.max()) <= most * 2**-22


def test_a_missing_extra_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    with pytest.raises(UsageError, match=r"EXTRA_MISSING: .*\[compressed\]"):
        write_mesh(wavy(), tmp_path / "a.glb", suffix=".glb", style=Style(web=Web()))
