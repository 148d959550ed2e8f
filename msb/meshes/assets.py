"""Convert meshes to assets, and assets to standard-tier meshes."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset, Description, build_asset
from msb.asset.drawable import first_bad
from msb.asset.finite import select_vertices
from msb.asset.frame import frame_of
from msb.asset.look import stored_threshold, tint_of, visible_faces, written_up
from msb.asset.manifest import CoordinateFrame, Domain, Parameters
from msb.asset.origin import world_positions
from msb.asset.texture import Sampler, is_textured, texture_images
from msb.asset.tiers import refusal, reject_gaussians
from msb.base.origin import Origin, find_origin, to_local, to_world
from msb.base.seam_keys import SEAM_KEY, hash_attributes
from msb.errors import AssetError, Unsupported
from msb.meshes.charts import with_sampled_colors, with_vertex_uvs, without_textures
from msb.meshes.formats import FORMATS
from msb.meshes.mesh import Mesh
from msb.meshes.placement import place
from msb.meshes.transform import rotate_axis
from msb.meshes.writing import as_float32, as_local, check_indices, check_writable


class MeshBuffers(NamedTuple):
    """The asset buffers of a mesh, the domains of the buffers, the appearance for the manifest, and the
    origin."""

    buffers: dict[str, NDArray[Any]]
    domains: dict[str, Domain]
    appearance: Parameters
    origin: Origin


def asset_from_mesh(mesh: Mesh, *, origin: Origin | None = None) -> Asset:
    """Convert `mesh` to an asset of method "mesh", with float32 positions and the colours as stored.

    The positions are relative to `origin`. Default: zero, unless the mesh needs an origin (`find_origin`).
    """
    made = make_mesh_buffers(mesh, origin)
    frame = CoordinateFrame(up=mesh.up or "unknown")
    description = Description(
        appearance=made.appearance, coordinate_frame=frame, origin=made.origin, frame=mesh.frame
    )
    return build_asset(made.buffers, made.domains, description)


def make_mesh_buffers(mesh: Mesh, origin: Origin | None = None) -> MeshBuffers:
    """Return the asset buffers of `mesh`. See `asset_from_mesh`.

    Vertex colours take precedence over face colours. Textures are kept with their coordinates.
    """
    check_indices(mesh)
    origin = find_origin(mesh.vertices) if origin is None else origin
    positions = to_local(mesh.vertices, origin)
    overflow = np.isinf(positions) & np.isfinite(mesh.vertices)
    if overflow.any():
        row = int(np.argmax(overflow.any(axis=1)))
        text = (
            f"vertex {row} is {mesh.vertices[row].tolist()}; assets store float32 coordinates, up to 3.4e38"
        )
        raise AssetError("TRIASSET_VALUE_NONFINITE", text, pointer=f"positions[{row}]")
    buffers: dict[str, NDArray[Any]] = {"positions": positions, "indices": mesh.faces.astype(np.uint32)}
    domains: dict[str, Domain] = {}
    appearance: Parameters = {"kind": "none"}
    for colors, domain in ((mesh.vertex_colors, "vertex"), (mesh.face_colors, "face")):
        if colors is not None and not domains:
            buffers["color"], appearance = colors, {"kind": "static_color"}
            domains["color"] = domain  # type: ignore[assignment]
    if mesh.textures:
        appearance = mesh.sampler.appearance
        by_vertex = mesh.corner_uvs is None
        buffers["uv"] = mesh.vertex_uvs if by_vertex else mesh.corner_uvs  # type: ignore[assignment]
        domains["uv"] = "vertex" if by_vertex else "corner"
        _check_uvs(mesh)
        for number, image in enumerate(mesh.textures):
            buffers[f"texture.{number}"], domains[f"texture.{number}"] = image, "global"
        if len(mesh.textures) > 1:
            assert mesh.face_textures is not None
            buffers["face_texture"], domains["face_texture"] = mesh.face_textures, "face"
    for keys, domain in ((mesh.vertex_keys, "vertex"), (mesh.corner_keys, "corner")):
        if keys is not None and SEAM_KEY not in buffers and _needs_keys(positions, buffers, domains):
            buffers[SEAM_KEY], domains[SEAM_KEY] = keys, domain  # type: ignore[assignment]
    return MeshBuffers(buffers, domains, appearance, origin)


def _needs_keys(
    positions: NDArray[np.float32], buffers: dict[str, NDArray[Any]], domains: dict[str, Domain]
) -> bool:
    """Return whether two vertices have equal positions and attributes."""
    stored = [buffers[name] for name, domain in domains.items() if domain == "vertex"]
    rows = hash_attributes([positions, *stored])
    return len(np.unique(rows)) < len(rows)


def _check_uvs(mesh: Mesh) -> None:
    """Raise TRIASSET_VALUE_NONFINITE if a texture coordinate is not finite."""
    uvs = mesh.vertex_uvs if mesh.corner_uvs is None else mesh.corner_uvs
    if mesh.textures and uvs is not None and (at := first_bad(uvs)) is not None:
        text = f"texture coordinate {at[0]} is {uvs[at[0]].tolist()}; it must be finite"
        raise AssetError("TRIASSET_VALUE_NONFINITE", text, pointer=f"uv[{at[0]}]")


def mesh_from_asset(asset: Asset) -> Mesh:
    """Return the standard-tier mesh of `asset`: opaque, with static colours.

    `msb.asset.look` computes the colours. An asset without colours gives a mesh without colours. Corner
    colours, and the face colours of a triangle soup, become vertex colours. A vertex is split if its corners
    have different colours. Textures are kept. Faces with an opacity below the asset's STE threshold are
    removed. Coordinates are float32, or float64 if the asset has an origin.

    Raises
    ------
    Unsupported
        `UNSUPPORTED_TIER`: the method has no static colours. `UNSUPPORTED_METHOD`: the method has no
        triangles.
    """
    reject_gaussians(asset.manifest.primitive, asset.opened_from)
    text = refusal(asset.manifest, "standard")
    if text is not None:
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.opened_from)
    vertices, up = world_positions(asset), written_up(asset)
    faces = asset.buffers["indices"].astype(np.int64)
    mesh, colors = Mesh(vertices, faces, up=up, frame=frame_of(asset.manifest)), tint_of(asset)
    if is_textured(asset):
        mesh = _with_textures(mesh, asset)
    if colors is not None and colors.domain == "vertex":
        mesh = replace(mesh, vertex_colors=colors.values)
    elif colors is not None and colors.domain == "corner":
        mesh = with_corner_colors(mesh, colors.values)
    elif colors is not None and asset.manifest.topology == "triangle_soup":
        mesh = replace(mesh, vertex_colors=np.repeat(colors.values, 3, axis=0))
    elif colors is not None:
        mesh = replace(mesh, face_colors=colors.values)
    keep = visible_faces(asset, stored_threshold(asset))
    return mesh if keep is None or keep.all() else with_faces(mesh, keep)


def _with_textures(mesh: Mesh, asset: Asset) -> Mesh:
    """Return `mesh` with the textures of `asset`. The mesh and the asset have the same vertices and faces."""
    uv, manifest = asset.buffers["uv"], asset.manifest
    by_vertex = manifest.buffers["uv"].domain == "vertex"
    return replace(
        mesh,
        vertex_uvs=uv if by_vertex else None,
        corner_uvs=None if by_vertex else uv,
        textures=texture_images(asset.buffers),
        face_textures=asset.buffers.get("face_texture"),
        sampler=Sampler.of(manifest.appearance),
    )


def align_baked(baked: Asset, asset: Asset) -> Asset:
    """Convert a mesh that was baked from `asset` to the coordinates and the origin of `asset`.

    Files of baked meshes are rotated so that +y is up, because their formats require this axis. This function
    undoes the rotation of the vertices.
    """
    mesh, up = mesh_from_asset(baked), written_up(asset)
    vertices = rotate_axis(mesh.vertices, mesh.up or "unknown", up or "unknown")
    return asset_from_mesh(replace(mesh, vertices=vertices, up=up), origin=asset.manifest.origin)


def with_vertex_colors(mesh: Mesh) -> Mesh:
    """Return `mesh` with vertex colours instead of face colours. Some formats have no face colours.

    A vertex is split if its faces have different colours.
    """
    if mesh.face_colors is None or mesh.vertex_colors is not None:
        return mesh
    return with_corner_colors(mesh, np.repeat(mesh.face_colors, 3, axis=0))


def fit_to_format(mesh: Mesh, suffix: str, *, is_upright: bool = False) -> Mesh:
    """Return `mesh` reduced to the data that files of `suffix` can store.

    Colours and UVs are moved to the elements for which the format stores them, usually vertices. Textures
    become vertex colours if the format has no textures. The mesh is in metres if its unit is known. A mesh
    with a known up axis is rotated so that +y is up. The rotation requires a format with an up axis, or
    `is_upright`. If the format cannot share vertices between faces, every face gets three separate vertices.
    Coordinates are rounded to the precision of the format.
    """
    mesh = replace(mesh, vertex_keys=None, corner_keys=None)  # files are written without these attributes
    form = FORMATS[suffix]
    check_writable(mesh)
    if form.keeps:
        _check_uvs(mesh)
    if "textures" not in form.keeps:
        mesh = with_sampled_colors(mesh) if form.keeps else without_textures(mesh)
    if not (form.is_soup or "face_colors" in form.keeps):
        mesh = with_vertex_colors(mesh)
    if "vertex_uvs" in form.keeps:
        mesh = with_vertex_uvs(mesh)
    mesh = place(mesh, is_upright=is_upright or form.up is not None)
    if form.is_soup and len(mesh.vertices) != 3 * len(mesh.faces):
        mesh = _separate_faces(mesh)
    if not form.is_single:
        return mesh
    if form.has_origin:
        return replace(mesh, vertices=to_world(*as_local(mesh.vertices, form.title)))
    return replace(mesh, vertices=as_float32(mesh.vertices, form.title))


def with_faces(mesh: Mesh, keep: NDArray[np.bool_]) -> Mesh:
    """Return `mesh` with the faces in the mask `keep` (F,) and the vertices of these faces, in the same
    order."""
    faces = mesh.faces[keep]
    used = np.zeros(len(mesh.vertices), bool)
    used[faces] = True
    number = np.cumsum(used) - 1
    return mesh.select(used, keep, number[faces])


def without_bad_faces(mesh: Mesh) -> tuple[Mesh, int]:
    """Remove faces with a non-finite coordinate. Return the mesh and the number of removed faces.

    Non-finite vertices are removed as well. A mesh without any finite face, or with invalid indices, is
    returned unchanged, because writers reject it.
    """
    is_bad = ~np.isfinite(mesh.vertices).all(axis=1)
    is_invalid = ((mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))).any()
    if not is_bad.any() or is_invalid:
        return mesh, 0
    keep = ~is_bad[mesh.faces].any(axis=1)
    if not keep.any():
        return mesh, 0
    vertices, numbers = select_vertices(mesh.vertices, mesh.faces, keep)
    return mesh.select(vertices, keep, numbers[mesh.faces[keep]]), int(np.count_nonzero(~keep))


def with_corner_colors(mesh: Mesh, colors: NDArray[Any]) -> Mesh:
    """Return `mesh` with the corner colours `colors` (3F, 3 | 4) as vertex colours.

    A vertex is split if its corners have different colours. Vertices keep their order. Unused vertices are
    removed.
    """
    # Sort the 3F corners by vertex and by the bits of their colour. A new vertex begins at each sorted corner
    # that is not equal to the previous corner.
    corners = mesh.faces.reshape(-1)
    keys = (*np.ascontiguousarray(colors).view(np.uint8 if colors.itemsize == 1 else np.uint32).T, corners)
    order = np.lexsort(keys)
    differs = np.ones(len(order), bool)
    differs[1:] = np.logical_or.reduce([key[order[1:]] != key[order[:-1]] for key in keys])
    # `number` (3F,) is the new vertex of each corner, and `first` (n,) is one corner of each new vertex.
    number = np.zeros_like(corners)
    number[order] = np.cumsum(differs) - 1
    first = order[differs]
    mesh = mesh.select(corners[first], slice(None), number.reshape(-1, 3))
    return replace(mesh, vertex_colors=colors[first], face_colors=None)


def _separate_faces(mesh: Mesh) -> Mesh:
    """Return the triangle soup of `mesh`: three vertices per face, without colours and textures."""
    corners = mesh.faces.reshape(-1)
    faces = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
    return Mesh(mesh.vertices[corners], faces, up=mesh.up, placement=mesh.placement)
