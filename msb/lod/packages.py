"""Folders for simulators, with the mass properties of the asset; z is up, the unit is metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from msb.base.own_folder import own_folder
from msb.delivery.surface_distance import Floats, Ints
from msb.errors import MeshError
from msb.lod.isaac import list_isaac_files
from msb.lod.mujoco import list_mujoco_files
from msb.lod.quality import read_lit
from msb.lod.report import Report
from msb.meshes.gltf import open_document
from msb.meshes.gltf_scene import read_scene
from msb.meshes.mesh import Mesh
from msb.meshes.source import Source
from msb.meshes.transform import rotate_axis
from msb.meshes.writing import as_float32

if TYPE_CHECKING:
    from msb.lod.run import Lods

# Density of water, in kg per cubic metre.
_DENSITY = 1000.0


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body, with z up and in metres.

    Attributes
    ----------
    name : str
    mesh, shown : Mesh
        The visible mesh, and the same with light in its colours.
    parts : list of Mesh
        The collision shape.
    is_convex : bool
        Whether the parts are convex.
    mass : float
        In kg.
    center : (3,) float64
        The centre of mass.
    inertia : (3, 3) float64
        About the centre of mass, in kg m^2.
    source : str
        The name of the original file.
    label : str
    """

    name: str
    mesh: Mesh
    shown: Mesh
    parts: list[Mesh]
    is_convex: bool
    mass: float
    center: Floats
    inertia: Floats
    source: str
    label: str


def write_package(lods: Lods, folder: Path, overwrite: bool) -> Report:
    """Write the folder for mujoco or isaac; return the report with its main file.

    Raises
    ------
    MeshError
        MESH_ARRAY: the collision shape has no volume, so that the body has no mass.
    """
    body = _make_body(lods, folder.name)
    is_mujoco = lods.options.target == "mujoco"
    files: Mapping[str, bytes] = (list_mujoco_files if is_mujoco else list_isaac_files)(body)
    with own_folder(folder, overwrite=overwrite) as new:
        for name, content in files.items():
            (new / name).parent.mkdir(parents=True, exist_ok=True)
            (new / name).write_bytes(content)
    main = folder / next(iter(files))
    return lods.report.with_outputs(main, [], main)


def _make_body(lods: Lods, name: str) -> Body:
    assert lods.shape is not None
    document = open_document(Source("asset.glb", lods.glb))
    mesh, shown = _turn(read_scene(document)), _turn(read_lit(document))
    parts = [
        _turn(Mesh(as_float32(points, "the package"), faces, up="+y")) for points, faces in lods.shape.parts
    ]
    volume, center, inertia = measure_mass([(part.vertices.astype(float), part.faces) for part in parts])
    if not volume > 0:
        text = "the collision shape has no volume, so the body has no mass; use hulls:N or box"
        raise MeshError("MESH_ARRAY", text)
    options = lods.options
    mass = options.mass or volume * (options.density or _DENSITY)
    is_convex = lods.shape.report.kind != "mesh"
    label = options.label or name
    return Body(
        name, mesh, shown, parts, is_convex, mass, center, inertia * mass / volume, lods.source, label
    )


def _turn(mesh: Mesh) -> Mesh:
    """Return a mesh with z up instead of y."""
    return replace(mesh, vertices=rotate_axis(mesh.vertices, "+y", "+z"), up="+z")


def measure_mass(parts: list[tuple[Floats, Ints]]) -> tuple[float, Floats, Floats]:
    """Return the volume, the centre (3,) and the inertia (3, 3) about it, of solids of density 1.

    The integrals are sums over the tetrahedra of the origin and each face (a, b, c), with the determinant d
    of its corners: volume d / 6, first moment d (a + b + c) / 24, second moment
    d (s s^T + a a^T + b b^T + c c^T) / 120 with s = a + b + c (Blow and Binstock, "How to find the inertia
    tensor of a 3D solid body", 2004).
    """
    a, b, c = np.concatenate([points[faces] for points, faces in parts]).transpose(1, 0, 2)
    # Relative to the middle, so that nothing cancels far away from the origin.
    middle = a.mean(axis=0)
    a, b, c = a - middle, b - middle, c - middle
    d = np.einsum("ni,ni->n", a, np.cross(b, c))
    volume = float(d.sum() / 6)
    if not volume > 0:
        return 0.0, middle, np.zeros((3, 3))
    total = a + b + c
    center = d @ total / 24 / volume
    second = sum(np.einsum("n,ni,nj->ij", d, v, v) for v in (total, a, b, c)) / 120
    second = second - volume * np.outer(center, center)
    return volume, middle + center, np.trace(second) * np.eye(3) - second
