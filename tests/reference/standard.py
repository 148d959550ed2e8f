"""The standard tier in float64 NumPy: an opaque z-buffer, one triangle at a time. Slow, easy to verify.

It follows the same rules as the OpenCL kernels (docs/standard.md) with different arithmetic: everything
except the exact integer edge functions is in double precision. Results differ if rounding decides: when a
corner snaps to the next step of the 1/4096 pixel grid, or along the line where two surfaces intersect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msb.asset.look import StaticColors, corner_tint
from msb.asset.texture import ROUNDING, Textured, linear_to_srgb, mip_levels, sample
from msb.reference.frame import ReferenceFrame

if TYPE_CHECKING:
    from msb.scenes import Camera

    Reals = NDArray[np.float64]

# Depth of the near plane in scene units.
NEAR = float(np.float32(0.01))
# Steps per pixel of the grid that projected corners are snapped to.
UNITS = 4096
# The guard band extends this many grid steps from the corner of the image. Triangles are clipped to the guard
# band, so that products fit into 64 bits.
GUARD = 0.75 * 2**29


class Pixels(NamedTuple):
    """The n pixels that a face covers: their rows, columns, 1 / z, corner weights (n, 3) and rays (n, 3)."""

    y: NDArray[np.int64]
    x: NDArray[np.int64]
    inverse_depth: Reals
    weights: Reals
    rays: Reals


def render_standard(
    positions: ArrayLike,
    indices: ArrayLike,
    colors: ArrayLike | None,
    domain: str,
    camera: Camera,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    visible: NDArray[np.bool_] | None = None,
    textured: Textured | None = None,
) -> ReferenceFrame:
    """Return a float64 frame of an opaque mesh with positions (V, 3) and indices (F, 3).

    Colours are (n, 3) or (n, 4) uint8, or floats, which are clamped to [0, 1]; a fourth channel is ignored.
    With `domain` "vertex", "face" or "corner", n is V, F or 3 F. Faces that are not `visible` (F,) are
    skipped and keep their numbers. Textures are multiplied by the colours. With textures the colours may be
    None.
    """
    points = np.asarray(positions, np.float64)
    faces = np.asarray(indices, np.int64)
    surface, rgb = None, np.zeros((0, 3))
    if colors is not None:
        stored = np.asarray(colors)[:, :3]
        rgb = np.clip(stored / (255.0 if stored.dtype == np.uint8 else 1.0), 0, 1)
    if textured is not None:
        tint = None if colors is None else StaticColors(np.asarray(colors), cast("Any", domain))
        surface = Surface(textured, tint, np.asarray(indices))
    pose = camera.world_to_camera
    local = points @ pose[:3, :3].T + pose[:3, 3]
    turn_normals = np.linalg.inv(pose[:3, :3])  # noqa: TID251 - independent of the code under test
    height, width = camera.height, camera.width
    nearest = np.zeros((height, width))
    face_id = np.full((height, width), -1, np.int32)
    image = np.empty((height, width, 3))  # noqa: TID251 - filled in the next line
    image[:] = background
    for face, corners in enumerate(faces):
        if visible is not None and not visible[face]:
            continue
        # Sort the corners by position, so that faces with the same corners get exactly the same depths.
        order = np.lexsort(points[corners].T[::-1])
        corners = corners[order]
        rows = {"vertex": corners, "face": np.full(3, face), "corner": 3 * face + order}[domain]
        near = nearest_corner(local[corners])
        # The normal is rotated afterwards, because differences of stored positions are exact.
        normal = np.cross(*(points[np.delete(corners, near)] - points[corners[near]])) @ turn_normals
        for y, x, depth, weights, rays in cover_pixels(local[corners], normal, camera):
            wins = depth > nearest[y, x]  # faces ascend, so the lowest number wins at equal depths
            if surface is None:
                colors_here = weights @ rgb[rows]
            else:
                light = surface.at(face, order, weights, steps_at(local[corners], rays, camera))
                wins &= surface.is_there(light)
                colors_here = np.clip(linear_to_srgb(light[:, :3]), 0, 1)
            y, x = y[wins], x[wins]
            nearest[y, x] = depth[wins]
            face_id[y, x] = face
            image[y, x] = colors_here[wins]
    hit = nearest > 0
    return ReferenceFrame(
        image=image,
        alpha=hit.astype(np.float64),
        depth=np.divide(1.0, nearest, out=np.zeros_like(nearest), where=hit),
        depth_median=None,
        normal=None,
        face_id=face_id,
        visible=np.ones(len(faces), bool) if visible is None else visible,
    )


def cover_pixels(corners: Reals, normal: Reals, camera: Camera) -> Iterator[Pixels]:
    """Yield the pixels of a face (3, 3) in camera coordinates; `normal` (3,) may have any length.

    Clipping may split the face into several triangles, which share no pixel and are yielded one by one.
    """
    outline = clip_face(corners, camera)
    if len(outline) < 3:
        return
    focal, principal = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    screen = outline[:, :2] / outline[:, 2:] * focal + principal
    snapped = np.trunc(screen * UNITS + 0.5).astype(np.int64)
    # The least and greatest 1 / z of the face behind the near plane.
    low, high = 1 / float(corners[:, 2].max()), 1 / max(float(corners[:, 2].min()), NEAR)
    first = corners[nearest_corner(corners)]
    for k in range(1, len(snapped) - 1):
        y, x = inside(snapped[[0, k, k + 1]], camera.width, camera.height)
        centers = np.stack([x + 0.5, y + 0.5], axis=-1)
        rays = np.concatenate([(centers - principal) / focal, np.ones((len(x), 1))], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.nan_to_num(rays @ normal / (normal @ first), nan=low, posinf=high, neginf=low)
        yield Pixels(y, x, np.clip(depth, low, high), weights_at(corners, rays), rays)


def nearest_corner(corners: Reals) -> int:
    """Return the index of the corner of a face (3, 3), in camera coordinates, nearest to the camera.

    At a corner that is a million times farther away, both edges have nearly the same direction. The cross
    product of these edges would not give the face's plane.
    """
    return int(np.argmin(np.abs(corners).max(axis=1)))


def clip_face(corners: Reals, camera: Camera) -> Reals:
    """Return a face clipped by the near plane and the guard band: (n, 3), n is 0 or at most 8.

    Sutherland and Hodgman, "Reentrant polygon clipping" (1974).
    """
    scale = UNITS * np.array([camera.fx, camera.fy])
    middle = UNITS * np.array([camera.cx, camera.cy])
    planes = [np.array([0.0, 0.0, 1.0, -NEAR])]
    for axis in range(2):
        for sign in (1.0, -1.0):  # sign * units + GUARD >= 0
            plane = np.array([0.0, 0.0, sign * middle[axis] + GUARD, 0.0])
            plane[axis] = sign * scale[axis]
            planes.append(plane)
    outline = list(corners)
    for plane in planes:
        distances = [float(plane[:3] @ point + plane[3]) for point in outline]
        kept = []
        for i, (point, d) in enumerate(zip(outline, distances, strict=True)):
            following, e = outline[(i + 1) % len(outline)], distances[(i + 1) % len(outline)]
            if d >= 0:
                kept.append(point)
            if (d >= 0) != (e >= 0):
                kept.append(point + d / (d - e) * (following - point))
        outline = kept
    return np.array(outline).reshape(-1, 3)


def inside(
    corners: NDArray[np.int64], width: int, height: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of the pixels whose centres a snapped triangle (3, 2) covers, exactly.

    A centre on an edge belongs to the triangle if that is a left or a top edge. So exactly one of two
    triangles that share an edge covers the centre.
    """
    low = np.maximum((corners.min(axis=0) + UNITS // 2 - 1) // UNITS, 0)
    high = np.minimum((corners.max(axis=0) - UNITS // 2) // UNITS, (width - 1, height - 1))
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    px, py = x * UNITS + UNITS // 2, y * UNITS + UNITS // 2
    (ux, uy), (vx, vy) = corners[1] - corners[0], corners[2] - corners[0]
    area = ux * vy - uy * vx
    has = np.full(x.shape, area != 0)
    for i in range(3):
        start, end = corners[i], corners[(i + 1) % 3]
        dx, dy = (end - start) * (1 if area > 0 else -1)
        edge = dx * (py - start[1]) - dy * (px - start[0])
        has &= edge >= 0 if dy < 0 or (dy == 0 and dx > 0) else edge > 0
    return y[has], x[has]


def weights_at(corners: Reals, rays: Reals) -> Reals:
    """Return the weights (n, 3) of a face's corners at the points where rays (n, 3) meet its plane.

    Each weight is proportional to the volume between the ray and the other two corners. Weights are clamped
    to the face, because snapping may have moved its border across a sample.
    """
    normals = np.cross(corners[[1, 2, 0]], corners[[2, 0, 1]])
    volumes = rays @ normals.T
    if corners[0] @ normals[0] < 0:
        volumes = -volumes
    weights = np.maximum(volumes, 0)
    total = weights.sum(axis=1, keepdims=True)
    return np.where(total > 0, weights / np.where(total > 0, total, 1), (1.0, 0.0, 0.0))


class Surface:
    """The textures of a mesh with faces `indices` (F, 3), multiplied by the colours `tint` if given."""

    def __init__(self, textured: Textured, tint: StaticColors | None, indices: NDArray[Any]) -> None:
        self._textured = textured
        self._levels = [mip_levels(image) for image in textured.images]
        self._tint = np.ones((3 * len(indices), 4)) if tint is None else corner_tint(tint, indices)

    def at(self, face: int, order: NDArray[Any], weights: Reals, steps: Reals) -> Reals:
        """Return linear light and alpha (n, 4) of a face at points with corner weights (n, 3).

        `order` (3,) is the order of the corners. `steps` (n, 2, 3) is the change of the weights to the next
        pixel on the right and below.
        """
        textured = self._textured
        number = 0 if textured.face_texture is None else int(textured.face_texture[face])
        levels = self._levels[number]
        corners = textured.uvs[face].astype(np.float64)[order]
        height, width = levels[0].shape[:2]
        texels = np.linalg.norm(steps @ corners * (width, height), axis=2).max(axis=1)
        lod = np.log2(np.maximum(texels, 1e-30))
        light = sample(levels, weights @ corners, textured.sampler, lod)
        return np.asarray(light * (weights @ self._tint[3 * face + order]))

    def is_there(self, light: Reals) -> NDArray[np.bool_]:
        """Return a mask (n,) of the samples in `light` (n, 4) whose alpha reaches the cutoff."""
        cutoff = self._textured.sampler.alpha_cutoff
        return np.ones(len(light), bool) if cutoff is None else light[:, 3] >= cutoff - ROUNDING


def steps_at(corners: Reals, rays: Reals, camera: Camera) -> Reals:
    """Return the differences (n, 2, 3) of the corner weights between rays (n, 3) and those of the next
    pixels.

    The differences are the derivatives at the sample. A weight is V / sum V, and each volume V is affine on
    the screen.
    """
    normals = np.cross(corners[[1, 2, 0]], corners[[2, 0, 1]])
    if corners[0] @ normals[0] < 0:
        normals = -normals
    volumes = np.maximum(rays @ normals.T, 0)
    total = volumes.sum(axis=1)[:, None, None]
    change = (normals / (camera.fx, camera.fy, 1)).T[:2]
    within = volumes[:, None] / np.where(total > 0, total, 1) * change.sum(axis=1)[:, None]
    return np.where(total > 0, (change - within) / np.where(total > 0, total, 1), 0)
