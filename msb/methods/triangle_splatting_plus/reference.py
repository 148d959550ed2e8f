"""Triangle Splatting+: MeshSplatting with a lower cap of alpha, flat depth and Triangle-Splatting's tiles.

Sources: trianglesplatting2/triangle-splatting2 at fcde03d: scene/triangle_model.py,
triangle_renderer/__init__.py, render.py (supersampling); trianglesplatting2/diff-triangle2-rasterization at
42e62aa: cuda_rasterizer/forward.cu.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from msb.methods.mesh_splatting.reference import form_image
from msb.methods.triangle_splatting.reference import contour_tiles

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.reference.arithmetic import Reals
    from msb.reference.frame import ReferenceFrame
    from msb.reference.tiles import Modes
    from msb.scenes import Camera

MAX_ALPHA = 0.99


def render(
    asset: Asset,
    camera: Camera,
    background: Reals,
    settings: Mapping[str, Any],
    dtype: type[Any],
    modes: Modes,
) -> ReferenceFrame:
    """Return `asset` seen by `camera`; see `render_reference`."""
    return form_image(
        asset,
        camera,
        background,
        settings,
        dtype,
        modes,
        max_alpha=MAX_ALPHA,
        flat_depth=True,
        tiles_of=contour_tiles,
    )
