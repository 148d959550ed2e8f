"""Triangle Splatting+: MeshSplatting with a lower limit of alpha, flat depth and other tiles.

The tiles are computed as in Triangle-Splatting. Sources: trianglesplatting2/triangle-splatting2 at fcde03d:
scene/triangle_model.py, triangle_renderer/__init__.py, render.py (supersampling);
trianglesplatting2/diff-triangle2-rasterization at 42e62aa: cuda_rasterizer/forward.cu.
"""

from functools import partial

from msb.methods.mesh_splatting import reference as mesh_splatting
from msb.methods.triangle_splatting.reference import contour_tiles

render = partial(mesh_splatting.render, max_alpha=0.99, flat_depth=True, tiles_of=contour_tiles)
