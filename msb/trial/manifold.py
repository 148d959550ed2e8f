"""Offer a mesh to manifold3d, as it is and, if it is refused, with coincident vertices merged by it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from msb.trial.mesh import TriedMesh
    from msb.trial.task import Numbers

INWARDS = "it is wound inwards: its volume is negative"


def offer(mesh: TriedMesh) -> tuple[Any, Numbers]:
    """Return the solid, None if it is refused both ways, and what manifold3d said; in a child process only.

    It crashes on some meshes whose half-edges cannot pair up.
    """
    import manifold3d

    given = manifold3d.Mesh(
        vert_properties=np.ascontiguousarray(mesh.vertices, np.float32),
        tri_verts=np.ascontiguousarray(mesh.faces, np.uint32),
    )
    solid = manifold3d.Manifold(given)
    said = solid.status()
    fine = manifold3d.Error.NoError
    accepted = said == fine
    merged = False
    if not accepted and given.merge():
        solid = manifold3d.Manifold(given)
        merged = solid.status() == fine
    numbers = {"accepted": accepted, "accepted_merged": accepted or merged, "status": said.name}
    return (solid if accepted or merged else None), numbers
