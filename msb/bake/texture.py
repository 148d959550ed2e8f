"""The texture of a plain mesh by least squares, over what its pixels show of it in pictures.

The equations hold as if texels were blended in sRGB and stored without rounding. What really is shown is
drawn on the standard tier, and the equations say which change reduces what is left of the error.
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
from msb.bake.atlas import connected_atlas, soup_atlas
from msb.bake.colors import continued
from msb.bake.fusion import seen_points
from msb.bake.painting import Painting
from msb.bake.shares import pixels_shown
from msb.bake.space import Space
from msb.bake.start import Watch, nobody
from msb.bake.stencils import Pyramid
from msb.base.soup import is_soup
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera

if TYPE_CHECKING:
    from msb.bake.lessons import Lessons
    from msb.cl import Device


FEW = 6  # the first pass uses every 6th image, the second pass all of them
_OWN_SIZE = 512, 4096  # fewest and most texels along a side by default
_TILE = 1024
_SAMPLER = Sampler("linear", mipmaps=True, wrap_u="clamp", wrap_v="clamp")


def textured(
    mesh: Mesh,
    lessons: Lessons,
    size: int | None = None,
    *,
    shown: Sequence[Camera] | None = None,
    continues: bool = False,
    device: str | Device | None = None,
    watch: Watch = nobody,
) -> Mesh:
    """Return `mesh` with a texture that shows what `lessons` show, in place of its colours.

    Parameters
    ----------
    mesh : Mesh
        If no faces share a vertex, each gets a cell of the texture of its own, else there are charts.
        Its colours are where the search begins, and stay where no picture shows it.
    lessons : Lessons
        Of twice the pixels that will be drawn, if the texture shall be as sharp.
    size : int, optional
        Texels along a side; as many as pictures show if not given.
    shown : sequence of Camera, optional
        Those whose pictures say how many texels faces need; the lessons' if not given.
    continues : bool
        Whether faces that no picture shows go on as what is seen around them, as those do that were made up
        to close a surface.

    Raises
    ------
    UsageError
        USAGE: there are more faces than the texture has room for. EXTRA_MISSING: xatlas is not installed.
    """
    cameras = lessons.cameras if shown is None else shown
    pixels = np.zeros(len(mesh.faces))
    for each in pixels_shown(mesh, cameras, device):
        np.maximum(pixels, each, out=pixels)
    size = _own_size(pixels) if size is None else size
    if is_soup(mesh.faces):
        uvs = soup_atlas(mesh.vertices[mesh.faces], pixels, size)
    else:
        uvs = connected_atlas(_places(mesh, cameras, device), mesh.faces, pixels, size)
    corners = mesh.faces.reshape(-1)
    colors = np.full((len(corners), 3), 128, np.uint8)
    if mesh.vertex_colors is not None:
        colors = mesh.vertex_colors[corners, :3]
        if continues:
            unseen = np.repeat(pixels == 0, 3)
            colors[unseen] = continued(mesh.vertex_colors, mesh.faces, pixels)[corners[unseen]]
    elif mesh.face_colors is not None:
        colors = np.repeat(mesh.face_colors[:, :3], 3, axis=0)
    chart, texture = _beginning(mesh, colors, uvs, size, device)
    made = replace(
        mesh,
        vertex_colors=None,
        face_colors=None,
        vertex_uvs=None,
        corner_uvs=uvs,
        textures=(texture,),
        face_textures=None,
        sampler=_SAMPLER,
    )
    # Solve for the change of the texels that the images ask for: first with few, then with all of them.
    few = few_of(lessons)
    total = len(few) + len(lessons)
    for pictures, before in (few, 0), (lessons, len(few)):
        with closing(Pyramid(size, device)) as pyramid:
            pyramid.tie(chart)
            with closing(Painting(made, pictures, device)) as painting:
                for done in painting.ask(pyramid):
                    watch("texture", before + done, total)
            change = pyramid.solved()
        change *= 255
        change += made.textures[0]
        texture = np.rint(np.clip(change, 0, 255, out=change), out=change).astype(np.uint8)
        made = replace(made, textures=(texture,))
    return made


def _places(mesh: Mesh, cameras: Sequence[Camera], device: str | Device | None) -> Floats:
    """Return the vertices (V, 3) with what is far drawn together: a chart from here to the horizon would have
    as many texels here as there."""
    points = seen_points(mesh, cameras, device)
    return Space.of(points, cameras).inward(mesh.vertices) if len(points) else mesh.vertices


def few_of(lessons: Lessons) -> Lessons:
    """Return the lessons by which a texture, and the colours that it begins with, are solved first."""
    return lessons.part(range(0, len(lessons), FEW))


def _own_size(pixels: Floats) -> int:
    """Return the power of two with about as many texels as the faces (F,) have pixels at most."""
    side = float(np.sqrt(np.maximum(pixels, 1).sum()))
    least, most = _OWN_SIZE
    return int(min(max(2 ** round(np.log2(side)), least), most))


def _beginning(
    mesh: Mesh, colors: NDArray[Any], uvs: Singles, size: int, device: str | Device | None
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Return which chart each texel belongs to, and a texture that shows the `colors` (3F, 3) of corners.

    The faces are drawn where they lie in the texture; a texel between charts is of the nearest.
    """
    # Draw the faces in the plane of the texture, a tile at a time: (S, S) face numbers and colours.
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
    # Faces that cover no texel's middle: those that are points.
    x, y = np.clip((uvs[::3] * size).astype(np.int64), 0, size - 1).T
    drawn = np.bincount(faces[faces >= 0], minlength=len(mesh.faces)) > 0
    lost = np.flatnonzero(~drawn & (faces[y, x] < 0))
    faces[y[lost], x[lost]] = lost
    means = colors.reshape(-1, 3, 3).mean(axis=1) * (1 if colors.dtype == np.uint8 else 255)
    texture[y[lost], x[lost]] = np.rint(means[lost])
    if (faces < 0).all():
        return np.zeros((size, size), np.int32), texture
    from scipy import ndimage  # it takes longer to load than all that vertices' colours need

    # Texels between charts take the chart and the colour of the nearest face.
    row, column = ndimage.distance_transform_edt(faces < 0, return_distances=False, return_indices=True)
    return _charts(mesh, uvs)[faces[row, column]], texture[row, column]


def _charts(mesh: Mesh, uvs: Singles) -> NDArray[np.int32]:
    """Return the chart (F,) of each face: faces that share a corner in the texture are of one."""
    # Corners in one place of the texture are one node of a graph, which joins their faces.
    keys = np.ascontiguousarray(uvs).view(np.uint64).reshape(-1)
    _, point = np.unique(keys, return_inverse=True)
    count = len(mesh.faces)
    face = np.repeat(np.arange(count), 3)
    graph = coo_array((np.ones(len(face), np.int8), (face, count + point)), shape=2 * (count + len(keys),))
    return np.asarray(connected_components(graph, directed=False)[1][:count], np.int32)
