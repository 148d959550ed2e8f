"""Convex parts of surfaces by other libraries, hulls of patches, and how far a shape protrudes.

Lengths are relative to the diagonal of the bounding box of the surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays, Work, run_in_child
from msb.base.extras import is_installed
from msb.base.limits import Limits
from msb.delivery.hulls import PointsAndFaces, make_hull, split_into_patches
from msb.delivery.surface_distance import Floats, Ints, measure_distances, sample_surface
from msb.topology.faces import signed_volume
from msb.topology.hulls import HULL_CORNERS

# A part of a shape protrudes if it is farther than this from the visible surface. For comparison, 95 % of the
# points of a surface with 1,000 faces are nearer than 0.01 to the original.
PROTRUSION = 0.02
# A closed surface is simplified to this number of faces for CoACD, whose time grows with it.
COACD_FACES = 2000
# Two parameters of CoACD: the number of sample points on a surface and of trials per cut. They are below the
# defaults, 2000 and 150, so that CoACD finishes in time.
_COACD_SAMPLES, _COACD_TRIALS = 1000, 60
# Voxels of V-HACD, a quarter of its default, and its time limit in seconds. It takes 1 to 10 s.
_VOXELS, _VHACD_SECONDS = 100_000, 60.0
# Largest number of hulls of patches; it bounds the time of the cuts.
_MAX_HULLS = 256
# A point within this distance of a convex part counts as covered by it.
_TOUCH_DISTANCE = 1e-3
_TINY = np.finfo(np.float64).tiny


def make_patch_hulls(surface: PointsAndFaces, count: int) -> list[PointsAndFaces]:
    """Return at most `count` convex hulls of patches of a surface, which need not be closed."""
    return [make_hull(patch) for patch in split_into_patches(*surface, min(count, _MAX_HULLS))]


def cut_convex(
    points: Floats, faces: Ints, most: int, seconds: float, *, by_voxels: bool = False
) -> tuple[list[PointsAndFaces], str]:
    """Return at most `most` convex parts of a surface by CoACD, else by V-HACD.

    The second value is empty, or the reason why a library failed. If both fail, there are no parts. CoACD
    gets `seconds`; its time grows with the number of faces. With `by_voxels`, V-HACD is tried first.
    """
    why: list[str] = []
    tools: list[tuple[str, str, Work, float]] = [
        ("CoACD", "coacd", cut_in_child, seconds),
        ("V-HACD", "vhacdx", cut_by_voxels_in_child, _VHACD_SECONDS),
    ]
    for title, module, work, limit in reversed(tools) if by_voxels else tools:
        if not is_installed(module):
            continue
        reply = run_in_child(work, str(most), {"points": points, "faces": faces}, Limits(limit))
        if not reply.why:
            failed = f"{why[0]}, so {title} cut the surface" if why else ""
            return _split(reply.arrays), failed
        why.append(f"{title} failed ({reply.why})")
    return [], f"{' and '.join(why) or 'CoACD is not installed'}, so hulls of patches of the surface are used"


def _split(arrays: Arrays) -> list[PointsAndFaces]:
    """Return the parts that a child process joined, with the faces turned outwards."""
    split = (
        np.split(arrays[name], np.cumsum(arrays[f"{name} per part"])[:-1]) for name in ("points", "faces")
    )
    parts = zip(*split, strict=True)
    return [(part, rows if signed_volume(part, rows) >= 0 else rows[:, ::-1]) for part, rows in parts]


def cut_in_child(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Cut a mesh into at most `word` convex parts by CoACD (a `Work` of `msb.base.children`)."""
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(arrays["points"], arrays["faces"].astype(np.int32)),
        max_convex_hull=int(word),
        resolution=_COACD_SAMPLES,
        mcts_iterations=_COACD_TRIALS,
        max_ch_vertex=HULL_CORNERS,
    )
    return None, _join(parts)


def cut_by_voxels_in_child(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Cut a mesh into at most `word` convex parts by V-HACD (a `Work` of `msb.base.children`)."""
    import vhacdx

    parts = vhacdx.compute_vhacd(
        arrays["points"],
        np.column_stack([np.full(len(arrays["faces"]), 3), arrays["faces"]]).astype(np.uint32).reshape(-1),
        maxConvexHulls=int(word),
        resolution=_VOXELS,
        maxNumVerticesPerCH=HULL_CORNERS,
    )
    return None, _join([(points, np.asarray(rows).reshape(-1, 3)) for points, rows in parts])


def _join(parts: list[Any]) -> dict[str, NDArray[Any]]:
    """Return the points and the faces of all parts, each with the numbers of rows per part."""
    if not parts:
        raise ValueError("it returned no part")
    result: dict[str, NDArray[Any]] = {}
    kinds = np.float64, np.int64
    for name, rows, kind in zip(("points", "faces"), zip(*parts, strict=True), kinds, strict=True):
        result[name] = np.concatenate([np.asarray(part, kind) for part in rows])
        result[f"{name} per part"] = np.array([len(part) for part in rows])
    return result


def measure_protrusion(parts: list[PointsAndFaces], shape: PointsAndFaces, seen: PointsAndFaces) -> float:
    """Return the share of a shape's exposed area that protrudes, so is far from the mesh `seen`."""
    # Points (n, 3) all over the shape, and the part (n,) of each.
    places, face = sample_surface(*shape)
    part = np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts])[face]
    # A point is exposed if it is outside of all other parts. It is outside of a convex part if it is above
    # one of the planes of its faces.
    is_exposed = np.ones(len(places), bool)
    for number, (points, faces) in enumerate(parts if len(parts) > 1 else ()):
        corners = points[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), _TINY)
        others = np.flatnonzero(is_exposed & (part != number))
        above = places[others] @ normal.T - (normal * corners[:, 0]).sum(axis=1)
        is_exposed[others[(above <= _TOUCH_DISTANCE).all(axis=1)]] = False
    if not is_exposed.any():
        return 0.0
    return float((measure_distances(places[is_exposed], *seen) > PROTRUSION).mean())
