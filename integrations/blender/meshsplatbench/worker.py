# SPDX-License-Identifier: GPL-3.0-or-later
"""What runs beside Blender, in a process with the package meshsplatbench: it opens, audits and saves models.

``worker.py read MODEL ANSWER.npz``, ``audit MESH.npz ANSWER.npz`` or ``save MESH.npz MODEL``. A mesh of F
triangles is passed as arrays: `vertices` (V, 3); `faces` (F, 3); `colors` (3F, 4), sRGB, but linear light
where there are textures; `uvs` (3F, 2) with v upwards; `texture.N` (H, W, 4), linear light as floats or sRGB
as bytes, whose row 0 is the lowest; `face_texture` (F,); and `about`, the rest as JSON. `boundary` and
`nonmanifold` (n, 2) are edges by what `number` (V,) says of their vertices.
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
from msb.asset.texture import Sampler, decoded, encoded, linear_to_srgb, srgb_to_linear
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset, with_corner_colors
from msb.meshes.transform import turned
from msb.topology import audit_arrays
from msb.topology.elements import find_elements
from msb.topology.seams import find_seams

Arrays = dict[str, NDArray[Any]]
COUNTS = ("vertices", "faces", "components", "boundary_edges", "nonmanifold_edges")
"""The counts of an audit that the panel shows."""


def read(path: str) -> tuple[Arrays, dict[str, Any]]:
    """Return the standard-tier mesh of what lies at `path`, with its audit."""
    asset = msb.open(path)
    mesh, up = mesh_from_asset(asset), up_axis(asset)  # that of the mesh may be None: not known
    arrays: Arrays = {"vertices": mesh.vertices, "faces": mesh.faces}
    about: dict[str, Any] = {"method": asset.manifest.method, "up": mesh.up, "bytes": False}
    about["turn"] = turned(np.eye(3), up, "+z").T.tolist()
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
            arrays[f"texture.{number}"] = decoded(image[::-1])
    return audited(asset_from_mesh(mesh), arrays, about)


def audited(asset: msb.Asset, arrays: Arrays, about: dict[str, Any]) -> tuple[Arrays, dict[str, Any]]:
    """Return `arrays` and `about` with the verdict on `asset`, and the counts and edges of what it judges.

    That is the mesh without its seams, where the vertex v of the file is `number` (V,)[v].
    """
    mesh = stored_mesh(asset)
    report, analysis = audit_stored(mesh)
    arrays["number"] = np.arange(len(mesh.vertices))
    if report.seams and (seams := find_seams(mesh.vertices, mesh.faces, mesh.attributes)):
        arrays["number"] = seams.number
        _, analysis = audit_arrays(mesh.vertices[seams.first], seams.merged(mesh.faces))
    judged = report.without_seams or report
    counts = {name: getattr(judged.counts, name) for name in COUNTS}
    about["audit"] = {"level": report.verdict, "sentence": report.sentence, "counts": counts}
    found = {group.kind: group.vertices for group in find_elements(analysis).groups}
    for name in ("boundary", "nonmanifold"):
        arrays[name] = np.asarray(found.get(f"{name}_edges", np.zeros((0, 2))), np.int64)
    return arrays, about


def made(path: str) -> tuple[msb.Asset, Arrays, dict[str, Any]]:
    """Return the mesh that Blender wrote to `path` as an asset, and what it was made of."""
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays.pop("about")))
    names = [f"texture.{number}" for number in range(len(arrays)) if f"texture.{number}" in arrays]
    mesh = Mesh(arrays["vertices"], arrays["faces"], up=about["up"])
    if names:
        mesh = replace(
            mesh,
            corner_uvs=np.float32([0, 1]) + np.float32([1, -1]) * arrays["uvs"],
            textures=tuple(texels(arrays[name][::-1]) for name in names),
            face_textures=arrays["face_texture"] if len(names) > 1 else None,
            sampler=Sampler.of(about["sampler"]) if "sampler" in about else Sampler(),
        )
    if "colors" in arrays:
        colors = arrays["colors"] if (arrays["colors"][:, 3] < 1).any() else arrays["colors"][:, :3]
        if names:
            colors = np.c_[linear_to_srgb(colors[:, :3]), colors[:, 3:]]
        mesh = colored(mesh, np.round(255 * colors).astype(np.uint8) if about["bytes"] else colors)
    return asset_from_mesh(mesh), arrays, about


def texels(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return `image`, linear light as floats or sRGB as bytes, as bytes; full alpha is left out."""
    values = image if image.dtype == np.uint8 else encoded(np.clip(image, 0, 1), 4)
    return np.ascontiguousarray(values if (values[..., 3] < 255).any() else values[..., :3])


def colored(mesh: Mesh, colors: NDArray[Any]) -> Mesh:
    """Return `mesh` with `colors` (3F, 3 | 4) of its corners; vertices are doubled where they differ."""
    corners = mesh.faces.reshape(-1)
    at_vertices = np.zeros((len(mesh.vertices), colors.shape[1]), colors.dtype)
    at_vertices[corners] = colors
    if (at_vertices[corners] == colors).all():
        return replace(mesh, vertex_colors=at_vertices)
    return with_corner_colors(mesh, colors)


def main(verb: str, source: str, target: str) -> None:
    """Do what `verb` says."""
    if verb == "save":
        msb.save(made(source)[0], target, overwrite=True)
        return
    arrays, about = read(source) if verb == "read" else audited(*made(source))
    with Path(target).open("wb") as file:
        np.savez(file, about=np.array(json.dumps(about)), **arrays)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except msb.MsbError as error:
        sys.exit(str(error))
