"""The function `msb.audit`, which audits arrays, an asset or a file."""

import os
from dataclasses import replace
from typing import Any, Protocol, overload

from numpy.typing import ArrayLike

from msb.api.opening import StoredMesh, read_stored, stored_mesh, stored_object
from msb.asset import Asset
from msb.base.paths import PATH_TYPES
from msb.errors import about
from msb.topology import Audit, audit_arrays
from msb.topology.analysis import Analysis
from msb.topology.verdict import judge
from msb.topology.weld import Weld


class HasTriangles(Protocol):
    """An object with arrays of vertices (V, 3) and faces (F, 3), such as `msb.meshes.Mesh` or a trimesh."""

    @property
    def vertices(self) -> Any: ...
    @property
    def faces(self) -> Any: ...


class HasPolygons(Protocol):
    """A PolyData object of pyvista."""

    @property
    def points(self) -> Any: ...
    @property
    def regular_faces(self) -> Any: ...


MeshLike = HasTriangles | HasPolygons | tuple[ArrayLike, ArrayLike]


@overload
def audit(vertices: Asset | str | os.PathLike[str] | MeshLike, *, weld: Weld | None = None) -> Audit: ...
@overload
def audit(vertices: ArrayLike, faces: ArrayLike, *, weld: Weld | None = None) -> Audit: ...
def audit(vertices: Any, faces: ArrayLike | None = None, *, weld: Weld | None = None) -> Audit:
    """Audit the structure of a triangle mesh exactly as it is stored.

    Nothing is merged, removed, reoriented or repaired before counting (paper: "Mesh structural integrity" and
    appendix "Topology-Metric Definitions and Interpretation Limits"). The verdict ignores seams, which are
    vertices that are duplicated because their UVs or colours differ. Objects of other libraries have no
    seams, because their UVs and colours are not read.

    Parameters
    ----------
    vertices : (V, 3) real numbers, Asset, path-like, pair or mesh
        Coordinates in any unit of length. NaN values are allowed and counted. Omit `faces` for all other
        inputs. The other inputs are an asset, a path that `msb.open` accepts, a pair ``(vertices, faces)``, a
        `msb.meshes.Mesh`, any object with `vertices` and `faces` such as a trimesh, and a pyvista PolyData.
        The method `triangulate` of a PolyData splits its polygons. The audit of a mesh file uses the
        precision of the file, as `msb audit PATH` does. In contrast, `msb.open` rounds coordinates to
        float32.
    faces : (F, 3) integers
        0-based vertex indices.
    weld : "exact" or float, optional
        Also audit the mesh with coincident vertices merged (`weld_vertices`).

    Returns
    -------
    Audit

    Raises
    ------
    MeshError
        `MESH_ARRAY`, `MESH_INDEX_OUT_OF_RANGE` or `WELD_DISTANCE`.
    InputError, AssetError, CheckpointError, MeshFileError, Unsupported
        The file cannot be read.

    Notes
    -----
    The audit takes O((V + F) log F) time. Large meshes are audited by OpenCL kernels (docs/audit_speed.md).

    Examples
    --------
    As an example, three pages share one edge, like the pages of a book. This edge (the spine) is
    non-manifold. The two ends of the spine are non-manifold vertices.

    >>> import msb
    >>> points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]]
    >>> book = msb.audit(points, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    >>> book.counts.nonmanifold_edges, book.counts.nonmanifold_vertices, book.counts.components
    (1, 2, 1)
    """
    if faces is not None:
        return audit_arrays(vertices, faces, weld=weld)[0]
    if isinstance(vertices, PATH_TYPES):
        return audit_stored(read_stored(vertices), weld=weld)[0]
    if not isinstance(vertices, Asset):
        return audit_stored(stored_object(vertices), weld=weld)[0]
    audited = audit_stored(stored_mesh(vertices), weld=weld)[0]
    vertices._known["Verdict"] = audited.verdict
    return audited


def audit_stored(mesh: StoredMesh, *, weld: Weld | None = None) -> tuple[Audit, Analysis]:
    """Return the audit of a stored mesh. The audit contains the path and the method. Also return the analysis
    for viewers."""
    with about(mesh.path):
        report, analysis = audit_arrays(mesh.vertices, mesh.faces, weld=weld, attributes=mesh.attributes)
    path = None if mesh.path is None else str(mesh.path)
    return replace(report, path=path, method=mesh.method), analysis


def next_command(audit: Audit, source: str, output: str | None = None, plan: str | None = None) -> str | None:
    """Return the command that improves a mesh. Return None if the mesh is OK or no command can improve it.

    The argument `source` is the path of the mesh. The argument `output` is the path of the file to write.
    Both paths are quoted for a shell. The default `output` is a file in the current folder. The argument
    `plan` replaces the repair plan of the verdict.
    """
    plan = judge(audit).plan if plan is None else plan
    if not plan:
        return None
    if plan == "bake":
        return f"msb bake {source} -o {output or 'baked.glb'} --geometry surface"
    # If a method has no native rendering, its triangle soup is merged into an ordinary mesh.
    keeps_method = audit.method not in (None, "mesh") and "weld" not in plan
    target = output or ("repaired.triasset" if keeps_method else "repaired.glb")
    return f"msb repair {source} {target} --plan {plan}"


def native_advice(audit: Audit, source: str) -> str | None:
    """Return commands for a trained soup whose corners do not coincide. Return None for other meshes."""
    from msb.registry import lookup

    if audit.judged.corners_coincide is not False or not audit.method:
        return None
    if "dedicated" not in lookup(audit.method).passes:
        return None
    page = f"msb web --tier dedicated -o page.html {source}"
    return f"To see its native rendering: {page}; to measure the loss in engines: msb why {source}"
