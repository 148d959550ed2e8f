"""A solid with a volume, as slicers and physics take it: what manifold3d and trimesh say of the mesh."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.faces import signed_volume
from msb.trial.renderings import Look
from msb.trial.mesh import TriedMesh
from msb.trial.task import Attempt, Judgement, Made, Numbers, Task

_PIXELS = 360
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


def _manifold(mesh: TriedMesh, _: Arrays) -> Made:
    solid, numbers = offer(mesh)
    if solid is not None:
        numbers |= {"volume": float(solid.volume()), "genus": int(solid.genus())}
    return Made(numbers)


def _trimesh(mesh: TriedMesh, _: Arrays) -> Made:
    import trimesh

    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return Made(
        {
            "watertight": bool(body.is_watertight),
            "winding_consistent": bool(body.is_winding_consistent),
            "volume": float(body.volume) if body.is_watertight else None,
        }
    )


def _judge(mesh: TriedMesh, made: Mapping[str, Made], _: Look) -> Judgement:
    numbers: Numbers = {name: one.numbers for name, one in made.items()}
    slicer, checked = numbers.get("manifold3d"), numbers.get("trimesh")
    numbers["volume"] = volume = signed_volume(mesh.vertices, mesh.faces)
    if checked is not None and not checked["watertight"]:
        merged = slicer is not None and slicer["accepted_merged"]
        if merged:
            return Judgement("care", "it is closed only once coincident vertices are merged", numbers)
        said = f"; manifold3d says {slicer['status']}" if slicer else ""
        return Judgement("fails", f"it is not watertight{said}", numbers)
    if slicer is not None and not slicer["accepted"]:
        if slicer["accepted_merged"]:
            return Judgement("care", "manifold3d takes it only once it has merged vertices", numbers)
        return Judgement("fails", f"manifold3d says {slicer['status']}", numbers)
    if volume < 0:
        return Judgement("care", INWARDS, numbers)
    return Judgement("works", None, numbers)


def _says(numbers: Numbers) -> str:
    taken = numbers.get("manifold3d", {"accepted_merged": True})["accepted_merged"]
    if not (taken and numbers.get("trimesh", {"watertight": True})["watertight"]):
        return ""
    return f"volume {numbers['volume']:.4g}"


def _picture(mesh: TriedMesh, _: Mapping[str, Made], __: Look) -> NDArray[Any] | None:
    """Draw a cut through the middle, as a slicer makes it, across the mesh's longest axis."""
    from PIL import Image, ImageDraw

    lines = section(mesh)
    image = Image.new("RGB", (_PIXELS, _PIXELS), "white")
    if len(lines):
        low, high = lines.min(axis=(0, 1)), lines.max(axis=(0, 1))
        scale = 0.92 * _PIXELS / max(float((high - low).max()), 1e-30)
        places = (lines - (low + high) / 2) * scale + _PIXELS / 2
        draw = ImageDraw.Draw(image)
        for segment in places.reshape(-1, 4).tolist():
            draw.line(segment, fill="black")
    return np.asarray(image)


def section(mesh: TriedMesh) -> NDArray[np.float64]:
    """Return the segments (n, 2, 2) in which a plane through the middle of the bounds cuts the faces."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    if not len(corners):
        return np.zeros((0, 2, 2))
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    axis = int(np.argmax(high - low))
    heights = corners[:, :, axis] - (low + high)[axis] / 2
    above = heights > 0
    cut = above.any(axis=1) & ~above.all(axis=1)
    corners, heights, above = corners[cut], heights[cut], above[cut]
    # The corner that is alone on its side: both edges from there are cut.
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
        (Attempt("manifold3d", ("manifold3d",), _manifold), Attempt("trimesh", ("trimesh",), _trimesh)),
        _judge,
        _says,
        powers={"volume": 3},
        picture=_picture,
    ),
)
