"""What stands in for a mesh where things bump into each other: closed, of few faces, near what is seen.

It is made of a closed surface: the mesh, or, of an open one, what cameras see of it, enclosed. Of an object
it is that with fewer faces, or the convex parts that CoACD cuts it into; of a scene a sheet behind what is
seen; where nothing is closed, hulls of patches. There is always something, and it says what.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.bake.apart import POINTS, distances, spread
from msb.bake.arrays import Floats, Ints
from msb.bake.fusion import seen_points
from msb.bake.hulls import PATCH_CORNERS, Part, hull_of, patches_of, smallest_box
from msb.bake.needs import need_enclosure
from msb.bake.options import ShapeKind, parse_collision
from msb.bake.simpler import closed, simpler
from msb.bake.solid import compacted, mended, parted
from msb.bake.space import Space
from msb.bake.surface import enclosed
from msb.base.children import Arrays, run_apart
from msb.base.limits import Limits
from msb.cl import Device
from msb.errors import AssetError, MeshError
from msb.meshes.mesh import Mesh
from msb.scenes import Camera
from msb.topology.faces import signed_volume
from msb.topology.hulls import HULL_CORNERS
from msb.topology.weld import weld_vertices

SECONDS = 20.0
# Distance from the visible surface, relative to its diagonal, above which a shape protrudes.
MID_AIR = 0.02
_NEARER = MID_AIR / 2  # sides that no camera sees are moved this close, unless they are far
# Pixels of the largest depth map that encloses an open mesh; finer ones look into every crack.
PIXELS = 1 << 16
# Cells along the longest side of the enclosing grid, for an object and for a scene; cells around an
# object.
_CELLS, _MARGIN = (96, 224), 1.0
_SKY = 1.9  # radius inside a scene's space beyond which all is sky: ten times the near radius
# Of a scene: the share of the faces on the visible side, and the thickness in near radii.
_FRONT, _BEHIND = 0.45, 0.02
_AT_FIRST = 8  # a surface is simplified to this multiple of its face budget first
_MOST_HULLS = 256
_TOUCHING = 1e-3  # distance from a part, relative to the diagonal, below which it covers a point
_SOLID_FACES = 2000  # faces of a closed surface given to CoACD, whose cost grows with them
# CoACD's samples on a surface and its tries of a cut; below its defaults, so that it ends in time.
_SAMPLES, _TRIES = 1000, 60
_LEAST = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class Collision:
    """A shape to bump into, and how well it stands in for what is seen.

    Attributes
    ----------
    mesh : Mesh
        Closed and consistently wound: hulls and a box outwards, a mesh as what is seen. float32, without
        colours. The parts of several follow each other.
    kind : {"mesh", "hulls", "box"}
        What it is, which is not always what was asked for.
    parts : int
        The number of convex parts of "hulls"; 1 of a mesh.
    mean_distance : float
        How far what cameras see is from it in the mean, of that one's diagonal; points all over the visible
        mesh where there are no cameras.
    mid_air_share : float
        The share of the area one can touch that is farther than 2 % of the diagonal from the visible mesh.
    why : str
        Why it is not what was asked for; else empty.
    """

    mesh: Mesh
    kind: ShapeKind
    parts: int
    mean_distance: float
    mid_air_share: float
    why: str = ""


def collision(
    mesh: Mesh,
    kind: str,
    cameras: Sequence[Camera] = (),
    *,
    seconds: float = SECONDS,
    device: str | Device | None = None,
) -> Collision:
    """Return a shape of this `kind` to bump into in the place of `mesh`, or the nearest there can be.

    Parameters
    ----------
    mesh : Mesh
        What is seen.
    kind : str
        "mesh:N", a surface of about N faces; "hulls:N", up to N convex parts that CoACD cuts the solid into;
        "box", one box, turned to be small. Where neither the mesh is closed nor what cameras see of it
        encloses anything, a mesh becomes hulls. Of a scene, and where CoACD does not end, hulls are those of
        patches, which are hollow between them.
    cameras : sequence of Camera
        From where it is looked at: what they see of a mesh that is not closed is enclosed, and a surface has
        most faces where they look.
    seconds : float
        The time that CoACD has.
    device : str or Device, optional
        What draws for the cameras.

    Raises
    ------
    UsageError
        USAGE: there is no such kind. EXTRA_MISSING: an open mesh needs scikit-image, which is not installed.
    MeshError
        MESH_ARRAY: there is no face. MESH_NONFINITE: a corner is not finite.
    DeviceError
    """
    wanted, count = parse_collision(kind)
    shown, space = _shown(mesh, cameras, device)
    seen, faces, middle, size = _in_unit(mesh, shown)
    surface = seen, faces
    if space is not None:
        space = replace(space, center=(space.center - middle) / size, radius=space.radius / size)
    # Sample points of the visible surface: from the cameras' pixels, else all over the mesh.
    places = (shown[:: -(-len(shown) // POINTS)] - middle) / size if len(shown) else spread(*surface)[0]
    solid = surface if closed(*surface) else None
    if solid is None and len(shown) and wanted != "box":
        points, around = _enclosed(mesh, cameras, device)
        points = (points - middle) / size
        if space is not None and not space.contracted:
            points = _nearer(points, *surface)
        # The enclosure of a thin sheet is far thicker, and is not used.
        if len(around) and distances(places, points, around).mean() < MID_AIR / 2:
            solid = points, around
    made, parts, why = _shape(wanted, count, surface, solid, space, seconds)
    # One mesh of all parts, back in the asset's unit.
    starts = np.cumsum([0, *(len(points) for points, _ in parts)])
    points = np.concatenate([points for points, _ in parts])
    joined = np.concatenate([own + start for (_, own), start in zip(parts, starts[:-1], strict=True)])
    shape = Mesh((middle + size * points).astype(np.float32), joined, up=mesh.up)
    near = float(distances(places, points, joined).mean())
    mid_air = _mid_air(parts, (points, joined), surface)
    return Collision(parted(shape) if made == "mesh" else shape, made, len(parts), near, mid_air, why)


def _shape(
    wanted: ShapeKind, count: int, surface: Part, solid: Part | None, space: Space | None, seconds: float
) -> tuple[ShapeKind, list[Part], str]:
    """Return the kind and the parts of a shape, and the reason if it is not the wanted one.

    `solid` is the closed surface, if there is one; `space` is None if no camera sees the mesh.
    """
    if wanted == "box":
        return "box", [smallest_box(surface[0])], ""
    if solid is None:
        hulls = count if wanted == "hulls" else max(1, count // PATCH_CORNERS)
        why = "the mesh is not closed" + (
            "" if space is None else ", and what is seen of it encloses nothing"
        )
        return "hulls", _patch_hulls(surface, hulls), why
    if space is not None and space.contracted:
        patch = _near(solid, surface, space)
        if wanted == "mesh":
            return "mesh", [_sheet(patch, count, space)], ""
        return "hulls", _patch_hulls(patch, count), "of a scene these are hulls of patches of it"
    if wanted == "mesh":
        return "mesh", [_fewer(solid, count)], ""
    if signed_volume(*solid) <= 0:
        why = "the surface looks inward: these are hulls of patches of it"
        return "hulls", _patch_hulls(surface, count), why
    parts, why = _cut_by_coacd(*solid, count, seconds)
    return "hulls", parts or _patch_hulls(surface, count), why


def _patch_hulls(surface: Part, count: int) -> list[Part]:
    return [hull_of(patch) for patch in patches_of(*surface, min(count, _MOST_HULLS))]


def _shown(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> tuple[Floats, Space | None]:
    """Return places (n, 3) of the world that cameras see, evenly over their pixels and the sky left out, and
    the space by which these are looked at; none without cameras."""
    points = seen_points(mesh, cameras, device)
    if not len(points):
        return points, None
    space = Space.of(points, cameras)
    if space.contracted:
        points = points[np.linalg.norm(space.inward(points), axis=1) < _SKY]
    return points, space


def _in_unit(mesh: Mesh, shown: Floats) -> tuple[Floats, Ints, Floats, float]:
    """Return the mesh about the middle of what is shown in units of its diagonal, and these two; those of the
    mesh where nothing is.

    If it is not closed, vertices in one place are merged: they may be doubled for colours alone.
    """
    if not len(mesh.faces):
        raise MeshError("MESH_ARRAY", "a mesh without faces has no collision mesh")
    points, faces = mesh.vertices, mesh.faces
    if not closed(points, faces):
        points, faces = weld_vertices(points, faces, "exact")
    used, number = np.unique(faces, return_inverse=True)
    points, faces = points[used].astype(np.float64), number.reshape(-1, 3).astype(np.int64)
    if not np.isfinite(points).all():
        raise MeshError(
            "MESH_NONFINITE", "a corner of a face is not finite; a collision mesh needs them finite"
        )
    bounds = shown if len(shown) else points
    low, high = bounds.min(axis=0), bounds.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
    return (points - middle) / size, faces, middle, size


def _enclosed(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> Part:
    """Return the closed surface of what cameras see of a mesh, in the world; without a face if they enclose
    nothing."""
    need_enclosure()
    try:
        points, faces, space = enclosed(mesh, cameras, _CELLS, _MARGIN, device=device)
    except AssetError:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    return space.outward(points), faces


def _nearer(points: Floats, seen: Floats, faces: Ints) -> Floats:
    """Return the points of what encloses an object with those nearer that lie a little too far from it.

    Sides that no camera looks at are closed flat, as the bottom of a plate that has a rim."""
    from scipy.spatial import cKDTree

    marks = spread(seen, faces)[0]
    away, mark = cKDTree(marks).query(points, workers=-1)
    little = (away > _NEARER) & (away < 2 * MID_AIR)
    to = marks[mark[little]]
    points[little] = to + (points[little] - to) * (_NEARER / away[little])[:, None]
    return points


def _fewer(solid: Part, count: int) -> Part:
    """Return a surface of about so many faces, no more than it has; of more where it would lose its shape."""
    finer = simpler(*solid, _AT_FIRST * count)  # at once it is far worse
    made = simpler(*finer, count)
    # On its way to faces that it cannot spare the library eats whole sides.
    while count < len(made[1]) < len(finer[1]) and distances(spread(*finer)[0], *made).mean() > MID_AIR:
        count *= 2
        made = simpler(*finer, count)
    return made


def _fewer_far(surface: Part, count: int, space: Space) -> Part:
    """Return a surface of about so many faces, most of them where cameras look.

    Errors count as in a space where lengths beyond what is near grow as their root.
    """
    away = (surface[0] - space.center) / space.radius
    inside, faces = _fewer((away / np.sqrt(_beyond(away)), surface[1]), count)
    return compacted(space.center + space.radius * inside * _beyond(inside), faces)


def _near(solid: Part, seen: Part, space: Space) -> Part:
    """Return the faces of what encloses a scene that stand where something is seen, and no sky."""
    points, faces = solid
    near = (np.linalg.norm(space.inward(points), axis=1) < _SKY)[faces].all(axis=1)
    near[near] = distances(points[faces[near]].mean(axis=1), *seen) < MID_AIR
    return compacted(points, faces[near if near.any() else slice(None)])


def _sheet(patch: Part, count: int, space: Space) -> Part:
    """Return a surface of about so many faces, a little thick: with a back side and rims, so that it is
    closed."""
    points, faces = _fewer_far(patch, max(1, int(_FRONT * count)), space)
    # Vertex normals (V, 3), weighted by area, and the back side at a distance along them.
    corners = points[faces]
    normals = np.zeros_like(points)
    np.add.at(normals, faces, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), _LEAST)
    back = points - _BEHIND * space.radius * normals
    # Edges (n, 2) that no other face runs along the other way: the rims, which get two faces each.
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    lone = sides[~np.isin(sides[:, 0] * len(points) + sides[:, 1], sides[:, 1] * len(points) + sides[:, 0])]
    a, b = lone.T
    c, d = a + len(points), b + len(points)
    rims = np.concatenate([np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)])
    return mended(np.concatenate([points, back]), np.concatenate([faces, faces[:, ::-1] + len(points), rims]))


def _beyond(away: Floats) -> Floats:
    """Return how far away points (n, 3) are, (n, 1), at least 1."""
    found: Floats = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1)
    return found


def _cut_by_coacd(points: Floats, faces: Ints, most: int, seconds: float) -> tuple[list[Part], str]:
    """Return at most so many convex parts of a closed surface, and why there are none."""
    points, faces = simpler(points, faces, _SOLID_FACES)
    reply = run_apart(convex_parts, str(most), {"points": points, "faces": faces}, Limits(seconds))
    if reply.why:
        return (
            [],
            f"CoACD does not cut the solid, {reply.why}: these are hulls of patches of its surface",
        )
    made = reply.arrays
    split = (np.split(made[of], np.cumsum(made[f"{of} of each"])[:-1]) for of in ("points", "faces"))
    parts = zip(*split, strict=True)
    return [(own, rows if signed_volume(own, rows) >= 0 else rows[:, ::-1]) for own, rows in parts], ""


def convex_parts(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Cut a mesh into at most `word` convex parts; a `Work` of `msb.base.children`."""
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(arrays["points"], arrays["faces"].astype(np.int32)),
        max_convex_hull=int(word),
        resolution=_SAMPLES,
        mcts_iterations=_TRIES,
        max_ch_vertex=HULL_CORNERS,
    )
    if not parts:
        raise ValueError("it gives no part")
    made: dict[str, NDArray[Any]] = {}
    for of, rows, kind in zip(
        ("points", "faces"), zip(*parts, strict=True), (np.float64, np.int64), strict=True
    ):
        made[of] = np.concatenate([np.asarray(one, kind) for one in rows])
        made[f"{of} of each"] = np.array([len(one) for one in rows])
    return None, made


def _mid_air(parts: list[Part], shape: Part, seen: Part) -> float:
    """Return the share of a shape's area that is far from what is `seen`, of what no other part covers."""
    # Points all over the shape, and the part of each.
    places, face = spread(*shape)
    of = np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts])[face]
    free = np.ones(len(places), bool)
    # A point counts only if it is outside of all other parts, which are convex: above one of their planes.
    for number, (points, faces) in enumerate(parts if len(parts) > 1 else ()):
        corners = points[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), _LEAST)
        others = np.flatnonzero(free & (of != number))
        above = places[others] @ normal.T - (normal * corners[:, 0]).sum(axis=1)
        free[others[(above <= _TOUCHING).all(axis=1)]] = False
    if not free.any():
        return 0.0
    return float((distances(places[free], *seen) > MID_AIR).mean())
