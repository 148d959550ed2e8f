"""A mesh and what a repair made of it, in one view: deleted and added faces, and cut edges, as layers."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers.model import CLEAN_NOTE, SOUP_NOTE, Layer, ViewModel, build_model
from msb_viewers.palette import ADDED, DELETED, REPAIR_STYLES
from msb_viewers.viewed_mesh import Colors, ViewedMesh

# Grey of black and of white faces: light enough for the colours to stand out.
_DARKEST, _LIGHTEST = 140, 230


def build_repaired_model(before: ViewedMesh, after: ViewedMesh) -> ViewModel:
    """Return all faces of a mesh as stored, and those that a repair added.

    Faces that were kept are grey, deleted ones red, added ones green; the numbers of faces and vertices are
    those of the mesh as stored. The repair may be anybody's: faces are known by the places of their corners.
    """
    from msb.meshes.transform import turned
    from msb.topology import audit_arrays
    from msb.topology.arrays import mesh_arrays
    from msb.topology.difference import find_difference
    from msb.topology.verdict import judge

    placed = turned(after.vertices, after.up, before.up)  # a .glb was turned upright
    old, new = mesh_arrays(before.vertices, before.faces), mesh_arrays(placed, after.faces)
    change = find_difference(old, new)
    (points, faces), count = old, len(old[1])
    added = new[1][change.added].astype(np.int64) + len(points)
    union = replace(
        before,
        vertices=np.concatenate([points, new[0]]),
        faces=np.concatenate([faces, added]),
        colors=Colors(_colors(before, faces, change.deleted, len(added)), "face"),
        notes=(),
        skin=None,
    )
    audit, _ = audit_arrays(points, faces, attributes=before.attributes)
    _, analysis = audit_arrays(union.vertices, union.faces)
    model = build_model(union, audit, analysis)
    mesh = analysis.mesh
    numbers = {
        "deleted_faces": (change.deleted, mesh.faces),
        "added_faces": (count + np.arange(len(added)), mesh.faces),
        # Edges are in the order of their vertices, so those of the mesh as stored come first.
        "cut_edges": (change.cut, mesh.edge_vertices),
    }
    layers = {
        kind: Layer(REPAIR_STYLES[kind], rows, vertices[rows]) for kind, (rows, vertices) in numbers.items()
    }
    verdict = judge(audit_arrays(*new, attributes=after.attributes)[0])
    deleted, cut = len(change.deleted), len(change.cut)
    what = f"faces deleted: {deleted:,}, added: {len(added):,}; edges cut: {cut:,}"
    notes = (
        f"{after.name}: {what}; it is {verdict.word}",
        *(note for note in model.notes if note not in (SOUP_NOTE, CLEAN_NOTE)),
    )
    return replace(model, layers=layers, notes=notes)


def _colors(
    before: ViewedMesh, faces: NDArray[Any], deleted: NDArray[np.int64], added: int
) -> NDArray[np.uint8]:
    light = np.full(len(faces), 200.0)
    if before.colors is not None:
        light = before.colors.values.mean(axis=1)
        if before.colors.domain == "vertex":
            light = light[faces].mean(axis=1)
        elif before.colors.domain == "corner":
            light = light.reshape(-1, 3).mean(axis=1)
    grey = _DARKEST + (_LIGHTEST - _DARKEST) * light / 255
    kept = np.repeat(np.rint(grey).astype(np.uint8)[:, None], 3, axis=1)
    kept[deleted] = DELETED
    return np.concatenate([kept, np.tile(np.array(ADDED, np.uint8), (added, 1))])
