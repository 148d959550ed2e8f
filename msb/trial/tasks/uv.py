"""UV unwrapping by xatlas: count the charts, and measure the packing and the stretch."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.topology.faces import UNWRAP_FACES, split_into_blocks
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings, make_facing_camera, random_colors
from msb.trial.task import Attempt, Judgement, Numbers, Output, Outputs, Task, combine, format_count, grade

# Largest numbers of charts per 1,000 faces for "works" and for "works with limitations". Charts of at least
# ten faces can be painted and filtered. With fewer than 2.5 faces per chart, nearly every edge is a seam, and
# the texture consists mostly of padding.
FEW_CHARTS, MANY_CHARTS = 100.0, 400.0
# Largest L2 stretch for "works" and for "works with limitations". The stretch is the average size of texels
# on the surface, relative to a map without distortion.
LITTLE_STRETCH, MUCH_STRETCH = 1.5, 3.0


def _work(mesh: TrialMesh, _: Arrays) -> Output:
    """Unwrap the mesh. The array "chart" (V,) has the chart of each vertex."""
    import xatlas

    # xatlas crashes on large meshes, so large meshes are unwrapped in parts, as in a bake.
    atlas = xatlas.Atlas()
    blocks = split_into_blocks(mesh.vertices[mesh.faces].mean(axis=1), UNWRAP_FACES)
    used_by = []
    for block in blocks:
        used, local = np.arange(len(mesh.vertices)), mesh.faces
        if len(blocks) > 1:
            used, local = np.unique(mesh.faces[block], return_inverse=True)
        used_by.append(used)
        atlas.add_mesh(mesh.vertices[used].astype(np.float32), local.reshape(-1, 3).astype(np.uint32))
    atlas.generate()
    # Join the parts, and number their vertices consecutively.
    rows, uvs, charts, atlases, count = [], [], [], [], 0
    faces = np.zeros(mesh.faces.shape, np.int64)
    for number, (block, used) in enumerate(zip(blocks, used_by, strict=True)):
        original, local, uv = atlas[number]
        faces[block] = local.astype(np.int64) + count
        count += len(uv)
        placed, chart = (np.asarray(values) for values in atlas.get_mesh_vertex_assignment(number))
        rows.append(used[original.astype(np.int64)])
        uvs.append(uv.astype(np.float32))
        charts.append(chart.astype(np.int64))
        # If xatlas cannot place a vertex, the atlas number is -1 or the largest uint32, and the UVs are 0.
        atlases.append(placed >= 0 if placed.dtype.kind == "i" else placed != _NONE)
    original, uv, chart = (np.concatenate(parts) for parts in (rows, uvs, charts))
    left_out = ~np.concatenate(atlases)[faces].all(axis=1)
    # xatlas divides UVs by the width and height of the atlas. Multiply the UVs by the size of the atlas to
    # measure the stretch.
    points = mesh.vertices[original]
    numbers = {
        "charts": int(atlas.chart_count),
        "charts_per_1000_faces": 1000 * atlas.chart_count / len(faces),
        "packing": float(atlas.utilization),
        "faces_left_out": int(np.count_nonzero(left_out)),
        "stretch_l2": measure_stretch(points, faces[~left_out], uv * (atlas.width, atlas.height)),
    }
    unwrapped = TrialMesh(points, faces, mesh.colors[original], uv)
    return Output(numbers, {"uv": unwrapped}, {"chart": chart})


# The atlas number of vertices that xatlas could not place.
_NONE = np.uint32(0xFFFFFFFF)


def measure_stretch(vertices: NDArray[Any], faces: NDArray[np.int64], uv: NDArray[Any]) -> float | None:
    """Return the L2 stretch of the UV map `uv` (V, 2).

    A map without distortion has the stretch 1. Return None for a mesh without area. Sander et al., "Texture
    Mapping Progressive Meshes", 2001, section 3, define the L2 stretch. The stretch is the root mean square
    of the singular values of the map from the texture to the surface. The mean is weighted by surface area.
    The map is first scaled to the area of the surface. Faces without area on the surface or in the texture
    are ignored.
    """
    # Compute two edges (F, 3) of each face on the surface, and the same two edges (F, 2) in the texture.
    corners, mapped = (values[faces].astype(np.float64) for values in (vertices, uv))
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    a, b = mapped[:, 1] - mapped[:, 0], mapped[:, 2] - mapped[:, 0]
    signed = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    surface = np.linalg.norm(np.cross(first, second), axis=1)
    kept = (np.abs(signed) > 0) & (surface > 0)
    if not kept.any():
        return None
    first, second, a, b, signed, surface = (values[kept] for values in (first, second, a, b, signed, surface))
    # Compute the partial derivatives (n, 3) of the surface point with respect to s and t. The squared lengths
    # of the two partial derivatives add up to the squared singular values.
    along_s = (first * b[:, 1:] - second * a[:, 1:]) / signed[:, None]
    along_t = (second * a[:, :1] - first * b[:, :1]) / signed[:, None]
    squares = ((along_s**2).sum(axis=1) + (along_t**2).sum(axis=1)) / 2
    return float(np.sqrt(np.average(squares, weights=surface) * np.abs(signed).sum() / surface.sum()))


def _judge(mesh: TrialMesh, outputs: Outputs, _: Renderings) -> Judgement:
    numbers = outputs["xatlas"].numbers
    charts, stretch = numbers["charts_per_1000_faces"], numbers["stretch_l2"]
    left_out = numbers["faces_left_out"]
    pieces = grade(None if numbers["charts"] == 1 else charts, FEW_CHARTS, MANY_CHARTS)
    few = f"the charts have {1000 / (charts or 1):.1f} faces on average"
    return combine(
        numbers,
        (pieces, "every chart is a single face" if charts > 999 else few),
        (
            grade(left_out / max(1, len(mesh.faces)), 0.0, 0.01),
            f"{format_count(left_out, 'face is', 'faces are')} missing in the UV map",
        ),
        (
            grade(stretch, LITTLE_STRETCH, MUCH_STRETCH),
            f"the texture is stretched by a factor of {stretch or 0:.1f}",
        ),
    )


def _summarize(numbers: Numbers) -> str:
    stretch = "" if numbers["stretch_l2"] is None else f", stretch {numbers['stretch_l2']:.2f}"
    charts = format_count(numbers["charts"], "chart")
    return f"{charts}, packing {100 * numbers['packing']:.0f} %{stretch}"


def _draw_picture(_: TrialMesh, outputs: Outputs, renderings: Renderings) -> NDArray[Any] | None:
    """Draw the charts in texture space, each chart in a different colour."""
    unwrapped, chart = outputs["xatlas"].meshes["uv"], outputs["xatlas"].arrays["chart"]
    assert unwrapped.uv is not None
    flat = np.concatenate([unwrapped.uv, np.zeros((len(unwrapped.uv), 1), np.float32)], axis=1)
    return renderings.picture(TrialMesh(flat, unwrapped.faces, random_colors(chart)), make_facing_camera())


TASKS = (
    Task(
        "uv",
        "UV unwrapping",
        (Attempt("xatlas", ("xatlas",), _work),),
        _judge,
        _summarize,
        picture=_draw_picture,
    ),
)
