"""The camera record of the splatting kernels; `View` in splat_common.cl has the same layout."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera
from msb.scenes.poses import rigid_inverse

TILE = 16

# Members of the struct `Limits` in splat_common.cl, the bounds for culling.
LIMITS = np.dtype(
    [
        ("nearest", np.float32),
        ("depth_growth", np.float32),
        ("sides", np.float32, 4),
        ("growth", np.float32),
        ("rounding", np.float32),
        ("focal", np.float32),
    ]
)

# Members of the struct `View` for every method. Each member takes a multiple of four bytes, so the compiler
# adds no padding.
VIEW = np.dtype(
    [
        ("world_to_camera", np.float32, 12),
        ("full", np.float32, 16),
        ("center", np.float32, 3),
        ("tan_fov", np.float32, 2),
        ("shift", np.float32, 2),
        ("width", np.uint32),
        ("height", np.uint32),
        ("columns", np.uint32),
        ("rows", np.uint32),
        ("degree", np.uint32),
        ("rest_stride", np.uint32),
        ("tile_rule", np.uint32),
        ("limits", LIMITS),
    ]
)
_C_TYPES: dict[np.dtype[Any], str] = {
    np.dtype(np.float32): "float",
    np.dtype(np.int32): "int",
    np.dtype(np.uint32): "uint",
}


def method_members(method_values: Mapping[str, np.generic]) -> dict[str, str]:
    """Return the kernel definition that adds a method's values to the struct `View`, in their order."""
    members = "".join(f"{_C_TYPES[value.dtype]} {name}; " for name, value in method_values.items())
    return {"OWN_MEMBERS": members.rstrip()} if method_values else {}


@dataclass(frozen=True)
class Culling:
    """The bounds outside which a method draws no face."""

    # Minimum depth (camera z in scene units). Faces at this depth or nearer are dropped.
    nearest: float
    # Extent of a face from its centroid, as a multiple of the distances of its corners.
    dilation: float
    # Number of samples by which a face may extend beyond the distance from `dilation`.
    margin: float = 2.0
    # Whether faces are clipped at the near plane. The largest depth of a clipped face is compared with
    # `nearest`. Without clipping, the depth of the centroid is compared.
    clipped: bool = False


def make_view(
    camera: Camera,
    near: float,
    far: float,
    scale: int,
    fields: Mapping[str, Any],
    method_values: Mapping[str, np.generic],
    culling: Culling,
    extent: NDArray[np.float32],
) -> NDArray[Any]:
    """Return the `View` record of a camera for a raster with `scale` samples per pixel and axis.

    `near` and `far` affect only the z row of the projection. `fields` are common members that do not depend
    on the camera. `method_values` are the members of the method. `extent` (3,) is the largest magnitude of a
    coordinate along each axis.

    The 3DGS family projects with tan(fov / 2) and the float32 product P W, whose terms are added from first
    to last. The camera centre is computed from the float32 W in double precision, and rounded. The last bits
    of the official float32 inverse depend on the linear algebra library. The official code ignores the
    principal point. This function adds the offset of the principal point from the image centre to the sample
    positions. Sources: GaodeRender/triangle-splatting: src/diff_recon/utils/camera.py;
    trianglesplatting/triangle-splatting: utils/graphics_utils.py, scene/cameras.py.
    """
    view = np.zeros(
        (), [*VIEW.descr, ("own", [(name, value.dtype) for name, value in method_values.items()])]
    )
    tan_x, tan_y = math.tan(camera.fov_x / 2), math.tan(camera.fov_y / 2)
    projection = np.zeros((4, 4), np.float32)
    projection[0, 0] = 2 * near / (2 * (tan_x * near))
    projection[1, 1] = 2 * near / (2 * (tan_y * near))
    projection[2, 2] = far / (far - near)
    projection[2, 3] = -(far * near) / (far - near)
    projection[3, 2] = 1
    world_to_camera = camera.world_to_camera.astype(np.float32)
    full = projection[:, :1] * world_to_camera[:1]
    for k in range(1, 4):  # a matrix product with BLAS would fuse and reorder the sums
        full = full + projection[:, k : k + 1] * world_to_camera[k : k + 1]
    view["world_to_camera"] = world_to_camera[:3].ravel()
    view["full"] = full.ravel()
    view["center"] = rigid_inverse(world_to_camera.astype(np.float64))[:3, 3]
    view["tan_fov"] = tan_x, tan_y
    view["shift"] = scale * (camera.cx - camera.width / 2), scale * (camera.cy - camera.height / 2)
    view["width"], view["height"] = scale * camera.width, scale * camera.height
    view["columns"], view["rows"] = -(-scale * camera.width // TILE), -(-scale * camera.height // TILE)
    for name, value in fields.items():
        view[name] = value
    view["limits"] = _limits(view, culling, extent)
    for name, value in method_values.items():
        view["own"][name] = value
    return view


def _limits(view: NDArray[Any], culling: Culling, extent: NDArray[np.float32]) -> tuple[Any, ...]:
    """Return the members of `Limits`: the official bounds, widened by the largest rounding error."""
    pose = view["world_to_camera"].reshape(3, 4).astype(np.float64)
    size = np.array([view["width"], view["height"]], np.float64)
    tan, shift = view["tan_fov"].astype(np.float64), view["shift"].astype(np.float64)
    # Bound of the rounding error of a camera-space coordinate, in scene units.
    rounding = 16 * np.finfo(np.float32).eps * (np.abs(pose[:, :3]) @ extent + np.abs(pose[:, 3])).max()
    # Slopes x / z and y / z of the raster's borders, including the margin. The slope of sample x is tan(fov
    # / 2) (2 (x - shift) + 1 - width) / width.
    ends = np.array([view["columns"], view["rows"]]) * TILE
    margin = culling.margin + 0.004 * size.max()
    low, high = -margin, ends + margin
    slopes = np.stack([tan * (2 * (end - shift) + 1 - size) / size for end in (low, high)], axis=1)
    widest = max(np.abs(slopes).max(), 1.3 * tan.max())
    return (
        0.999 * culling.nearest - rounding,
        culling.clipped * culling.dilation,
        slopes.ravel(),
        1.001 * culling.dilation * (1 + widest),
        rounding,
        (size / (2 * tan)).max(),
    )
