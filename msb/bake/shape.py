"""The shape of a surface: how strongly it bends, and how far it is from a true surface.

PSNR cannot detect dents, because unlit images of a dented surface look right. For 16 surfaces of one object,
the average angle to the true normals was known. The rank correlation of this angle was 0.95 with the
bending, and 0.02 with PSNR.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Ints, Mask
from msb.base.origin import NO_ORIGIN
from msb.cl import Device
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera
from msb.topology.faces import face_vectors

# An edge is a crease above this angle in degrees. A pixel's normal counts as wrong above the same angle.
SHARP = 30.0
# If the depths of two surfaces at a pixel differ by more than this share of the size, the pixel shows
# different parts. Pixels that show different parts are excluded.
_MAX_DEPTH_SHARE = 0.05
# The size is measured with a box that excludes this percentage of the visible points at each side.
_TRIM_PERCENT = 1.0


@dataclass(frozen=True)
class Bending:
    """Measures of how strongly the visible part of a surface bends.

    Attributes
    ----------
    bending : float
        S sum(l angle) / sum(A) over all edges between two visible faces. S is the size of the visible part,
        and A is the area of a visible face. l is the length of an edge, and the angle in radians is between
        the normals of its faces. The true surfaces of the demo models have a bending of 5 to 6.
    creases : float
        S sum(l) / sum(A), over the edges with an angle above 30 degrees only.
    """

    bending: float
    creases: float


@dataclass(frozen=True)
class TrueShape:
    """A comparison of a surface with a true surface, over the pixels of some views that show both surfaces.

    If no pixel shows both surfaces, all numbers except `excluded` and `outline` are NaN.

    Attributes
    ----------
    mean, median : float
        The angle in degrees between the normals of the visible faces.
    above_30 : float
        The share of the pixels with an angle above 30 degrees.
    smooth_mean : float
        The average angle in degrees between interpolated vertex normals.
    depth : float
        The average difference of the depths, relative to the size of the true surface.
    excluded : float
        The share of the pixels that were not compared, because the depths differ by more than 5 % of the
        size.
    outline : float
        The number of pixels that show both surfaces, divided by the number of pixels that show at least one
        surface.
    """

    mean: float
    median: float
    above_30: float
    smooth_mean: float
    depth: float
    excluded: float
    outline: float


def measure_bending(points: Floats, faces: Ints, visible: Mask, size: float = 1.0) -> Bending:
    """Return the bending of the `visible` (F,) faces (F, 3). Vertices at one place are joined.

    The argument `size` is the size S of the visible part in scene units. The ratio of two bendings does not
    depend on the size.
    """
    _, place = np.unique(points.astype(np.float32), axis=0, return_inverse=True)
    faces = place.reshape(-1)[faces[visible]]
    merged = np.zeros((place.max(initial=-1) + 1, 3))
    merged[place.reshape(-1)] = points
    vectors = face_vectors(merged, faces)
    doubled = np.linalg.norm(vectors, axis=1)
    area = doubled.sum() / 2
    if not area > 0:
        return Bending(0.0, 0.0)
    normals = vectors / np.maximum(doubled, 1e-300)[:, None]
    # Sort the sides (3F, 2) of the faces, so that the two sides of an edge are neighbours.
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    first, second = order[:-1], order[1:]
    is_edge = (sides[first] == sides[second]).all(axis=1)
    first, second = first[is_edge], second[is_edge]
    # The two faces of an edge traverse the edge in opposite directions if their winding is consistent.
    # Otherwise, reverse one normal.
    starts = faces.reshape(-1)
    sign = np.where(starts[first] == starts[second], -1.0, 1.0)
    cosine = sign * np.einsum("nk,nk->n", normals[owner[first]], normals[owner[second]])
    angles = np.arccos(np.clip(cosine, -1, 1))
    lengths = np.linalg.norm(merged[sides[first, 0]] - merged[sides[first, 1]], axis=1)
    is_sharp = angles > np.radians(SHARP)
    return Bending(
        float(size * (lengths * angles).sum() / area), float(size * lengths[is_sharp].sum() / area)
    )


def measure_visible_bending(
    mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None = None
) -> Bending:
    """Return the bending of the part of a mesh that the cameras see."""
    views = list(_draw_views(mesh, cameras, device))
    size = _measure_size([view.points(camera) for view, camera in zip(views, cameras, strict=True)])
    visible = np.zeros(len(mesh.faces), bool)
    for view in views:
        visible[view.face[view.face >= 0]] = True
    return measure_bending(mesh.vertices.astype(np.float64), mesh.faces, visible, size)


def compare_with_truth(
    mesh: Mesh, truth: Mesh, cameras: Sequence[Camera], device: str | Device | None = None
) -> TrueShape:
    """Compare a mesh with a true surface, in pixels that show both surfaces at nearly equal depths.

    Normals that point away from the camera are reversed, so the winding has no influence.
    """
    baked, true = (list(_draw_views(part, cameras, device)) for part in (mesh, truth))
    size = _measure_size([view.points(camera) for view, camera in zip(true, cameras, strict=True)])
    smooth = [_vertex_normals(part) for part in (mesh, truth)]
    angles, smooth_angles, depths = [], [], []
    both = either = compared = 0
    for camera, *pair in zip(cameras, baked, true, strict=True):
        shown = [view.face >= 0 for view in pair]
        both += int((shown[0] & shown[1]).sum())
        either += int((shown[0] | shown[1]).sum())
        # Select pixels that show both surfaces at nearly equal depths.
        difference = np.abs(pair[0].depth - pair[1].depth)
        rows = np.nonzero(shown[0] & shown[1] & (difference <= _MAX_DEPTH_SHARE * size))
        compared += len(rows[0])
        depths.append(difference[rows])
        flat, round_ = [], []
        for view, part, normals in zip(pair, (mesh, truth), smooth, strict=True):
            flat.append(view.face_normals(part, rows))
            round_.append(view.interpolated_normals(part, normals, camera, rows))
        rays = pair[1].points(camera, rows) - camera.center
        angles.append(_angles(*(_turn_to(normals, rays) for normals in flat)))
        smooth_angles.append(_angles(*(_turn_to(normals, rays) for normals in round_)))
    angle, smooth_angle, depth = map(np.concatenate, (angles, smooth_angles, depths))
    if not compared:
        nan = float("nan")
        return TrueShape(nan, nan, nan, nan, nan, 1.0, both / max(either, 1))
    return TrueShape(
        mean=float(angle.mean()),
        median=float(np.median(angle)),
        above_30=float((angle > SHARP).mean()),
        smooth_mean=float(smooth_angle.mean()),
        depth=float(depth.mean() / size),
        excluded=1 - compared / max(both, 1),
        outline=both / max(either, 1),
    )


@dataclass(frozen=True, eq=False)
class _View:
    """A view of a mesh: face indices (H, W) and depths (H, W) along the camera's axis.

    The face index is -1 at a pixel without a face.
    """

    face: NDArray[np.int32]
    depth: Floats

    def points(self, camera: Camera, rows: tuple[NDArray[np.int64], ...] | None = None) -> Floats:
        """Return the visible world points (n, 3) of all pixels with a face, or of the pixels `rows`."""
        row, column = np.nonzero(self.face >= 0) if rows is None else rows
        z = self.depth[row, column]
        x, y = (column + 0.5 - camera.cx) / camera.fx * z, (row + 0.5 - camera.cy) / camera.fy * z
        local = np.stack([x, y, z, np.ones_like(z)], axis=1)
        points: Floats = (local @ camera.camera_to_world.T)[:, :3]
        return points

    def face_normals(self, mesh: Mesh, rows: tuple[NDArray[np.int64], ...]) -> Floats:
        """Return the unit normals (n, 3) of the faces at the pixels `rows`."""
        return _unit(face_vectors(mesh.vertices.astype(np.float64), mesh.faces[self.face[rows]]))

    def interpolated_normals(
        self, mesh: Mesh, normals: Floats, camera: Camera, rows: tuple[NDArray[np.int64], ...]
    ) -> Floats:
        """Return the vertex normals, interpolated at the pixels `rows`, as unit vectors (n, 3)."""
        faces = mesh.faces[self.face[rows]]
        a, b, c = mesh.vertices.astype(np.float64)[faces].transpose(1, 0, 2)
        # Compute barycentric coordinates (n, 3) of the visible points from the areas of the three parts of a
        # face.
        point = self.points(camera, rows)
        whole = np.cross(b - a, c - a)
        square = np.maximum((whole * whole).sum(axis=1), 1e-300)
        v = (np.cross(point - a, c - a) * whole).sum(axis=1) / square
        w = (np.cross(b - a, point - a) * whole).sum(axis=1) / square
        weights = np.stack([1 - v - w, v, w], axis=1)
        return _unit((weights[:, :, None] * normals[faces]).sum(axis=1))


def _draw_views(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> Iterator[_View]:
    """Yield the visible faces and depths of a mesh in each view, sampled at pixel centres."""
    # A mesh without colours would be drawn with lighting.
    black = Mesh(mesh.vertices, mesh.faces, np.zeros((len(mesh.vertices), 3), np.uint8))
    with Renderer(asset_from_mesh(black, origin=NO_ORIGIN), "standard", device) as renderer:
        for camera in cameras:
            frame = renderer.render(camera)
            assert frame.face_id is not None
            yield _View(frame.face_id, frame.depth.astype(np.float64))


def _measure_size(points: Sequence[Floats]) -> float:
    """Return the diagonal of the bounding box of the visible points. The outermost points at each side are
    ignored."""
    together = np.concatenate(points)
    if not len(together):
        return 1.0
    low, high = np.percentile(together, [_TRIM_PERCENT, 100 - _TRIM_PERCENT], axis=0)
    return float(np.linalg.norm(high - low)) or 1.0


def _vertex_normals(mesh: Mesh) -> Floats:
    """Return unit vertex normals (V, 3): the sums of area-weighted face normals at each place."""
    points = mesh.vertices.astype(np.float64)
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    index = place.reshape(-1)[mesh.faces]
    vectors = face_vectors(points, mesh.faces)
    rows = np.repeat(vectors, 3, axis=0)
    count = int(index.max(initial=-1)) + 1
    sums: Floats = np.stack(
        [np.bincount(index.reshape(-1), rows[:, axis], count) for axis in range(3)], axis=1
    ).astype(np.float64)
    return _unit(sums)[place.reshape(-1)]


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    result: Floats = vectors / np.maximum(length, 1e-300)
    return result


def _turn_to(normals: Floats, rays: Floats) -> Floats:
    """Return the normals (n, 3). Normals that point along the camera `rays` (n, 3) are reversed."""
    away = (normals * rays).sum(axis=1, keepdims=True) > 0
    return np.where(away, -normals, normals)


def _angles(first: Floats, second: Floats) -> Floats:
    """Return the angles (n,) in degrees between pairs of unit vectors."""
    angles: Floats = np.degrees(np.arccos(np.clip((first * second).sum(axis=1), -1, 1)))
    return angles
