"""Compare a mesh before and after a repair in one view.

The view has three layers: the deleted faces, the added faces and the cut edges.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers.model import CLEAN_NOTE, SOUP_NOTE, Layer, ViewModel, build_model
from msb_viewers.palette import ADDED, DELETED, REPAIR_STYLES
from msb_viewers.viewed_mesh import Colors, ViewedMesh

# Grey values that replace black and white. Both grey values are light, so that the colours of the layers are
# clearly visible.
_DARKEST, _LIGHTEST = 140, 230


def build_repaired_model(before: ViewedMesh, after: ViewedMesh) -> ViewModel:
    """Return a view of all faces of the mesh before the repair, and of the faces that the repair added.

    Unchanged faces are grey, deleted faces red and added faces green. Indices of faces and vertices refer
    to the mesh before the repair. Faces are matched by the positions of their corners, so that repairs of
    any program can be shown.
    """
    from msb.meshes.transform import rotate_axis
    from msb.topology import audit_arrays
    from msb.topology.arrays import mesh_arrays
    from msb.topology.difference import find_difference
    from msb.topology.verdict import judge

    placed = rotate_axis(after.vertices, after.up, before.up)  # rotate files such as .glb upright
    old, new = mesh_arrays(before.vertices, before.faces), mesh_arrays(placed, after.faces)
    change = find_difference(old, new)
    # Append the added faces and the vertices after the repair to the arrays of the mesh before the repair.
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
        # Edges are sorted by their vertices. Therefore the edges before the repair come first.
        "cut_edges": (change.cut, mesh.edge_vertices),
    }
    layers = {
        kind: Layer(REPAIR_STYLES[kind], rows, vertices[rows]) for kind, (rows, vertices) in numbers.items()
    }
    verdict = judge(audit_arrays(*new, attributes=after.attributes)[0])
    deleted, cut = len(change.deleted), len(change.cut)
    what = f"{deleted:,} faces deleted, {len(added):,} added, {cut:,} edges cut"
    notes = (
        f"{after.name}: {what}; its verdict is {verdict.word}",
        *(note for note in model.notes if note not in (SOUP_NOTE, CLEAN_NOTE)),
    )
    return replace(model, layers=layers, notes=notes)


def _colors(
    before: ViewedMesh, faces: NDArray[Any], deleted: NDArray[np.int64], added: int
) -> NDArray[np.uint8]:
    """Return the colours (F + added, 3) of the faces.

    Deleted faces are red, added faces are green, and other faces are grey.
    """
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
