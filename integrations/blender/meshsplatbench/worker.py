# SPDX-License-Identifier: GPL-3.0-or-later
"""A program that runs beside Blender and opens, audits and saves models with the package meshsplatbench.

Usage: ``worker.py read MODEL ANSWER.npz``, ``audit MESH.npz ANSWER.npz`` or ``save MESH.npz MODEL``. A mesh
of V vertices and F triangles is passed as arrays:

- `vertices` (V, 3) and `faces` (F, 3)
- `colors` (3F, 4) of the corners: sRGB, or linear light if there are textures
- `uvs` (3F, 2) of the corners, v upwards
- `texture.N` (H, W, 4), the lowest row first: linear light as floats, or sRGB as bytes
- `face_texture` (F,), the number N of each face's texture
- `about`, further properties as JSON
- `number` (V,), only in an answer: the number of each vertex after vertices at the same position are merged
- `boundary` and `nonmanifold` (n, 2), only in an answer: edges as pairs of these numbers
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import msb
from msb.api.auditing import audit_stored
from msb.api.opening import stored_mesh
from msb.asset.look import lit_grey, up_axis
from msb.asset.origin import without_origin
from msb.asset.texture import Sampler, decode_texels, encode_texels, linear_to_srgb, srgb_to_linear
from msb.base.origin import NO_ORIGIN, to_world
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset, with_corner_colors
from msb.meshes.transform import rotate_axis
from msb.topology import audit_arrays
from msb.topology.elements import find_elements
from msb.topology.seams import find_seams

Arrays = dict[str, NDArray[Any]]
# The panel shows these counts of an audit.
COUNTS = ("vertices", "faces", "components", "boundary_edges", "nonmanifold_edges")


def read(path: str) -> tuple[Arrays, dict[str, Any]]:
    """Return the standard-tier mesh of the model at `path`, with its audit."""
    asset = msb.open(path)
    # Blender stores float32, so the object is placed at zero; `about` keeps the origin of the asset.
    mesh, up = mesh_from_asset(without_origin(asset)), up_axis(asset)  # `mesh.up` may be unknown (None)
    arrays: Arrays = {"vertices": mesh.vertices, "faces": mesh.faces}
    about: dict[str, Any] = {"method": asset.manifest.method, "up": mesh.up, "bytes": False}
    about["origin"] = list(asset.manifest.origin)
    about["turn"] = rotate_axis(np.eye(3), up, "+z").T.tolist()
    if mesh.vertex_colors is not None:
        colors = mesh.vertex_colors[mesh.faces.reshape(-1)]
    elif mesh.face_colors is not None:
        colors = np.repeat(mesh.face_colors, 3, axis=0)
    else:
        colors, about["grey"] = None, not mesh.textures
    if about.get("grey"):
        colors = np.repeat(lit_grey(mesh.vertices, mesh.faces, up), 3, axis=0)
    if colors is not None:
        about["bytes"] = colors.dtype == np.uint8
        arrays["colors"] = np.ones((len(colors), 4), np.float32)
        arrays["colors"][:, : colors.shape[1]] = colors / 255 if about["bytes"] else colors
        if mesh.textures:
            arrays["colors"][:, :3] = srgb_to_linear(arrays["colors"][:, :3])
    if mesh.textures:
        uvs = mesh.corner_uvs if mesh.vertex_uvs is None else mesh.vertex_uvs[mesh.faces.reshape(-1)]
        assert uvs is not None
        arrays["uvs"] = np.float32([0, 1]) + np.float32([1, -1]) * uvs
        about["sampler"] = mesh.sampler.appearance
        if mesh.face_textures is not None:
            arrays["face_texture"] = mesh.face_textures
        for number, image in enumerate(mesh.textures):
            arrays[f"texture.{number}"] = decode_texels(image[::-1])
    return audit(asset_from_mesh(mesh), arrays, about)


def audit(asset: msb.Asset, arrays: Arrays, about: dict[str, Any]) -> tuple[Arrays, dict[str, Any]]:
    """Add the audit of `asset` to `arrays` and `about`, and return both. The audit adds verdict, counts and
    marked edges.

    The audit ignores seams: vertices at the same position are merged. `number` (V,) has the number of the
    merged vertex for each vertex of the file.
    """
    mesh = stored_mesh(asset)
    report, analysis = audit_stored(mesh)
    arrays["number"] = np.arange(len(mesh.vertices))
    if report.seams and (seams := find_seams(mesh.vertices, mesh.faces, mesh.attributes)):
        arrays["number"] = seams.number
        _, analysis = audit_arrays(mesh.vertices[seams.first], seams.merged(mesh.faces))
    merged = report.without_seams or report
    counts = {name: getattr(merged.counts, name) for name in COUNTS}
    about["audit"] = {"level": report.verdict, "sentence": report.sentence, "counts": counts}
    elements = {group.kind: group.vertices for group in find_elements(analysis).groups}
    for name in ("boundary", "nonmanifold"):
        arrays[name] = np.asarray(elements.get(f"{name}_edges", np.zeros((0, 2))), np.int64)
    return arrays, about


def read_mesh_arrays(path: str) -> tuple[msb.Asset, Arrays, dict[str, Any]]:
    """Return the mesh that Blender wrote to `path`: as an asset, and its arrays and properties."""
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays.pop("about")))
    names = [f"texture.{number}" for number in range(len(arrays)) if f"texture.{number}" in arrays]
    vertices = to_world(arrays["vertices"], about.get("origin", NO_ORIGIN))
    mesh = Mesh(vertices, arrays["faces"], up=about["up"])
    if names:
        mesh = replace(
            mesh,
            corner_uvs=np.float32([0, 1]) + np.float32([1, -1]) * arrays["uvs"],
            textures=tuple(as_texture(arrays[name][::-1]) for name in names),
            face_textures=arrays["face_texture"] if len(names) > 1 else None,
            sampler=Sampler.of(about["sampler"]) if "sampler" in about else Sampler(),
        )
    if "colors" in arrays:
        colors = arrays["colors"] if (arrays["colors"][:, 3] < 1).any() else arrays["colors"][:, :3]
        if names:
            colors = np.c_[linear_to_srgb(colors[:, :3]), colors[:, 3:]]
        mesh = with_colors(mesh, np.round(255 * colors).astype(np.uint8) if about["bytes"] else colors)
    return asset_from_mesh(mesh), arrays, about


def as_texture(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image as sRGB bytes, without an alpha of 1. The input is linear floats or sRGB bytes."""
    values = image if image.dtype == np.uint8 else encode_texels(np.clip(image, 0, 1), 4)
    return np.ascontiguousarray(values if (values[..., 3] < 255).any() else values[..., :3])


def with_colors(mesh: Mesh, colors: NDArray[Any]) -> Mesh:
    """Return `mesh` with corner colours (3F, 3 or 4); vertices whose corners differ are duplicated."""
    corners = mesh.faces.reshape(-1)
    at_vertices = np.zeros((len(mesh.vertices), colors.shape[1]), colors.dtype)
    at_vertices[corners] = colors
    if (at_vertices[corners] == colors).all():
        return replace(mesh, vertex_colors=at_vertices)
    return with_corner_colors(mesh, colors)


def main(verb: str, source: str, target: str) -> None:
    """Read, audit or save a model."""
    if verb == "save":
        msb.save(read_mesh_arrays(source)[0], target, overwrite=True)
        return
    arrays, about = read(source) if verb == "read" else audit(*read_mesh_arrays(source))
    with Path(target).open("wb") as file:
        np.savez(file, about=np.array(json.dumps(about)), **arrays)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except msb.MsbError as error:
        sys.exit(str(error))
