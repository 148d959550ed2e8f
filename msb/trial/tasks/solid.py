"""Check with manifold3d and trimesh whether a mesh is a solid with a volume.

Slicers and physics engines need a solid with a volume.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.faces import signed_volume
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings
from msb.trial.task import Attempt, Judgement, Numbers, Output, Outputs, Task

# Width and height of the saved image in pixels.
_PIXELS = 360
INWARDS = "the faces are wound inwards, so the volume is negative"


def build_solid(mesh: TrialMesh) -> tuple[Any, Numbers]:
    """Return manifold3d's solid of the mesh, and its status as numbers.

    Call this function only in a child process. The solid is None if manifold3d rejects the mesh even after
    merging vertices. On some meshes with unpaired half-edges, manifold3d crashes.
    """
    import manifold3d

    given = manifold3d.Mesh(
        vert_properties=np.ascontiguousarray(mesh.vertices, np.float32),
        tri_verts=np.ascontiguousarray(mesh.faces, np.uint32),
    )
    solid = manifold3d.Manifold(given)
    status = solid.status()
    fine = manifold3d.Error.NoError
    accepted = status == fine
    # Try again with merged vertices.
    merged = False
    if not accepted and given.merge():
        solid = manifold3d.Manifold(given)
        merged = solid.status() == fine
    numbers = {"accepted": accepted, "accepted_merged": accepted or merged, "status": status.name}
    return (solid if accepted or merged else None), numbers


def _measure_with_manifold3d(mesh: TrialMesh, _: Arrays) -> Output:
    """Measure the volume and the genus of manifold3d's solid."""
    solid, numbers = build_solid(mesh)
    if solid is not None:
        numbers |= {"volume": float(solid.volume()), "genus": int(solid.genus())}
    return Output(numbers)


def _check_with_trimesh(mesh: TrialMesh, _: Arrays) -> Output:
    """Check with trimesh whether the mesh is watertight and consistently wound."""
    import trimesh

    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return Output(
        {
            "watertight": bool(body.is_watertight),
            "winding_consistent": bool(body.is_winding_consistent),
            "volume": float(body.volume) if body.is_watertight else None,
        }
    )


def _judge(mesh: TrialMesh, outputs: Outputs, _: Renderings) -> Judgement:
    numbers: Numbers = {name: output.numbers for name, output in outputs.items()}
    slicer, checked = numbers.get("manifold3d"), numbers.get("trimesh")
    numbers["volume"] = volume = signed_volume(mesh.vertices, mesh.faces)
    if checked is not None and not checked["watertight"]:
        merged = slicer is not None and slicer["accepted_merged"]
        if merged:
            return Judgement("care", "the mesh is closed only after merging coincident vertices", numbers)
        status = f" (manifold3d: {slicer['status']})" if slicer else ""
        return Judgement("fails", f"the mesh is not watertight{status}", numbers)
    if slicer is not None and not slicer["accepted"]:
        if slicer["accepted_merged"]:
            return Judgement("care", "manifold3d accepts the mesh only after merging vertices", numbers)
        return Judgement("fails", f"manifold3d rejects the mesh: {slicer['status']}", numbers)
    if volume < 0:
        return Judgement("care", INWARDS, numbers)
    return Judgement("works", None, numbers)


def _summarize(numbers: Numbers) -> str:
    accepted = numbers.get("manifold3d", {"accepted_merged": True})["accepted_merged"]
    if not (accepted and numbers.get("trimesh", {"watertight": True})["watertight"]):
        return ""
    return f"volume {numbers['volume']:.4g}"


def _draw_picture(mesh: TrialMesh, _: Outputs, __: Renderings) -> NDArray[Any] | None:
    """Draw a cross-section through the middle, perpendicular to the longest side, as a slicer does."""
    from PIL import Image, ImageDraw

    lines = cut_section(mesh)
    image = Image.new("RGB", (_PIXELS, _PIXELS), "white")
    if len(lines):
        low, high = lines.min(axis=(0, 1)), lines.max(axis=(0, 1))
        scale = 0.92 * _PIXELS / max(float((high - low).max()), 1e-30)
        places = (lines - (low + high) / 2) * scale + _PIXELS / 2
        draw = ImageDraw.Draw(image)
        for segment in places.reshape(-1, 4).tolist():
            draw.line(segment, fill="black")
    return np.asarray(image)


def cut_section(mesh: TrialMesh) -> NDArray[np.float64]:
    """Return the segments (n, 2, 2) where a plane cuts the faces.

    The plane goes through the centre of the bounding box, perpendicular to its longest side.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    if not len(corners):
        return np.zeros((0, 2, 2))
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    axis = int(np.argmax(high - low))
    # Signed distance (F, 3) of the corners from the plane. A face is cut if its corners lie on both sides of
    # the plane.
    heights = corners[:, :, axis] - (low + high)[axis] / 2
    above = heights > 0
    cut = above.any(axis=1) & ~above.all(axis=1)
    corners, heights, above = corners[cut], heights[cut], above[cut]
    # `odd` (n,) is the index of the corner that is alone on its side of the plane. The plane cuts the two
    # edges at this corner.
    odd = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(odd))
    ends = []
    for turn in (1, 2):
        other = (odd + turn) % 3
        share = heights[rows, odd] / (heights[rows, odd] - heights[rows, other])
        ends.append(corners[rows, odd] + share[:, None] * (corners[rows, other] - corners[rows, odd]))
    return np.stack(ends, axis=1)[:, :, [k for k in range(3) if k != axis]]


TASKS = (
    Task(
        "solid",
        "Solid: volume, printing",
        (
            Attempt("manifold3d", ("manifold3d",), _measure_with_manifold3d),
            Attempt("trimesh", ("trimesh",), _check_with_trimesh),
        ),
        _judge,
        _summarize,
        powers={"volume": 3},
        picture=_draw_picture,
    ),
)
