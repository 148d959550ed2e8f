"""Collision shapes: closed meshes of few faces near the visible surface of a mesh.

A collision shape is made of a closed surface: the mesh itself, or an enclosure of the visible parts of an
open mesh. For an object, the closed surface is reduced to fewer faces, or CoACD cuts it into convex parts.
For a scene, the collision shape is a thin sheet behind the visible surface. If there is no closed surface,
convex hulls of patches of the mesh are used. The field `kind` of a `Collision` names the shape that was made.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from msb.bake.arrays import Floats, Ints
from msb.bake.candidate_surface import enclose
from msb.bake.closed_mesh import drop_unused_points, repair_closed, separate_vertices
from msb.bake.depth_fusion import find_visible_points
from msb.bake.requirements import need_enclosure
from msb.bake.simplification import is_closed_surface, simplify
from msb.bake.space import Space
from msb.cl import Device
from msb.delivery.collision_kinds import CollisionKind, parse_collision
from msb.delivery.collision_shapes import (
    COACD_FACES,
    PROTRUSION,
    cut_convex,
    make_patch_hulls,
    measure_protrusion,
)
from msb.delivery.hulls import PATCH_CORNERS, PointsAndFaces, fit_box
from msb.delivery.surface_distance import POINTS, measure_distances, sample_surface
from msb.errors import AssetError, MeshError
from msb.meshes.mesh import Mesh
from msb.scenes import Camera
from msb.topology.faces import signed_volume
from msb.topology.weld import weld_vertices

# All lengths are relative to the diagonal of the bounding box of the visible surface.

# Default time limit of CoACD in seconds. CoACD can run for minutes, and does not end for some surfaces.
SECONDS = 20.0
# An unseen side of an enclosure moves to this distance from the mesh. Only sides within `2 * PROTRUSION` of
# the mesh are moved. These sides do not count as protruding.
_NEAR = PROTRUSION / 2

# Parameters of the enclosure of an open mesh.
#
# Number of pixels of the largest depth map. With larger depth maps, the enclosure would reach into every
# crack.
PIXELS = 1 << 16
# Number of grid cells along the longest side, for an object and for a scene. `_MARGIN` is the margin around
# an object in grid cells. With fewer grid cells, the sheet of a scene has ragged rims.
_CELLS, _MARGIN = (96, 224), 1.0
# Radius in the coordinates of a scene. Everything beyond this radius counts as sky. The sky radius is ten
# times the near radius in world coordinates.
_SKY_RADIUS = 1.9

# Shapes.
#
# Share of the faces on the visible side of a sheet, and thickness of the sheet in near radii. The remaining
# faces form the back and the rims of the sheet.
_FRONT_SHARE, _SHEET_THICKNESS = 0.45, 0.02
# A surface is first simplified to this multiple of its face budget, then to the budget. Simplification in a
# single step would give a far worse shape.
_FIRST_STEP_FACTOR = 8
_TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class Collision:
    """A collision shape, with measures of how well it approximates the visible surface.

    Attributes
    ----------
    mesh : Mesh
        Closed and consistently wound float32 mesh without colours. Hulls and boxes are wound outwards. A mesh
        keeps the winding of the visible surface. The faces are sorted by hull.
    kind : {"mesh", "hulls", "box"}
        The kind of the shape, which may differ from the requested kind.
    parts : int
        The number of convex parts for the kind "hulls", else 1.
    mean_distance : float
        Average distance from the visible surface to the shape, as a share of the diagonal. The visible
        surface is the part of the mesh that the cameras see, or the whole mesh if there are no cameras.
    mid_air_share : float
        Share of the shape's exposed area that is farther than 2 % of the diagonal from the mesh.
    why : str
        The reason if the kind differs from the requested one, else empty.
    """

    mesh: Mesh
    kind: CollisionKind
    parts: int
    mean_distance: float
    mid_air_share: float
    why: str = ""


def make_collision(
    mesh: Mesh,
    kind: str,
    cameras: Sequence[Camera] = (),
    *,
    seconds: float = SECONDS,
    device: str | Device | None = None,
) -> Collision:
    """Return a collision shape of this `kind` for `mesh`.

    If the requested kind cannot be made, return the most similar possible kind.

    Parameters
    ----------
    mesh : Mesh
        The rendered mesh.
    kind : str
        "mesh:N": a surface of about N faces. "hulls:N": up to N convex parts, which CoACD cuts the solid
        into. "box": one box, rotated so that its volume is small. If neither the mesh nor its enclosure is
        closed, hulls are made instead of a mesh. A scene gets hulls of surface patches. Other meshes also get
        hulls of patches if CoACD does not finish.
    cameras : sequence of Camera
        The parts of an open mesh that these cameras see are enclosed. A surface of a scene has most of its
        faces near the cameras.
    seconds : float
        The time limit of CoACD.
    device : str or Device, optional
        The OpenCL device.

    Raises
    ------
    UsageError
        USAGE: the kind is invalid. EXTRA_MISSING: the mesh is open and scikit-image, which encloses it, is
        not installed.
    MeshError
        MESH_ARRAY: the mesh has no faces. MESH_NONFINITE: a corner is not finite.
    DeviceError
    """
    requested, count = parse_collision(kind)
    visible, space = _find_visible(mesh, cameras, device)
    # From here on, the unit of length is the diagonal of the visible surface, and the origin is its centre.
    points, faces, middle, size = _normalize(mesh, visible)
    surface = points, faces
    if space is not None:
        space = replace(space, center=(space.center - middle) / size, radius=space.radius / size)
    # Sample points (n, 3) of the visible surface. If no camera sees the surface, the points are spread over
    # the whole mesh.
    step = -(-len(visible) // POINTS)
    samples = (visible[::step] - middle) / size if len(visible) else sample_surface(*surface)[0]
    solid = surface if is_closed_surface(*surface) else None
    if solid is None and len(visible) and requested != "box":
        enclosure, around = _enclose(mesh, cameras, device)
        enclosure = (enclosure - middle) / size
        if space is not None and not space.contracted:
            enclosure = _pull_nearer(enclosure, *surface)
        if len(around) and measure_distances(samples, enclosure, around).mean() < PROTRUSION / 2:
            solid = enclosure, around
    actual_kind, parts, why = _make_parts(requested, count, surface, solid, space, seconds)
    # Join all parts into one mesh, in the unit of the asset.
    starts = np.cumsum([0, *(len(corners) for corners, _ in parts)])
    joined = (
        np.concatenate([corners for corners, _ in parts]),
        np.concatenate([rows + start for (_, rows), start in zip(parts, starts[:-1], strict=True)]),
    )
    shape = Mesh((middle + size * joined[0]).astype(np.float32), joined[1], up=mesh.up)
    distance = float(measure_distances(samples, *joined).mean())
    protruding = measure_protrusion(parts, joined, surface)
    shape = separate_vertices(shape) if actual_kind == "mesh" else shape
    return Collision(shape, actual_kind, len(parts), distance, protruding, why)


def _make_parts(
    requested: CollisionKind,
    count: int,
    surface: PointsAndFaces,
    solid: PointsAndFaces | None,
    space: Space | None,
    seconds: float,
) -> tuple[CollisionKind, list[PointsAndFaces], str]:
    """Return the kind and the parts of a shape.

    If the kind differs from the requested kind, also return the reason. The argument `surface` is the visible
    mesh. The argument `solid` is the closed surface of the mesh, or None. The argument `space` is None if no
    camera sees the mesh.
    """
    if requested == "box":
        return "box", [fit_box(surface[0])], ""
    if solid is None:
        hulls = count if requested == "hulls" else max(1, count // PATCH_CORNERS)
        why = "the mesh is not closed, so hulls of patches of its surface are used"
        if space is not None:
            why = "the mesh is not closed and encloses nothing, so hulls of patches of its surface are used"
        return "hulls", make_patch_hulls(surface, hulls), why
    if space is not None and space.contracted:
        patch = _drop_sky(solid, surface, space)
        if requested == "mesh":
            return "mesh", [_make_sheet(patch, count, space)], ""
        return (
            "hulls",
            make_patch_hulls(patch, count),
            "for a scene, hulls of patches of its surface are used",
        )
    if requested == "mesh":
        return "mesh", [_reduce(solid, count)], ""
    if signed_volume(*solid) <= 0:
        why = "the surface is wound inwards, so hulls of patches of it are used"
        return "hulls", make_patch_hulls(surface, count), why
    parts, why = cut_convex(*simplify(*solid, COACD_FACES), count, seconds)
    return "hulls", parts or make_patch_hulls(surface, count), why


def _find_visible(
    mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None
) -> tuple[Floats, Space | None]:
    """Return the visible world points (n, 3) without the sky. Also return the `Space` of these points.

    The space is None if no point is visible.
    """
    points = find_visible_points(mesh, cameras, device)
    if not len(points):
        return points, None
    space = Space.fit(points, cameras)
    if space.contracted:
        points = points[np.linalg.norm(space.from_world(points), axis=1) < _SKY_RADIUS]
    return points, space


def _normalize(mesh: Mesh, visible: Floats) -> tuple[Floats, Ints, Floats, float]:
    """Normalise the mesh. Return its points relative to an origin, in a unit of length, and its faces.

    Also return the origin and the unit. The origin is the centre of the visible points (n, 3). The unit is
    the diagonal of the bounding box of these points. Without visible points, all points of the mesh are used.
    Colour seams may store several vertices at one position. Merge such vertices in an open mesh.
    """
    if not len(mesh.faces):
        raise MeshError("MESH_ARRAY", "the mesh has no faces, so no collision shape can be made")
    points, faces = mesh.vertices, mesh.faces
    if not is_closed_surface(points, faces):
        points, faces = weld_vertices(points, faces, "exact")
    used, number = np.unique(faces, return_inverse=True)
    points, faces = points[used].astype(np.float64), number.reshape(-1, 3).astype(np.int64)
    if not np.isfinite(points).all():
        raise MeshError(
            "MESH_NONFINITE",
            "a corner of a face is not finite; remove the face or correct the corner's coordinates",
        )
    bounds = visible if len(visible) else points
    low, high = bounds.min(axis=0), bounds.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
    return (points - middle) / size, faces, middle, size


def _enclose(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> PointsAndFaces:
    """Return the enclosure of the visible parts of a mesh in world coordinates.

    The enclosure may have no faces.
    """
    need_enclosure()
    try:
        points, faces, space = enclose(mesh, cameras, _CELLS, _MARGIN, device=device)
    except AssetError:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    return space.to_world(points), faces


def _pull_nearer(points: Floats, seen: Floats, faces: Ints) -> Floats:
    """Return the points of an enclosure after moving slightly protruding points towards the mesh.

    Unseen sides are closed by flat areas. Such an area can protrude, for example below a plate with a rim.
    """
    from scipy.spatial import cKDTree

    marks = sample_surface(seen, faces)[0]
    distance, nearest = cKDTree(marks).query(points, workers=-1)
    is_near = (distance > _NEAR) & (distance < 2 * PROTRUSION)
    target = marks[nearest[is_near]]
    points[is_near] = target + (points[is_near] - target) * (_NEAR / distance[is_near])[:, None]
    return points


def _reduce(solid: PointsAndFaces, count: int) -> PointsAndFaces:
    """Reduce a surface to about `count` faces, or to more faces if the shape would be destroyed."""
    finer = simplify(*solid, _FIRST_STEP_FACTOR * count)
    reduced = simplify(*finer, count)
    # If the library cannot reach the requested count, the library removes whole sides. In that case, allow
    # twice as many faces.
    while count < len(reduced[1]) < len(finer[1]):
        if measure_distances(sample_surface(*finer)[0], *reduced).mean() <= PROTRUSION:
            break
        count *= 2
        reduced = simplify(*finer, count)
    return reduced


def _reduce_scene(surface: PointsAndFaces, count: int, space: Space) -> PointsAndFaces:
    """Reduce a surface to about `count` faces, most of them near the cameras.

    Beyond the near radius, distances from the middle are replaced by their square roots before the reduction.
    """
    offset = (surface[0] - space.center) / space.radius
    inside, faces = _reduce((offset / np.sqrt(_measure_far_factor(offset)), surface[1]), count)
    return drop_unused_points(space.center + space.radius * inside * _measure_far_factor(inside), faces)


def _drop_sky(solid: PointsAndFaces, seen: PointsAndFaces, space: Space) -> PointsAndFaces:
    """Return the faces of a scene's enclosure that lie near the mesh and do not belong to the sky."""
    points, faces = solid
    is_near = (np.linalg.norm(space.from_world(points), axis=1) < _SKY_RADIUS)[faces].all(axis=1)
    is_near[is_near] = measure_distances(points[faces[is_near]].mean(axis=1), *seen) < PROTRUSION
    return drop_unused_points(points, faces[is_near if is_near.any() else slice(None)])


def _make_sheet(patch: PointsAndFaces, count: int, space: Space) -> PointsAndFaces:
    """Return a closed sheet of about `count` faces: a visible side, a back side, and rims."""
    points, faces = _reduce_scene(patch, max(1, int(_FRONT_SHARE * count)), space)
    # Offset the back side along the vertex normals (V, 3). Each normal is a sum of face normals weighted by
    # area.
    corners = points[faces]
    normals = np.zeros_like(points)
    np.add.at(normals, faces, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), _TINY)
    back = points - _SHEET_THICKNESS * space.radius * normals
    # Find the boundary edges (n, 2), which only one face has. Each boundary edge gets two rim faces.
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    keys, reverse = sides[:, 0] * len(points) + sides[:, 1], sides[:, 1] * len(points) + sides[:, 0]
    a, b = sides[~np.isin(keys, reverse)].T
    c, d = a + len(points), b + len(points)
    rims = np.concatenate([np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)])
    # Join both sides and the rims into one mesh, and repair folds of the back side.
    joined = np.concatenate([faces, faces[:, ::-1] + len(points), rims])
    return repair_closed(np.concatenate([points, back]), joined)


def _measure_far_factor(offset: Floats) -> Floats:
    """Return the distance (n, 1) of points (n, 3) from the origin, at least 1."""
    factor: Floats = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1)
    return factor
