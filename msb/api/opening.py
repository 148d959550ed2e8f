"""Opens a file of any kind as an asset, or reads a mesh as stored.

The API, commands and viewers use this module. An asset is detected by its name or manifest, and a checkpoint
by the name of its file or folder. A PLY table of primitives is detected by its header. All other files are
treated as mesh files.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from msb.asset import Asset, is_asset, load
from msb.asset.arguments import AN_ASSET, check_type
from msb.asset.origin import world_positions
from msb.asset.texture import Sampler, is_textured
from msb.asset.tiers import reject_gaussians
from msb.base.paths import PATH_TYPES, given_path
from msb.base.seam_keys import SEAM_KEY
from msb.errors import CheckpointError, Finding, MeshError, about
from msb.topology.seams import Attributes

if TYPE_CHECKING:
    from msb.meshes import Mesh


def open(path: str | os.PathLike[str], *, method: str | None = None) -> Asset:
    """Open a model or mesh of any supported format as an asset.

    Parameters
    ----------
    path : path-like
        A `.triasset` (packed or folder), the output folder of a training, a model file in such a folder, or
        a mesh file.
    method : str, optional
        The expected method. By default, the method is detected from the content.

    Returns
    -------
    Asset
        The result of `load` or `export`. Positions are float32, even if a mesh file has float64. Positions
        are relative to an origin if the mesh is very far from zero relative to its size. Faces of mesh
        files and checkpoints with non-finite values are left out, with a warning.

    Raises
    ------
    InputError, CheckpointError, MeshFileError, MeshError, AssetError, Unsupported, UsageError
        The errors of `load` and `export`; `CHECKPOINT_METHOD` if the model belongs to another method.

    Examples
    --------
    >>> import msb
    >>> msb.open("data_stubs/checkpoint")
    <Asset mesh_splatting: 5,159 faces, 2,582 vertices, indexed mesh, 227,156 bytes, data_stubs/checkpoint>
    """
    place = given_path(path)
    if not is_asset(place):
        from msb.adapters.exporter import finish, read_model

        return finish(read_model(place, method=method))
    asset = load(place)
    if method not in (None, asset.manifest.method):
        text = f"it contains a {asset.manifest.method} model, but {method} was requested"
        raise CheckpointError("CHECKPOINT_METHOD", text, file=place)
    return asset


def describe_opened(path: Path, asset: Asset) -> Iterator[str]:
    """Yield the notes on an asset opened from `path`: the checkpoint in a folder, and the warnings."""
    if asset.opened_from not in (None, path):
        yield f"{path}: opened the checkpoint in this folder, {asset.opened_from}"
    yield from (warning.to_line(path) for warning in asset.warnings)


def as_asset(asset: Asset | str | os.PathLike[str]) -> Asset:
    """Return `asset` itself, or open the asset at this path."""
    if isinstance(asset, PATH_TYPES):
        return open(asset)
    check_type("asset", asset, Asset, AN_ASSET)
    return asset


@dataclass(frozen=True, eq=False)
class StoredMesh:
    """A mesh exactly as its file stores it, in the precision of the file.

    The values of the mesh are not checked.

    Attributes
    ----------
    path : Path or None
        The value is None for a mesh that is not from a file.
    buffers : mapping of str to ndarray
        Arrays with the names of an asset. `positions` (V, 3) contains floats, and `indices` (F, 3) contains
        integers. All other arrays of the file are included.
    domains : mapping of str to str
        The domain of `color` and other buffers that have a row for each vertex, face or corner.
    method : str or None
        The value is None for a mesh file.
    up : str
        The axis that points up, such as "+y", or "unknown".
    warnings : tuple of Finding
        Warnings of the reader, such as ignored parts of a mesh file.
    sampler : Sampler or None
        How textures are sampled. The value is None if textures are missing or were not read.
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
        """The vertex indices (F, 3) of the faces."""
        return self.buffers["indices"]

    @property
    def attributes(self) -> Attributes:
        """Attributes that differ at seams, where files duplicate vertices."""
        from msb.topology.seams import seam_attributes

        # In a trained triangle soup, corners coincide only by chance.
        is_mesh = self.method in (None, "mesh")
        return seam_attributes(self.buffers, self.domains, triangle_list=is_mesh)


def read_stored(path: str | os.PathLike[str], *, images: bool = False) -> StoredMesh:
    """Read the mesh of any file that `open` accepts, exactly as it is stored.

    Faces below the STE threshold and NaN coordinates are included. If `images` is true, the textures of a
    mesh file are read as well. The textures of an asset are always read.
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
    reject_gaussians(description.primitive, place)
    up = description.coordinate_frame.up
    return StoredMesh(place, model.buffers, model.domains, description.method, up)


def _stored_file(path: Path, *, images: bool) -> StoredMesh:
    from msb.meshes import read_mesh

    return _store(read_mesh(path, images=images), path)


def _store(mesh: Mesh, path: Path | None) -> StoredMesh:
    """Return the arrays of `mesh` under the buffer names of an asset."""
    from msb.meshes.mesh import report_left_out
    from msb.meshes.writing import check_indices

    if mesh.wrong_face is not None:  # Only the reader knows the line number of an invalid index.
        with about(path):
            check_indices(mesh)
    # Vertex colours take precedence over face colours.
    buffers, domains = {"positions": mesh.vertices, "indices": mesh.faces}, {}
    for name, values, domain in (
        ("color", mesh.vertex_colors, "vertex"),
        ("color", mesh.face_colors, "face"),
        ("uv", mesh.vertex_uvs, "vertex"),
        ("uv", mesh.corner_uvs, "corner"),
        (SEAM_KEY, mesh.vertex_keys, "vertex"),
        (SEAM_KEY, mesh.corner_keys, "corner"),
        ("face_texture", mesh.face_textures, "face"),
        *((f"texture.{number}", image, "global") for number, image in enumerate(mesh.textures)),
    ):
        if values is not None and name not in buffers:
            buffers[name], domains[name] = values, domain
    sampler = mesh.sampler if mesh.textures else None
    warnings = report_left_out(mesh)
    return StoredMesh(path, buffers, domains, up=mesh.up or "unknown", warnings=warnings, sampler=sampler)


def stored_object(given: object) -> StoredMesh:
    """Return the mesh of an object with arrays: a `Mesh`, a pair, or an object of another library.

    A pair is a tuple or list (vertices, faces). An object of another library can be a PolyData of pyvista.
    Any other object needs the attributes `vertices` and `faces`, as in trimesh. The method `triangulate` of a
    PolyData splits its polygons.

    Raises
    ------
    MeshError
        `MESH_ARRAY`: the object is of another kind.
    """
    from msb.meshes import Mesh

    if isinstance(given, StoredMesh):
        return given
    if isinstance(given, Mesh):
        return _store(given, None)
    if isinstance(given, tuple | list) and len(given) == 2:
        vertices, faces = given
    elif all(hasattr(given, name) for name in ("points", "regular_faces", "triangulate")):
        data: Any = given  # the object is a PolyData, whose `faces` are a flat list of polygons
        triangles = data if data.is_all_triangles else data.triangulate()
        vertices, faces = triangles.points, triangles.faces.reshape(-1, 4)[:, 1:]
    elif hasattr(given, "vertices") and hasattr(given, "faces"):
        vertices, faces = given.vertices, given.faces
    else:
        text = f"a {type(given).__name__} has no vertices and faces"
        raise MeshError("MESH_ARRAY", f"{text}; pass an asset, a path, a mesh, or both arrays")
    return StoredMesh(None, {"positions": vertices, "indices": faces}, {})


def stored_mesh(asset: Asset) -> StoredMesh:
    """Return the stored mesh of an asset, with coordinates in the scene (`world_positions`)."""
    manifest = asset.manifest
    reject_gaussians(manifest.primitive, asset.opened_from)
    domains = {name: spec.domain for name, spec in manifest.buffers.items()}
    up = manifest.coordinate_frame.up
    sampler = Sampler.of(manifest.appearance) if is_textured(asset) else None
    buffers = {**asset.buffers, "positions": world_positions(asset)}
    return StoredMesh(asset.path, buffers, domains, manifest.method, up, asset.warnings, sampler)
