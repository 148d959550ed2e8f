"""Renders 2DGS in the official order of operations, or by the rules of gsplat.

Sources: hbb1/diff-surfel-rasterization at e0ed020: cuda_rasterizer/forward.cu, auxiliary.h;
nerfstudio-project/gsplat at 90d7b4b: gsplat/cuda/_torch_impl_2dgs.py.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.methods.three_dgs.reference import (
    FAR,
    MAX_ALPHA,
    MAX_EXTENT,
    NEAR,
    NEAREST,
    gsplat_tiles,
    official_tiles,
)
from msb.reference.arithmetic import Reals, dot, exponential, rotate, transform
from msb.reference.blend import Layers, Rule, composite, expected_depth
from msb.reference.camera_matrices import SplattingCamera, splatting_camera
from msb.reference.frame import ReferenceFrame
from msb.reference.parameters import sh_coefficients
from msb.reference.sh import colors_from_sh
from msb.reference.tiles import Integers, Modes
from msb.scenes import Camera
from msb.splats.primitive import Activated, activate

# The official box encloses a disc of 3 standard deviations; gsplat's box encloses a disc of 1 standard
# deviation.
CUTOFF = {"official": 3.0, "gsplat": 1.0}
# Standard deviation of the low-pass filter, in samples.
FILTER = 0.707106
# Lower limit of the squared half side of a box, in square samples.
MIN_SQUARE = 1e-4
_RULE = Rule(blends_crossing=False, weight_first=True)


class Rays(NamedTuple):
    """The intersections of rays with the planes of discs: u and v in standard deviations, the depth, and the
    divisor of u."""

    u: Reals
    v: Reals
    depth: Reals
    divisor: Reals


def render(
    asset: Asset,
    camera: Camera,
    background: Reals,
    settings: Mapping[str, Any],
    dtype: type[Any],
    modes: Modes,
) -> ReferenceFrame:
    """Return the frame of `asset` from `camera`; see `render_reference`.

    The depth of a disc at a sample is the depth of the point where the ray meets the disc.
    """
    real, rasterizer = dtype, settings["rasterizer"]
    view = splatting_camera(camera, NEAR, FAR, dtype)
    discs = activate(asset, 2, dtype)
    count, opacity = len(discs.mean), discs.opacity
    color = colors_from_sh(
        sh_coefficients(asset, count, dtype), discs.mean, view.center, settings["sh_degree"]
    )
    point = transform(view.world_to_camera[:3], discs.mean)
    z, nearest = point[:, 2], real(NEAREST[rasterizer])
    # Turn the normals towards the camera. The official code drops a disc that is seen exactly edge-on.
    normal = rotate(view.world_to_camera[:3], discs.rotation[:, :, 2])
    facing = -dot(point, normal)
    normal = np.where(facing[:, None] > 0, normal, -normal)
    tu, tv, tw = _homography(discs, view)
    center, extent, is_valid = find_box(tu, tv, tw, real(CUTOFF[rasterizer]))
    kept = (z > nearest) & (facing != 0) & is_valid
    if rasterizer == "gsplat":
        rectangles, is_outside = gsplat_tiles(center, real(MAX_EXTENT) * extent, view)
        kept &= ~is_outside
    else:
        least = real(CUTOFF[rasterizer] * FILTER)
        radius = np.ceil(np.maximum(np.maximum(extent[:, 0], extent[:, 1]), least))
        rectangles = official_tiles(center, radius, view)
    kept &= ~rectangles.empty

    def meet(faces: Integers, x: Reals, y: Reals) -> Rays:
        """Intersect the rays of samples with discs: the cross product of two planes through the ray."""
        r = tw[faces]
        k, m = x[..., None] * r - tu[faces], y[..., None] * r - tv[faces]
        px = k[..., 1] * m[..., 2] - k[..., 2] * m[..., 1]
        py = k[..., 2] * m[..., 0] - k[..., 0] * m[..., 2]
        pz = k[..., 0] * m[..., 1] - k[..., 1] * m[..., 0]
        u, v = px / pz, py / pz
        return Rays(u, v, (u * r[..., 0] + v * r[..., 1]) + r[..., 2], pz)

    def cover(faces: Integers, x: Reals, y: Reals) -> Reals:
        rays = meet(faces, x, y)
        dx, dy = center[faces, 0] - x, center[faces, 1] - y
        square = rays.u * rays.u + rays.v * rays.v
        filtered = real(2) * (dx * dx + dy * dy)
        power = real(-0.5) * np.where(filtered < square, filtered, square)
        alpha = np.minimum(real(MAX_ALPHA), opacity[faces] * exponential(power))
        is_seen = (rays.divisor != 0) & (power <= 0)
        if rasterizer == "official":
            is_seen &= ~(rays.depth < nearest)
        return np.asarray(np.where(is_seen, alpha, real(0)))

    def shade(faces: Integers, x: Reals, y: Reals) -> Layers:
        return Layers(color[faces], meet(faces, x, y).depth, normal[faces])

    tiles, weights = modes.tiles(rectangles, z, kept, view), np.zeros(count)
    blended = composite(tiles, cover, shade, _RULE, view.width, view.height, dtype, weights)
    return ReferenceFrame(
        image=blended.over(background),
        alpha=blended.alpha,
        depth=expected_depth(blended.depth, blended.alpha),
        depth_median=blended.depth_median,
        normal=blended.normal,
        face_id=None,
        visible=kept,
        contribution=weights,
    )


def _homography(discs: Activated, view: SplattingCamera) -> tuple[Reals, Reals, Reals]:
    """Return the rows Tu, Tv, Tw (N, 3) of the matrix from disc coordinates to the screen.

    The products of Tu, Tv and Tw with (u, v, 1) are x times depth, y times depth, and depth. The positions x
    and y are in samples.
    """
    full, real = view.full_projection, discs.mean.dtype.type
    columns = [*(discs.rotation[:, :, k] * discs.deviation[:, k : k + 1] for k in range(2)), discs.mean]

    def project(row: int) -> Reals:
        parts = [full[row, 0] * c[:, 0] + full[row, 1] * c[:, 1] + full[row, 2] * c[:, 2] for c in columns]
        return np.stack([parts[0], parts[1], parts[2] + full[row, 3]], axis=1)

    x, y, w = project(0), project(1), project(3)
    size = np.array([view.width, view.height], real)
    half, middle = size / 2, (size - 1) / 2 + view.shift
    return x * half[0] + w * middle[0], y * half[1] + w * middle[1], w


def find_box(tu: Reals, tv: Reals, tw: Reals, cutoff: Any) -> tuple[Reals, Reals, NDArray[np.bool_]]:
    """Return the centres and half sides (N, 2) of the boxes around N discs of radius `cutoff`. Also return a
    mask of the discs that have a box."""
    real = tw.dtype.type
    t = np.array([cutoff * cutoff, cutoff * cutoff, -1], real)
    d = dot(np.broadcast_to(t, tw.shape), tw * tw)
    f = (1 / d)[:, None] * t
    middle = np.stack([dot(f, tu * tw), dot(f, tv * tw)], axis=1)
    square = middle * middle - np.stack([dot(f, tu * tu), dot(f, tv * tv)], axis=1)
    return middle, np.sqrt(np.maximum(real(MIN_SQUARE), square)), d != 0
