"""DiffSoup: opaque triangles with lattices of features and opacity, a z-buffer, and a small decoder.

Sources, at c74e35d of kenji-tojo/diffsoup: src/cuda/rasterize.cu, multires.cu, encoding.cu;
python/diffsoup/rasterize.py; examples/01_mip360.py, 02_synthetic.py (test loops), 06_export_web.py (bytes).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.drawable import required_buffer
from msb.asset.planes import invert_projection
from msb.asset.sh import SH_C0, sh_basis
from msb.methods.diffsoup import FEATURES, LAYERS, check_level, samples
from msb.reference.arithmetic import Reals, dot, matrix_product, norm, sigmoid, transform
from msb.reference.frame import ReferenceFrame
from msb.reference.tiles import Modes
from msb.scenes import Camera

# Fragments below this opacity are discarded.
OPACITY_THRESHOLD = 0.5
# Index of the feature that blends the decoder's colour with the base colour. Features 0 to 2 are the base
# colour.
BLEND_FEATURE = 3
# Maximum number of pixels in triangle boxes that are processed at once, to limit the memory.
_TOGETHER = 1 << 18


@dataclass
class ZBuffer:
    """The z-buffer: for each pixel, in the kernel's row order, the nearest opaque face found so far.

    `key` (H, W) is the NDC depth + 2, and infinite in empty pixels. `face` is the number of the face, and -1
    in empty pixels.
    """

    key: NDArray[np.float32]
    face: NDArray[np.int32]
    b0: Reals
    b1: Reals
    ndc_depth: Reals
    camera_depth: Reals
    fragments: int = 0


def render(
    asset: Asset,
    camera: Camera,
    background: Reals,
    settings: Mapping[str, Any],
    dtype: type[Any],
    modes: Modes,
) -> ReferenceFrame:
    """Return the frame of `asset` from `camera`; see `render_reference`.

    The image of a z-buffer does not depend on the order of faces. Engine sampling differs only for faces
    that reach behind the camera, because hardware clips such faces. Pixels without a face show
    `background`. The official background is black in the COLMAP layout and white in the synthetic layout.
    """
    near, far, layout = settings["z_near"], settings["z_far"], settings["layout"]
    mvp, inverse = diffsoup_projection(camera, layout, near, far, dtype)
    indices = asset.buffers["indices"]
    level, lattice, opacity = lattices(asset, dtype)
    clip = transform(mvp, asset.buffers["positions"].astype(dtype))
    columns, rows = ndc_centers(camera.width, dtype), ndc_centers(camera.height, dtype)
    seen = rasterize(clip[indices], opacity, level, columns, rows, clips=modes.engine)

    # Interpolate the features of the n covered pixels, and decode them with the encoded view directions.
    hit = seen.face >= 0
    b0, b1, face = seen.b0[hit], seen.b1[hit], seen.face[hit]
    row, column = np.nonzero(hit)
    features = interpolate(lattice, face, level, b0, b1)
    directions = towards_camera(inverse, columns[column], rows[row])
    encoding = np.stack([np.full_like(b0, SH_C0), *sh_basis(directions, 2)], axis=-1)
    image = np.broadcast_to(background, (*hit.shape, 3)).copy()
    image[hit] = decode(asset, features, encoding)

    # Row 0 of the official kernel is NDC y = -1, which is the top of the image only in the COLMAP layout.
    up = slice(None) if layout == "colmap" else slice(None, None, -1)
    visible = np.zeros(len(indices), bool)
    visible[face] = True
    return ReferenceFrame(
        image=image[up],
        alpha=hit[up].astype(dtype),
        depth=seen.camera_depth[up],
        depth_median=None,
        normal=None,
        face_id=seen.face[up],
        visible=visible,
        contribution=np.bincount(face, minlength=len(indices)).astype(np.float64),
        raw={
            "mvp": mvp,
            "mvp_inv": inverse,
            "clip_vertices": clip,
            "num_fragments": seen.fragments,
            "tri_id": seen.face,
            "bary01": np.stack([seen.b0, seen.b1], axis=-1),
            "depth": seen.ndc_depth,
            "features": scatter(hit, features),
            "sh": scatter(hit, encoding),
        },
    )


def diffsoup_projection(
    camera: Camera, layout: str, near: float, far: float, dtype: type[Any]
) -> tuple[Reals, Reals]:
    """Return DiffSoup's matrix MVP and its inverse, (4, 4) each, for column vectors.

    Parameters
    ----------
    layout : {"colmap", "synthetic"}
        "colmap": NDC y grows downwards. The official sign of the vertical principal point is the opposite of
        the correct sign. "synthetic": NDC y grows upwards. The official code assumes a principal point in the
        middle, but this function supports any principal point.
    near, far : float
        Camera depths in scene units that become NDC -1 and 1.

    Notes
    -----
    P = [2fx/W 0 1-2cx/W 0; 0 2fy/H 2cy/H-1 0; 0 0 (f+n)/(n-f) 2fn/(n-f); 0 0 -1 0] and MVP = P V in `dtype`.

    "colmap" (kenji-tojo/diffsoup: examples/utils.py): V is W with the z row negated, and P is computed in
    float32 from a float32 K (camera matrix). "synthetic" (examples/02_synthetic.py): V is W with the y and
    z rows negated, and P is computed in double and rounded. The inverse is computed in double and rounded,
    because the last bits of the official float32 inverse depend on the linear algebra library.
    """
    real = dtype if layout == "colmap" else np.float64
    width, height, two = real(camera.width), real(camera.height), real(2)
    fx, fy, cx, cy = real(camera.fx), real(camera.fy), real(camera.cx), real(camera.cy)
    projection = np.zeros((4, 4), dtype)
    projection[0, 0] = two * fx / width
    projection[1, 1] = two * fy / height
    projection[0, 2] = real(1) - two * (cx / width)
    projection[1, 2] = two * (cy / height) - real(1)
    # invalid planes may cause a division by zero; `invert_projection` rejects these planes
    near, far = np.float64(near), np.float64(far)
    projection[2, 2] = (far + near) / (near - far)
    projection[2, 3] = (2 * far * near) / (near - far)
    projection[3, 2] = -1
    signs = (1, 1, -1, 1) if layout == "colmap" else (1, -1, -1, 1)
    view = (np.diag(signs) @ camera.world_to_camera).astype(dtype)
    mvp = matrix_product(projection, view)
    return mvp, invert_projection(mvp, near, far)


def lattices(asset: Asset, dtype: type[Any]) -> tuple[int, Reals, Reals]:
    """Return the level, the features (F, S, 7) and the opacity (F, S) of the lattices. A byte v becomes
    v / 255."""
    level, count = check_level(asset.manifest.appearance.get("level"), asset.path), asset.manifest.face_count
    lattice, opacity = (
        array.astype(dtype) / dtype(255) if array.dtype == np.uint8 else array.astype(dtype, copy=False)
        for array in (
            required_buffer(asset, "features.lattice", count, samples(level), FEATURES),
            required_buffer(asset, "features.opacity", count, samples(level)),
        )
    )
    return level, lattice, opacity


def ndc_centers(size: int, dtype: type[Any]) -> Reals:
    """Return the NDC coordinates of the centres of `size` pixels."""
    return np.asarray(-1 + 2 * (np.arange(size).astype(dtype) + dtype(0.5)) / dtype(size))


def rasterize(
    corners: Reals, opacity: Reals, level: int, columns: Reals, rows: Reals, *, clips: bool = False
) -> ZBuffer:
    """Return the z-buffer of triangles with clip coordinates (F, 3 corners, 4).

    The face with the nearest NDC depth is visible. At equal depths, the face with the lowest number is
    visible. Depths are compared as float32(depth + 2), like the official key. Depths that differ by less than
    this rounding are equal, even in float64.
    """
    shape, dtype = (len(rows), len(columns)), corners.dtype
    seen = ZBuffer(
        key=np.full(shape, np.inf, np.float32),
        face=np.full(shape, -1, np.int32),
        b0=np.zeros(shape, dtype),
        b1=np.zeros(shape, dtype),
        ndc_depth=np.zeros(shape, dtype),
        camera_depth=np.zeros(shape, dtype),
    )
    dropped, boxes = pixel_boxes(corners, len(columns), len(rows), clips=clips)
    in_rows = seen.key, seen.face, seen.b0, seen.b1, seen.ndc_depth, seen.camera_depth
    nearest_key, *planes = (array.reshape(-1) for array in in_rows)
    # Test the candidate pixels of several faces at once, and keep the valid fragments.
    for face, column, row in box_pixels(np.flatnonzero(~dropped), boxes):
        b0, b1, ndc_depth, w, valid = fragments(corners[face].transpose(1, 2, 0), columns[column], rows[row])
        seen.fragments += int(valid.sum())
        face, b0, b1, ndc_depth, w = (values[valid] for values in (face, b0, b1, ndc_depth, w))
        pixel = (row * len(columns) + column)[valid]
        alpha = interpolate(opacity[..., None], face, level, b0, b1)[:, 0]
        key = (ndc_depth + 2).astype(np.float32)
        # A fragment replaces the z-buffer only if it is nearer, so at equal depths the lower face number
        # stays.
        wins = ~(alpha < dtype.type(OPACITY_THRESHOLD)) & (ndc_depth > -1) & (key < nearest_key[pixel])
        # Select the nearest of the new fragments of each pixel. The sort is stable, so faces with lower
        # indices come first.
        order = np.flatnonzero(wins)[np.lexsort((key[wins], pixel[wins]))]
        nearest = order[np.diff(pixel[order], prepend=-1) != 0]
        nearest_key[pixel[nearest]] = key[nearest]
        for plane, value in zip(planes, (face, b0, b1, ndc_depth, w), strict=True):
            plane[pixel[nearest]] = value[nearest]
    return seen


def box_pixels(
    faces: NDArray[np.int64], boxes: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the pixels in the boxes (F, 4) of `faces`, which must be in ascending order.

    The three arrays (n,) are face, column and row.

    Faces with at most `_TOGETHER` pixels in total share a batch. The pixels of a face are never split over
    two batches.
    """
    left, right, top, bottom = boxes[faces].T
    across = right - left + 1
    counts = across * (bottom - top + 1)
    ends = np.cumsum(counts)
    starts = ends - counts
    start = 0
    while start < len(faces):
        stop = max(start + 1, int(np.searchsorted(ends, starts[start] + _TOGETHER, "right")))
        which = np.repeat(np.arange(start, stop), counts[start:stop])
        place = np.arange(len(which)) - (starts[which] - starts[start])
        row, column = np.divmod(place, across[which])
        yield faces[which], left[which] + column, top[which] + row
        start = stop


def pixel_boxes(
    corners: Reals, width: int, height: int, *, clips: bool = False
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return a mask (F,) of the dropped triangles, and the pixel boxes of all triangles.

    A box (F, 4) holds the first and last column, and the first and last row. A triangle with a corner at or
    behind the camera plane is dropped. With `clips`, a dropped triangle is kept instead, and its box is the
    whole image. The test of the NDC depth removes the part behind the plane.
    """
    w = corners[..., 3]
    behind = ~(w > 0)
    crosses = behind.any(axis=1)
    dropped = np.asarray(behind.all(axis=1) if clips else crosses)
    for axis in range(3):
        dropped |= (corners[..., axis] < -w).all(axis=1) | (corners[..., axis] > w).all(axis=1)
    # Box of the corners in NDC, clamped to the image.
    ndc = corners[..., :2] * (1 / w)[..., None]
    ndc = np.where(np.isfinite(ndc), ndc, np.where(ndc > 0, 1, -1)).astype(corners.dtype)
    ndc = np.clip(ndc, -1, 1)
    low, high = ndc.min(axis=1), ndc.max(axis=1)
    low[crosses], high[crosses] = -1, 1
    size = np.array([width, height], corners.dtype)
    edge = np.array([width - 1, height - 1])
    first = np.maximum(np.floor(0.5 * (low + 1) * size).astype(np.int64), 0)
    last = np.minimum(np.floor(0.5 * (high + 1) * size).astype(np.int64), edge)
    dropped |= (last < first).any(axis=1)
    return dropped, np.stack([first[:, 0], last[:, 0], first[:, 1], last[:, 1]], axis=1)


def fragments(corners: Reals, u: Reals, v: Reals) -> tuple[Reals, Reals, Reals, Reals, NDArray[np.bool_]]:
    """Return the points where n pixel rays meet the planes of triangles, as arrays (n,). `u` and `v` (n,) are
    the NDC coordinates of the pixels, and `corners` is (3 corners, 4, n).


    Returns
    -------
    b0, b1 : barycentric coordinates of corners 0 and 1, linear in world space
    ndc_depth, w : z / w, and clip w, which is the camera's z
    valid : whether the point is inside the triangle (edges included), and the NDC depth is from -1 to 1
    """
    (x0, y0, z0, w0), (x1, y1, z1, w1), (x2, y2, z2, w2) = corners
    # Homogeneous edge functions: subtract the pixel from the corners, then compute signed areas.
    qx0, qy0 = x0 - u * w0, y0 - v * w0
    qx1, qy1 = x1 - u * w1, y1 - v * w1
    qx2, qy2 = x2 - u * w2, y2 - v * w2
    a0 = qx1 * qy2 - qy1 * qx2
    a1 = qx2 * qy0 - qy2 * qx0
    a2 = qx0 * qy1 - qy0 * qx1
    area = a0 + a1 + a2
    inverse = 1 / area
    b0, b1 = a0 * inverse, a1 * inverse
    b2 = 1 - b0 - b1
    w = b0 * w0 + b1 * w1 + b2 * w2
    ndc_depth = (b0 * z0 + b1 * z1 + b2 * z2) / w
    inside = (area != 0) & (b0 >= 0) & (b1 >= 0) & (b0 + b1 <= 1)
    return b0, b1, ndc_depth, w, inside & (ndc_depth >= -1) & (ndc_depth <= 1)


def interpolate(lattice: Reals, faces: NDArray[Any] | int, level: int, b0: Reals, b1: Reals) -> Reals:
    """Interpolate lattices (F, S, C) of `faces` at barycentric coordinates (n,), between three lattice nodes.

    Lattice node (x, y) has b0 = x / 2^level and b1 = y / 2^level. The lattice node is sample s(s + 1)/2 + y,
    where s = x + y.
    """
    side = 2**level
    u, v = b0 * side, b1 * side
    # Find the cell (x, y) of the lattice, and the position (u, v) in the cell. A lattice cell has two
    # triangles; `flip` selects the upper triangle.
    x = np.minimum(np.floor(u), side - 1).astype(np.int64)
    y = np.minimum(np.floor(v).astype(np.int64), side - 1 - x)
    u, v = u - x.astype(u.dtype), v - y.astype(v.dtype)
    flip = u + v > 1
    w0, w1 = np.where(flip, 1 - v, u), np.where(flip, 1 - u, v)
    w2 = 1 - w0 - w1
    x2 = x + flip
    y2 = np.minimum(y + flip, side - x2)
    d0, d1, d2 = (
        lattice[faces, (i + j) * (i + j + 1) // 2 + j] for i, j in ((x + 1, y), (x, y + 1), (x2, y2))
    )
    return np.asarray(w0[:, None] * d0 + w1[:, None] * d1 + w2[:, None] * d2)


def towards_camera(inverse: Reals, u: Reals, v: Reals) -> Reals:
    """Return unit vectors (n, 3) from the surface towards the camera: near point minus far point."""
    near, far = (np.stack([u, v, np.full_like(u, z)], axis=-1) for z in (-1, 1))
    near, far = (transform(inverse, point) for point in (near, far))
    near, far = (point[:, :3] * (1 / point[:, 3:]) for point in (near, far))
    ray = near - far
    return np.asarray(ray * (1 / norm(ray))[:, None])


def decode(asset: Asset, features: Reals, encoding: Reals) -> Reals:
    """Return colours (n, 3) of features (n, 7) and encoded view directions (n, 9).

    A perceptron with two hidden layers computes a colour. Feature 3 blends this colour with the base colour
    (features 0 to 2).
    """
    values = np.concatenate([features, encoding], axis=1)
    for layer, (outputs, inputs) in LAYERS.items():
        weight = required_buffer(asset, f"decoder.{layer}.weight", outputs, inputs).astype(values.dtype)
        bias = required_buffer(asset, f"decoder.{layer}.bias", outputs).astype(values.dtype)
        values = dot(values[:, None], weight[None]) + bias
        values = sigmoid(values) if outputs == 3 else np.maximum(values, 0)
    mix = features[:, BLEND_FEATURE, None]
    return np.asarray((1 - mix) * features[:, :3] + mix * values)


def scatter(hit: NDArray[np.bool_], values: Reals) -> Reals:
    """Return an image (H, W, C). The n pixels of `hit` have the `values` (n, C), and the other pixels are
    0."""
    image = np.zeros((*hit.shape, values.shape[1]), values.dtype)
    image[hit] = values
    return image
