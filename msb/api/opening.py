"""From a path to an asset, or to its mesh as stored: one rule for the library, the commands and the viewers.

An asset is recognised by its name or manifest, a checkpoint by its name or its folder's, a table of
primitives by its header; everything else is a mesh file.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from msb.asset import Asset, is_asset, load
from msb.asset.arguments import AN_ASSET, check_type
from msb.asset.texture import Sampler, is_textured
from msb.base.paths import PATH_TYPES, given_path
from msb.errors import CheckpointError, Finding, about
from msb.topology.seams import Attributes


def open(path: str | os.PathLike[str], *, method: str | None = None) -> Asset:
    """Return the model or mesh at `path` as an asset, whatever it is stored as.

    Parameters
    ----------
    path : path-like
        A `.triasset` (packed or folder), the output folder of a training or the file in it that holds the
        model, or a mesh file.
    method : str, optional
        The method that the model must be of; found from the content if not given.

    Returns
    -------
    Asset
        The asset that `load` or `export` gives. It holds float32 coordinates, also where a mesh file holds
        float64.

    Raises
    ------
    InputError, CheckpointError, MeshFileError, MeshError, AssetError, Unsupported, UsageError
        The errors of `load` and `export`; `CHECKPOINT_METHOD` if the model is of another method than
        `method`.

    Examples
    --------
    >>> import msb
    >>> msb.open("data_stubs/checkpoint")
    <Asset mesh_splatting: 5,159 faces, 2,582 vertices, indexed mesh, 227,156 bytes, data_stubs/checkpoint>
    """
    place = given_path(path)
    if not is_asset(place):
        from msb.adapters.exporter import export

        return export(place, method=method)
    asset = load(place)
    if method not in (None, asset.manifest.method):
        text = f"it holds a {asset.manifest.method} model; {method} is asked for"
        raise CheckpointError("CHECKPOINT_METHOD", text, file=place)
    return asset


def as_asset(asset: Asset | str | os.PathLike[str]) -> Asset:
    """Return `asset`, or what `open` makes of it if it is a path."""
    if isinstance(asset, PATH_TYPES):
        return open(asset)
    check_type("asset", asset, Asset, AN_ASSET)
    return asset


@dataclass(frozen=True, eq=False)
class StoredMesh:
    """A mesh exactly as its file holds it, in the file's precision; its values are not checked.

    Attributes
    ----------
    path : Path or None
        None if the mesh was never in a file.
    buffers : mapping of str to ndarray
        Arrays by the asset's names: `positions` (V, 3) floating, `indices` (F, 3) integers, and all others
        stored.
    domains : mapping of str to str
        The domains of `color` and the other buffers with a row for each vertex, face or corner.
    method : str or None
        None for a mesh file.
    up : str
        The axis that is up, such as "+y", or "unknown".
    warnings : tuple of Finding
        What the reader of an asset tolerated, and what that of a mesh file left out.
    sampler : Sampler or None
        How the textures among the buffers are read; None if there are none, or they were not read.
    """

    path: Path | None
    buffers: Mapping[str, NDArray[Any]]
    domains: Mapping[str, str]
    method: str | None = None
    up: str = "unknown"
    warnings: tuple[Finding, ...] = ()
    sampler: Sampler | None = None

    @property
    def vertices(self) -> NDArray[Any]:
        """The coordinates (V, 3)."""
        return self.buffers["positions"]

    @property
    def faces(self) -> NDArray[Any]:
        """The vertex numbers (F, 3) of the faces."""
        return self.buffers["indices"]

    @property
    def attributes(self) -> Attributes:
        """What its vertices may be doubled for at seams."""
        from msb.topology.seams import seam_attributes

        return seam_attributes(self.buffers, self.domains)


def read_stored(path: str | os.PathLike[str], *, images: bool = False) -> StoredMesh:
    """Return the mesh at `path`, which may be anything that `open` takes, exactly as it is stored.

    All stored faces are there, even those that an STE threshold hides, and coordinates that are NaN. With
    `images` the textures of a mesh file are, too; those of an asset always are.
    """
    from msb.adapters.exporter import read_model
    from msb.adapters.locate import is_mesh_file

    place = given_path(path)
    if is_asset(place):
        return stored_mesh(load(place))
    if is_mesh_file(place):
        return _stored_file(place, images=images)
    model = read_model(place, check_values=False)
    description = model.description
    up = description.coordinate_frame.up
    return StoredMesh(place, model.buffers, model.domains, description.method, up)


def _stored_file(path: Path, *, images: bool) -> StoredMesh:
    from msb.meshes import read_mesh
    from msb.meshes.mesh import left_out_finding
    from msb.meshes.writing import check_indices

    mesh = read_mesh(path, images=images)
    if mesh.wrong_face is not None:  # whoever uses the faces would refuse them, and could not name the line
        with about(path):
            check_indices(mesh)
    buffers, domains = {"positions": mesh.vertices, "indices": mesh.faces}, {}
    for name, values, domain in (
        ("color", mesh.vertex_colors, "vertex"),
        ("color", mesh.face_colors, "face"),
        ("uv", mesh.vertex_uvs, "vertex"),
        ("uv", mesh.corner_uvs, "corner"),
        ("face_texture", mesh.face_textures, "face"),
        *((f"texture.{number}", image, "global") for number, image in enumerate(mesh.textures)),
    ):
        if values is not None and name not in buffers:
            buffers[name], domains[name] = values, domain
    sampler = mesh.sampler if mesh.textures else None
    warnings = left_out_finding(mesh)
    return StoredMesh(path, buffers, domains, up=mesh.up or "unknown", warnings=warnings, sampler=sampler)


def stored_mesh(asset: Asset) -> StoredMesh:
    """Return the mesh of an asset as it is stored."""
    manifest = asset.manifest
    domains = {name: spec.domain for name, spec in manifest.buffers.items()}
    up = manifest.coordinate_frame.up
    sampler = Sampler.of(manifest.appearance) if is_textured(asset) else None
    return StoredMesh(asset.path, asset.buffers, domains, manifest.method, up, asset.warnings, sampler)
