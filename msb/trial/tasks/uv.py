"""UV unwrapping by xatlas: how many charts the surface falls into, and how they fill and stretch the map."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.trial.renderings import Look, facing, random_colors
from msb.trial.mesh import TriedMesh
from msb.trial.task import Attempt, Judgement, Made, Numbers, Outcome, Task, counted, graded, judged

# Charts per 1,000 faces. Charts of ten faces can still be painted and filtered. With fewer than two and a
# half nearly every edge is a seam, and the padding between charts fills the texture.
FEW_CHARTS, MANY_CHARTS = 100.0, 400.0
# L2 stretch: mean size of the texels on the surface, relative to a map without distortion.
LITTLE_STRETCH, MUCH_STRETCH = 1.5, 3.0


def _work(mesh: TriedMesh, _: Arrays) -> Made:
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    atlas.generate()
    original, faces, uv = atlas[0]
    original, faces, uv = original.astype(np.int64), faces.astype(np.int64), uv.astype(np.float32)
    # xatlas scales the map to its width and height; what it could not place has no atlas, and its UVs are 0.
    placed, chart = (np.asarray(values) for values in atlas.get_mesh_vertex_assignment(0))
    left_out = (
        (placed < 0)[faces].any(axis=1) if placed.dtype.kind == "i" else (placed == _NONE)[faces].any(1)
    )
    points = mesh.vertices[original]
    numbers = {
        "charts": int(atlas.chart_count),
        "charts_per_1000_faces": 1000 * atlas.chart_count / len(faces),
        "packing": float(atlas.utilization),
        "faces_left_out": int(np.count_nonzero(left_out)),
        "stretch_l2": l2_stretch(points, faces[~left_out], uv * (atlas.width, atlas.height)),
    }
    made = TriedMesh(points, faces, mesh.colors[original], uv)
    return Made(numbers, {"uv": made}, {"chart": chart.astype(np.int64)})


_NONE = np.uint32(0xFFFFFFFF)  # xatlas's number of no atlas


def l2_stretch(vertices: NDArray[Any], faces: NDArray[np.int64], uv: NDArray[Any]) -> float | None:
    """Return the L2 stretch of a map `uv` (V, 2), 1 where it is isometric up to one scale; None if it has no
    area.

    Sander et al., "Texture Mapping Progressive Meshes", 2001, section 3: the root mean square, over the
    surface, of the singular values of the map from the texture to the surface; here times the scale at which
    both have one area. Faces whose area is 0 on either side are left out.
    """
    corners, mapped = (values[faces].astype(np.float64) for values in (vertices, uv))
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    a, b = mapped[:, 1] - mapped[:, 0], mapped[:, 2] - mapped[:, 0]
    signed = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    surface = np.linalg.norm(np.cross(one, two), axis=1)
    kept = (np.abs(signed) > 0) & (surface > 0)
    if not kept.any():
        return None
    one, two, a, b, signed, surface = (each[kept] for each in (one, two, a, b, signed, surface))
    along_s = (one * b[:, 1:] - two * a[:, 1:]) / signed[:, None]
    along_t = (two * a[:, :1] - one * b[:, :1]) / signed[:, None]
    squares = ((along_s**2).sum(axis=1) + (along_t**2).sum(axis=1)) / 2
    return float(np.sqrt(np.average(squares, weights=surface) * np.abs(signed).sum() / surface.sum()))


def _judge(mesh: TriedMesh, made: Mapping[str, Made], _: Look) -> Judgement:
    numbers = made["xatlas"].numbers
    charts, stretch = numbers["charts_per_1000_faces"], numbers["stretch_l2"]
    left_out = numbers["faces_left_out"]
    pieces: Outcome = "works" if numbers["charts"] == 1 else graded(charts, FEW_CHARTS, MANY_CHARTS)
    size = "one face" if charts > 999 else f"{1000 / (charts or 1):.1f} faces in the mean"
    return judged(
        numbers,
        (pieces, f"it falls into charts of {size}"),
        (
            graded(left_out / max(1, len(mesh.faces)), 0.0, 0.01),
            f"{counted(left_out, 'face is', 'faces are')} left out",
        ),
        (
            graded(stretch, LITTLE_STRETCH, MUCH_STRETCH),
            f"the texture is stretched {stretch or 0:.1f} times",
        ),
    )


def _says(numbers: Numbers) -> str:
    stretch = "" if numbers["stretch_l2"] is None else f", stretch {numbers['stretch_l2']:.2f}"
    charts = counted(numbers["charts"], "chart")
    return f"{charts}, packing {100 * numbers['packing']:.0f} %{stretch}"


def _picture(_: TriedMesh, made: Mapping[str, Made], look: Look) -> NDArray[Any] | None:
    """Draw the texture's plane, a colour to each chart."""
    unwrapped, chart = made["xatlas"].meshes["uv"], made["xatlas"].arrays["chart"]
    assert unwrapped.uv is not None
    flat = np.concatenate([unwrapped.uv, np.zeros((len(unwrapped.uv), 1), np.float32)], axis=1)
    return look.picture(TriedMesh(flat, unwrapped.faces, random_colors(chart)), facing())


TASKS = (
    Task("uv", "UV unwrapping", (Attempt("xatlas", ("xatlas",), _work),), _judge, _says, picture=_picture),
)
