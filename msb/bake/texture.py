"""Fit the texture of a mesh by least squares over the pixels of images.

The equations assume that texels are blended in sRGB and stored without rounding. The standard tier renders
the current image. The equations give the change of the texels that reduces the remaining error.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from msb.asset.texture import Sampler
from msb.bake.arrays import Floats, Singles
from msb.bake.atlas import make_chart_atlas, make_soup_atlas
from msb.bake.blending_weights import count_pixels_by_view
from msb.bake.color_fit import extend_colors
from msb.bake.context import ProgressHook, ignore_progress
from msb.bake.depth_fusion import find_visible_points
from msb.bake.space import Space
from msb.bake.texture_equations import TextureEquations
from msb.bake.texture_renderer import TextureRenderer
from msb.base.soup import is_soup
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera

if TYPE_CHECKING:
    from msb.bake.images import ViewImages
    from msb.cl import Device

# The first pass uses every 6th image, and the second pass uses all images. The second pass corrects
# rounding and blending errors, which the equations ignore.
FIRST_PASS_STEP = 6
# Smallest and largest default number of texels along a side. With 256 texels along a side, the demo models
# lose 0.3 dB. Many phones support textures of at most 4096 texels.
_DEFAULT_SIZES = 512, 4096
# The initial texture is drawn in tiles to limit the memory. Number of texels along a side of a tile.
_TILE = 1024
_SAMPLER = Sampler("linear", mipmaps=True, wrap_u="clamp", wrap_v="clamp")


def fit_texture(
    mesh: Mesh,
    images: ViewImages,
    size: int | None = None,
    *,
    count_cameras: Sequence[Camera] | None = None,
    extends_colors: bool = False,
    device: str | Device | None = None,
    progress: ProgressHook = ignore_progress,
) -> Mesh:
    """Return `mesh` with a texture that matches `images` in place of its colours.

    Parameters
    ----------
    mesh : Mesh
        Each face of a soup gets a cell of the texture; a connected mesh is cut into charts. The initial
        texture shows the colours of the mesh. Unseen parts keep these colours.
    images : ViewImages
        A sharp texture needs images with twice the width and height of the final views.
    size : int, optional
        Texels along a side. Default: about one texel per pixel that shows the mesh in the images.
    count_cameras : sequence of Camera, optional
        The cameras whose pixels decide how many texels each face gets. Default: the cameras of the images.
    extends_colors : bool
        Whether unseen faces get the colours of the surrounding faces. This option is useful for faces that
        close a surface.

    Raises
    ------
    UsageError
        USAGE: the texture is too small for the number of faces. EXTRA_MISSING: xatlas is not installed.
    """
    cameras = images.cameras if count_cameras is None else count_cameras
    # The largest number of pixels (F,) that show each face in a single view.
    pixels = np.zeros(len(mesh.faces))
    for count in count_pixels_by_view(mesh, cameras, device):
        np.maximum(pixels, count, out=pixels)
    size = _choose_default_size(pixels) if size is None else size
    if is_soup(mesh.faces):
        uvs = make_soup_atlas(mesh.vertices[mesh.faces], pixels, size)
    else:
        uvs = make_chart_atlas(_contract_vertices(mesh, cameras, device), mesh.faces, pixels, size)
    colors = _get_corner_colors(mesh, pixels if extends_colors else None)
    chart, texture = _draw_initial_texture(mesh, colors, uvs, size, device)
    textured = replace(
        mesh,
        vertex_colors=None,
        face_colors=None,
        vertex_uvs=None,
        corner_uvs=uvs,
        textures=(texture,),
        face_textures=None,
        sampler=_SAMPLER,
    )
    # Each of two passes adds up the equations over the images, and solves the equations for the change of the
    # texels. The change is added to the texture and rounded.
    few = select_first_pass(images)
    total = len(few) + len(images)
    for chosen, before in (few, 0), (images, len(few)):
        with closing(TextureEquations(size, device)) as equations:
            equations.add_smoothness(chart)
            with closing(TextureRenderer(textured, chosen, device)) as renderer:
                for done in renderer.add_equations(equations):
                    progress("texture", before + done, total)
            change = equations.solve()
        change *= 255
        change += textured.textures[0]
        texture = np.rint(np.clip(change, 0, 255, out=change), out=change).astype(np.uint8)
        textured = replace(textured, textures=(texture,))
    return textured


def select_first_pass(images: ViewImages) -> ViewImages:
    """Return the images of the first pass, which also determine the initial texture."""
    return images.select(range(0, len(images), FIRST_PASS_STEP))


def _get_corner_colors(mesh: Mesh, pixels: Floats | None) -> NDArray[Any]:
    """Return the colour of each corner (3F, 3).

    With `pixels` (F,), faces without pixels get the colours of the faces around them.
    """
    corners = mesh.faces.reshape(-1)
    if mesh.vertex_colors is not None:
        colors = mesh.vertex_colors[corners, :3]
        if pixels is not None:
            unseen = np.repeat(pixels == 0, 3)
            colors[unseen] = extend_colors(mesh.vertex_colors, mesh.faces, pixels)[corners[unseen]]
        return colors
    if mesh.face_colors is not None:
        return np.repeat(mesh.face_colors[:, :3], 3, axis=0)
    return np.full((len(corners), 3), 128, np.uint8)


def _contract_vertices(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> Floats:
    """Return the vertices (V, 3) of a scene with its far parts contracted.

    Without the contraction, distant parts of a chart would get as many texels per length as near parts.
    """
    points = find_visible_points(mesh, cameras, device)
    return Space.fit(points, cameras).from_world(mesh.vertices) if len(points) else mesh.vertices


def _choose_default_size(pixels: Floats) -> int:
    """Return the default number of texels along a side.

    The number of texels along a side is a power of two with about one texel per pixel. The argument `pixels`
    (F,) is the number of pixels that show each face.
    """
    side = float(np.sqrt(np.maximum(pixels, 1).sum()))
    least, most = _DEFAULT_SIZES
    return int(min(max(2 ** round(np.log2(side)), least), most))


def _draw_initial_texture(
    mesh: Mesh, colors: NDArray[Any], uvs: Singles, size: int, device: str | Device | None
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Return two arrays: the chart (size, size) of each texel, and a texture (size, size, 3) of the corner
    colours.

    Texels between charts belong to the nearest chart and have its colour.
    """
    # Draw the faces in the plane of the texture, one texture tile after the other. The results are face
    # indices (S, S) and colours (S, S).
    at = np.concatenate([uvs, np.ones((len(uvs), 1), np.float32)], axis=1)
    flat = Mesh(at, np.arange(len(colors)).reshape(-1, 3), colors)
    faces, texture = np.full((size, size), -1, np.int32), np.zeros((size, size, 3), np.uint8)
    with Renderer(asset_from_mesh(flat), "standard", device=device) as renderer:
        for top in range(0, size, _TILE):
            for left in range(0, size, _TILE):
                width, height = min(_TILE, size - left), min(_TILE, size - top)
                camera = Camera(width, height, float(size), float(size), -float(left), -float(top), np.eye(4))
                frame = renderer.render(camera)
                tile = np.s_[top : top + height, left : left + width]
                assert frame.face_id is not None
                faces[tile], texture[tile] = frame.face_id, np.rint(frame.image * 255)
    # A face that covers no texel centre is a point. The texel at this point gets the average colour of the
    # face.
    x, y = np.clip((uvs[::3] * size).astype(np.int64), 0, size - 1).T
    drawn = np.bincount(faces[faces >= 0], minlength=len(mesh.faces)) > 0
    lost = np.flatnonzero(~drawn & (faces[y, x] < 0))
    faces[y[lost], x[lost]] = lost
    means = colors.reshape(-1, 3, 3).mean(axis=1) * (1 if colors.dtype == np.uint8 else 255)
    texture[y[lost], x[lost]] = np.rint(means[lost])
    if (faces < 0).all():
        return np.zeros((size, size), np.int32), texture
    from scipy import ndimage  # Importing SciPy takes longer than fitting vertex colours.

    # A texel between charts gets the chart and the colour of the nearest drawn texel.
    row, column = ndimage.distance_transform_edt(faces < 0, return_distances=False, return_indices=True)
    return label_charts(mesh, uvs)[faces[row, column]], texture[row, column]


def label_charts(mesh: Mesh, uvs: Singles) -> NDArray[np.int32]:
    """Return the chart (F,) of each face.

    Faces that share a corner in the texture (3F, 2) are in one chart.
    """
    # Corners at one place of the texture become one node of a graph. The nodes connect the faces.
    keys = np.ascontiguousarray(uvs).view(np.uint64).reshape(-1)
    _, point = np.unique(keys, return_inverse=True)
    count = len(mesh.faces)
    face = np.repeat(np.arange(count), 3)
    graph = coo_array((np.ones(len(face), np.int8), (face, count + point)), shape=2 * (count + len(keys),))
    return np.asarray(connected_components(graph, directed=False)[1][:count], np.int32)
