"""The texture of a plain mesh by least squares, over what its pixels show of it in pictures.

The equations hold as if texels were blended in sRGB and stored without rounding. What really is shown is
drawn on the standard tier, and the equations say which change reduces what is left of the error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from msb.asset.texture import Sampler
from msb.bake.atlas import connected_atlas, soup_atlas
from msb.bake.fusion import seen_points
from msb.bake.shares import pixels_shown
from msb.bake.space import Space
from msb.bake.start import Watch, nobody
from msb.bake.stencils import Pyramid
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera

if TYPE_CHECKING:
    from msb.bake.lessons import Lessons
    from msb.bake.stencils import Samples
    from msb.cl import Device

    Reals = NDArray[np.float64]

T = TypeVar("T")

ROUNDS = 2
"""How often the error is drawn and reduced."""
_OWN_SIZE = 512, 4096
"""Texels along a side, where nobody says how many: the fewest and the most."""
_TILE = 1024
_AT_ONCE = 1 << 20
"""Pixels whose share in the texture is worked out together: memory is that of so many."""
_SAMPLER = Sampler("linear", mipmaps=True, wrap_u="clamp", wrap_v="clamp")


def textured(
    mesh: Mesh,
    lessons: Lessons,
    size: int | None = None,
    *,
    shown: Sequence[Camera] | None = None,
    device: str | Device | None = None,
    watch: Watch = nobody,
) -> Mesh:
    """Return `mesh` with a texture that shows what `lessons` show, in place of its colours.

    Parameters
    ----------
    mesh : Mesh
        A soup, whose faces share no vertex, gets a cell of the texture for each face, another mesh charts.
        Its colours are where the search begins, and stay where no picture shows it.
    lessons : Lessons
        Of twice the pixels that will be drawn, if the texture shall be as sharp.
    size : int, optional
        Texels along a side; as many as pictures show if not given.
    shown : sequence of Camera, optional
        Those whose pictures say how many texels faces need; the lessons' if not given.

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
    if len(mesh.vertices) == 3 * len(mesh.faces) and np.array_equal(
        mesh.faces.reshape(-1), np.arange(mesh.faces.size)
    ):
        uvs = soup_atlas(mesh.vertices[mesh.faces], pixels, size)
    else:
        # A chart from here to the horizon has as many texels here as there, so what is far is drawn together.
        points = seen_points(mesh, cameras, device)
        places = Space.of(points, cameras).inward(mesh.vertices) if len(points) else mesh.vertices
        uvs = connected_atlas(places, mesh.faces, pixels, size)
    chart, texture = _beginning(mesh, uvs, size, device)
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
    pyramid = Pyramid(size)
    pyramid.tie(chart)
    del chart
    for number in range(ROUNDS):
        pyramid.right[:] = 0
        for samples, error, view in _ahead(_errors(made, lessons, pyramid, device)):
            pyramid.add(samples, error, ties=not number)
            watch("texture", number * len(lessons) + view + 1, ROUNDS * len(lessons))
        texture = made.textures[0].copy()
        for channel, change in enumerate(pyramid.solved()):
            plane = texture[..., channel]
            plane[:] = np.rint(np.clip(plane + 255 * change.reshape(plane.shape), 0, 255))
        made = replace(made, textures=(texture,))
    return made


def _own_size(pixels: Reals) -> int:
    """Return the power of two with about as many texels as the faces (F,) have pixels at most."""
    side = float(np.sqrt(np.maximum(pixels, 1).sum()))
    least, most = _OWN_SIZE
    return int(min(max(2 ** round(np.log2(side)), least), most))


def _beginning(
    mesh: Mesh, uvs: NDArray[np.float32], size: int, device: str | Device | None
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Return which chart each texel belongs to, and a texture that shows the colours of `mesh`.

    The faces are drawn where they lie in the texture; a texel between charts is of the nearest.
    """
    at = np.concatenate([uvs, np.ones((len(uvs), 1), np.float32)], axis=1)
    corners = mesh.faces.reshape(-1)
    colors = np.full((len(corners), 3), 128, np.uint8)
    if mesh.vertex_colors is not None:
        colors = mesh.vertex_colors[corners, :3]
    elif mesh.face_colors is not None:
        colors = np.repeat(mesh.face_colors[:, :3], 3, axis=0)
    flat = Mesh(at, np.arange(len(corners)).reshape(-1, 3), colors)
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
    row, column = ndimage.distance_transform_edt(faces < 0, return_distances=False, return_indices=True)
    return _charts(mesh, uvs)[faces[row, column]], texture[row, column]


def _charts(mesh: Mesh, uvs: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the chart (F,) of each face: faces that share a corner in the texture are of one."""
    keys = np.ascontiguousarray(uvs).view(np.uint64).reshape(-1)
    _, point = np.unique(keys, return_inverse=True)
    count = len(mesh.faces)
    face = np.repeat(np.arange(count), 3)
    graph = coo_array((np.ones(len(face), np.int8), (face, count + point)), shape=2 * (count + len(keys),))
    return np.asarray(connected_components(graph, directed=False)[1][:count], np.int32)


class _Seen(NamedTuple):
    """The pixels of a picture that show a face."""

    pixel: NDArray[np.int64]
    face: NDArray[np.int32]


def _errors(
    mesh: Mesh, lessons: Lessons, pyramid: Pyramid, device: str | Device | None
) -> Iterator[tuple[Samples, NDArray[np.float32], int]]:
    """Yield what pixels that show a face show of the texture, what they (n, 3) lack of the lesson, and its
    number; of large pictures a part at a time."""
    with Renderer(asset_from_mesh(mesh), "standard", device=device) as renderer:
        for number, camera in enumerate(lessons.cameras):
            frame = renderer.render(camera, background=lessons.background)
            assert frame.face_id is not None
            faces = frame.face_id.reshape(-1)
            lack = (lessons.image(number) - frame.image).reshape(-1, 3)
            pixel = np.flatnonzero(faces >= 0)
            for first in range(0, len(pixel), _AT_ONCE):
                some = pixel[first : first + _AT_ONCE]
                yield _samples(_Seen(some, faces[some]), mesh, camera, pyramid), lack[some], number


def _ahead(items: Iterator[T]) -> Iterator[T]:
    """Yield items, each made by a thread of its own while the one before is used."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = pool.submit(next, items, None)
            yield item


def _samples(seen: _Seen, mesh: Mesh, camera: Camera, pyramid: Pyramid) -> Samples:
    """Return what of the texture the pixels show.

    Along a ray r a texture coordinate is U r / C r, with C the sum of the vectors that give the weights of
    a face's corners, and U their sum weighted by the corners' coordinates; so are its derivatives exact.
    """
    used, face = np.unique(seen.face, return_inverse=True)
    pose = camera.world_to_camera
    points = mesh.vertices[mesh.faces[used]].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    vectors = np.cross(points[:, [1, 2, 0]], points[:, [2, 0, 1]])
    assert mesh.corner_uvs is not None
    uvs = mesh.corner_uvs.reshape(-1, 3, 2)[used].astype(np.float64) * pyramid.size
    vectors[:] /= np.abs(vectors).max(axis=(1, 2), keepdims=True) + 1e-300
    planes = np.concatenate([uvs.transpose(0, 2, 1) @ vectors, vectors.sum(axis=1, keepdims=True)], axis=1)
    bounds = np.concatenate([uvs.min(axis=1), uvs.max(axis=1)], axis=1)
    y, x = np.divmod(seen.pixel, camera.width)
    rays = (x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy
    columns = planes.transpose(1, 2, 0).reshape(9, -1)[:, face]
    bottom = columns[6] * rays[0] + columns[7] * rays[1] + columns[8]
    bottom[bottom == 0] = 1e-300
    place, steps = [], [np.zeros(len(x)), np.zeros(len(x))]
    for axis in (0, 1):
        top = columns[3 * axis] * rays[0] + columns[3 * axis + 1] * rays[1] + columns[3 * axis + 2]
        at = top / bottom
        for k, focal in enumerate((camera.fx, camera.fy)):
            steps[k] += np.square((columns[3 * axis + k] - at * columns[6 + k]) / (bottom * focal))
        low, high = bounds[:, axis][face], bounds[:, 2 + axis][face]
        place.append(np.clip(at, low, high))
    lod = 0.5 * np.log2(np.maximum(np.maximum(*steps), 1))
    return pyramid.samples(place, np.clip(lod, 0, pyramid.levels - 1))
