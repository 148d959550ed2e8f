"""The function `msb.audit`, which audits arrays, an asset, or what lies at a path."""

import os
from dataclasses import replace
from typing import Any, overload

from numpy.typing import ArrayLike

from msb.api.opening import StoredMesh
from msb.asset import Asset
from msb.base.paths import PATH_TYPES
from msb.errors import MeshError, about
from msb.topology import Audit, audit_arrays
from msb.topology.analysis import Analysis
from msb.topology.weld import Weld


@overload
def audit(vertices: Asset | str | os.PathLike[str], *, weld: Weld | None = None) -> Audit: ...
@overload
def audit(vertices: ArrayLike, faces: ArrayLike, *, weld: Weld | None = None) -> Audit: ...
def audit(vertices: Any, faces: ArrayLike | None = None, *, weld: Weld | None = None) -> Audit:
    """Audit the structure of a triangle mesh exactly as it is stored.

    Nothing is merged, dropped, reoriented or repaired first (paper: "Mesh structural integrity" and
    appendix "Topology-Metric Definitions and Interpretation Limits"). The verdict alone is that of the mesh
    without its seams, where vertices are doubled for the sake of UVs or colours; plain arrays have none.

    Parameters
    ----------
    vertices : (V, 3) real numbers, Asset or path-like
        Coordinates in any length unit; NaN is allowed and counted. Or a whole asset, or the path of anything
        that `msb.open` takes; `faces` is then left out. For a path the result is that of `msb audit PATH`: a
        mesh file is audited in its own precision, which the asset made of it may not have.
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
        The path cannot be read.

    Notes
    -----
    O((V + F) log F) time. Large meshes are audited by OpenCL kernels (docs/audit_speed.md).

    Examples
    --------
    A book of three pages has one non-manifold edge and two non-manifold vertices, its ends:

    >>> import msb
    >>> points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]]
    >>> book = msb.audit(points, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    >>> book.counts.nonmanifold_edges, book.counts.nonmanifold_vertices, book.counts.components
    (1, 2, 1)
    """
    if faces is not None:
        return audit_arrays(vertices, faces, weld=weld)[0]
    if not isinstance(vertices, (Asset, *PATH_TYPES)):
        text = "faces are missing; give an asset, a path, or vertices and faces"
        raise MeshError("MESH_ARRAY", text)
    from msb.api.opening import read_stored, stored_mesh

    if not isinstance(vertices, Asset):
        return audit_stored(read_stored(vertices), weld=weld)[0]
    audited = audit_stored(stored_mesh(vertices), weld=weld)[0]
    vertices._known["Verdict"] = audited.verdict
    return audited


def audit_stored(mesh: StoredMesh, *, weld: Weld | None = None) -> tuple[Audit, Analysis]:
    """Return the audit of a mesh as stored, with its path and method, and the analysis for viewers."""
    with about(mesh.path):
        report, analysis = audit_arrays(mesh.vertices, mesh.faces, weld=weld, attributes=mesh.attributes)
    path = None if mesh.path is None else str(mesh.path)
    return replace(report, path=path, method=mesh.method), analysis


def advice(audit: Audit, output: str, source: str) -> str | None:
    """Return what helps where faces share no vertices; `output` is the option -o, `source` what to repair."""
    from msb.registry import lookup

    audit = audit.judged
    if audit.closed_once_merged or audit.corners_coincide:
        return f"Merge the vertices: msb repair --plan weld,orient,pair {output} {source}"
    if audit.corners_coincide is False and audit.method and "dedicated" in lookup(audit.method).passes:
        shown = f"msb web --tier dedicated -o page.html {source}"
        return (
            f"As trained it is seen on the dedicated tier alone: {shown}; what engines lose: msb why "
            f"{source}; a plain mesh that looks like it: msb bake -o plain.glb {source}"
        )
    return None
